# SPDX-License-Identifier: Apache-2.0
"""What every simulated method offers, and the common part of every plan."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from string import ascii_uppercase
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field

from machine_tool_calibration.arrays import Array, IntArray, first_of_group
from machine_tool_calibration.session.record import Finite, Positive, Record
from machine_tool_calibration.simulation.flaw import Disturbance
from machine_tool_calibration.simulation.machine import VirtualMachine
from machine_tool_calibration.simulation.machine_file import Amplitudes
from machine_tool_calibration.simulation.scene import Scene


@dataclass(frozen=True)
class Measurement:
    """A planned measurement, ready to be read."""

    # content of `session.yaml` without `format`, `method`, `machine`, `repeats` and the uncertainty
    description: Mapping[str, Any]
    scene: Scene  # commands and conditions of each reading
    # (machine, disturbance) -> (n,) readings from geometry, before the datum, m
    read: Callable[[VirtualMachine, Disturbance], Array]
    datum: IntArray | None  # (n,) readings of one number are changes since the first of them; None: absolute
    columns: Mapping[str, Array] = field(default_factory=dict)  # numeric columns of the session besides the scene's
    labels: Mapping[str, np.ndarray] = field(default_factory=dict)  # text columns
    truth: Callable[[VirtualMachine], dict[str, Any]] = lambda machine: {}  # machine -> what it should find
    # machine -> lengths of it that were measured otherwise, by the error motion
    known: Callable[[VirtualMachine], dict[str, Any]] = lambda machine: {}


def since_first(values: Array, group: IntArray | None) -> Array:
    """Values minus the first of their group, in the order of the readings."""
    return values if group is None else np.asarray(values - values[first_of_group(group)])


Vector3 = tuple[Finite, Finite, Finite]
# Times, s: a day between two readings, eleven days between two setups.
Interval = Annotated[float, Field(gt=0, le=1e5, allow_inf_nan=False)]
Pause = Annotated[float, Field(ge=0, le=1e6, allow_inf_nan=False)]


class Plan(Record):
    """Where and when readings are taken."""

    repeats: Annotated[int, Field(ge=1, le=10000)] = 1  # how often each setup is run
    interval: Interval = 4.0  # time between readings, s
    pause: Pause = 600.0  # time to set up the instrument anew, s
    noise: Positive = 3e-7  # usual standard uncertainty of a reading, m
    sign: Literal[-1, 1] = 1  # sense in which a positive rotary command turns the workpiece (+1: counter-clockwise)
    chain: str = "w-C-b-Y-X-Z-t"  # chain of axes

    def travel(self) -> dict[str, tuple[float, float]]:
        """Ends of the linear axes' travel, by letter, m."""
        return {}

    def machine(self) -> dict[str, Any]:
        """What the session says of the machine: its chain and travel."""
        return {"chain": self.chain, "travel": {axis.lower(): list(ends) for axis, ends in self.travel().items()}}

    def measured(self, rng: np.random.Generator) -> Measurement:
        """The measurement of the plan; `rng` decides where the instrument and the part truly stand."""
        raise NotImplementedError

    def prepared(self, machine: VirtualMachine) -> VirtualMachine:
        """The machine as the plan wants it."""
        return machine

    def errors(self) -> Amplitudes | None:
        """Sizes of random errors that suit the method; None for the usual ones."""
        return None


def declared_places(places: Array, uncertainty: float, ids: Iterable[str] = ()) -> list[dict[str, Any]]:
    """What a session says of places (k, 3), m, whose standard uncertainty is stated where there is one.

    Those without ids are the instrument's: A to Z, then S27 and so on.
    """
    names = tuple(ids) or (*ascii_uppercase, *(f"S{k + 1}" for k in range(len(ascii_uppercase), len(places))))
    own = {"position_uncertainty": uncertainty} if uncertainty > 0 else {}
    return [{"id": name, "position": place, **own} for name, place in zip(names, places.tolist(), strict=False)]


def true_errors(machine: VirtualMachine, places: Array) -> dict[str, Any]:
    """Position errors that a measurement should find at places (n, 3), m."""
    return {"points": places.tolist(), "position_error": machine.position_error(places).tolist()}


def spanned(points: Array) -> dict[str, tuple[float, float]]:
    """Ends of X, Y, Z that hold the points and zero; an axis that stands still gets 50 mm."""
    travel = {}
    for index, axis in enumerate("XYZ"):
        low, high = min(0.0, float(points[:, index].min())), max(0.0, float(points[:, index].max()))
        travel[axis] = (low, high if high - low > 1e-9 else low + 0.05)
    return travel
