# SPDX-License-Identifier: Apache-2.0
"""A flaw that can be put into a simulated measurement: an effect of the catalogue, or one in no catalogue."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.simulation.disturbance import Disturbance, Sight
from machine_tool_calibration.simulation.scene import Scene

Parameters = Mapping[str, Any]
Disturb = Callable[[float, Parameters, Scene], Disturbance]
Draw = Callable[[np.random.Generator, Scene | None], Parameters]
ALL_METHODS = ("step_diagonal", "tracking_interferometer", "rotary_axis", "probing", "direct", "ball_bar")
LINEAR = ("step_diagonal", "tracking_interferometer", "probing", "direct", "ball_bar")
"""Methods that move linear axes."""
TABLE = ("rotary_axis", "probing")
"""Those that turn a table."""
CIRCLE = ("ball_bar",)
"""Those that go round circles."""
BEAM = ("step_diagonal", "tracking_interferometer", "rotary_axis")
"""Those of a beam of light."""
STATIONS = ("tracking_interferometer", "rotary_axis")
"""Those of a beam that is pointed from a station."""


@dataclass(frozen=True)
class Flaw:
    """How one effect disturbs a measurement."""

    id: str  # the catalogue's id, or one that begins with `unlisted_`
    formula: str  # what it does, in words or as a formula of its size
    unit: str  # unit of the size
    typical: float  # a size that shows in a measurement
    # (size, parameters, scene) -> disturbance; element by element, so that one reading at a time gives the same as all
    # at once
    disturb: Disturb
    defaults: Parameters = field(default_factory=dict)  # parameters that the user may set, with their values
    draw: Draw | None = None  # (source of chance, scene or None) -> parameters that are random unless set
    methods: tuple[str, ...] = ALL_METHODS  # the methods in which it can occur
    axis: str = ""  # letter of the rotary axis on which it occurs; empty: any

    @property
    def listed(self) -> bool:
        """Whether the effect is in the catalogue."""
        return not self.id.startswith("unlisted_")


@dataclass(frozen=True)
class Chosen:
    """A flaw with its size and all its parameters settled."""

    flaw: Flaw
    size: float
    parameters: Parameters

    def disturb(self, scene: Scene) -> Disturbance:
        """The disturbance of readings taken under these conditions."""
        return self.flaw.disturb(self.size, self.parameters, scene)

    def document(self) -> dict[str, Any]:
        """For `truth.json`."""
        return {"id": self.flaw.id, "size": self.size, "unit": self.flaw.unit, **dict(self.parameters)}


def reads(change: Callable[[float, Parameters, Scene, Sight], Array]) -> Disturb:
    """A disturbance of the reading itself: (size, parameters, scene, sight) -> what is added, (n,) m."""
    return lambda size, given, scene: Disturbance(reading=(lambda sight: change(size, given, scene, sight),))


def drawn_phase(rng: np.random.Generator, _: Scene | None) -> Parameters:
    """Where in its turn a wave begins."""
    return {"phase": float(rng.uniform(0, 2 * np.pi))}


def drawn_seed(rng: np.random.Generator, _: Scene | None) -> Parameters:
    """Of what a flaw draws itself."""
    return {"seed": int(rng.integers(2**31))}
