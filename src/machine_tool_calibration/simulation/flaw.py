# SPDX-License-Identifier: Apache-2.0
"""A flaw that can be put into a simulated measurement: an effect of the catalogue, or one in no catalogue."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from machine_tool_calibration.simulation.disturbance import Disturbance
from machine_tool_calibration.simulation.scene import Scene

__all__ = ["ALL_METHODS", "Chosen", "Flaw", "Parameters"]

Parameters = Mapping[str, Any]
ALL_METHODS = ("step_diagonal", "tracking_interferometer", "rotary_axis", "probing", "direct")


@dataclass(frozen=True)
class Flaw:
    """How one effect disturbs a measurement.

    Attributes:
        id: the catalogue's id, or one that begins with `unlisted_`.
        formula: what it does, in words or as a formula of its size.
        unit: unit of the size.
        typical: a size that shows in a measurement.
        disturb: (size, parameters, scene) -> disturbance; element by element, so that one reading at a
            time gives the same as all at once.
        defaults: parameters that the user may set, with their values.
        draw: (source of chance, scene or None) -> parameters that are random unless set.
        methods: the methods in which it can occur.
        axis: letter of the rotary axis on which it occurs; empty: any.
    """

    id: str
    formula: str
    unit: str
    typical: float
    disturb: Callable[[float, Parameters, Scene], Disturbance]
    defaults: Parameters = field(default_factory=dict)
    draw: Callable[[np.random.Generator, Scene | None], Parameters] | None = None
    methods: tuple[str, ...] = ALL_METHODS
    axis: str = ""

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
