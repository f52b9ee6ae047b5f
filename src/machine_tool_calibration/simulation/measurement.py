"""What every simulated method offers: commands, readings from geometry, and the truth behind them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from machine_tool_calibration.arrays import Array, IntArray
from machine_tool_calibration.simulation.disturbance import Disturbance
from machine_tool_calibration.simulation.machine import VirtualMachine
from machine_tool_calibration.simulation.scene import Scene

__all__ = ["Measurement", "since_first"]


@dataclass(frozen=True)
class Measurement:
    """A planned measurement, ready to be read.

    Attributes:
        describe: machine -> content of `session.yaml` without `format`, `repeats` and the uncertainty.
        scene: commands and conditions of each reading.
        read: (machine, disturbance) -> (n,) readings from geometry, before the datum, m.
        datum: (n,) readings of the same number are changes since the first of them; None where the
            readings are absolute.
        columns: numeric columns of the session besides time and environment.
        labels: text columns.
        truth: machine -> what the measurement should find, for judging.
    """

    describe: Callable[[VirtualMachine], Mapping[str, Any]]
    scene: Scene
    read: Callable[[VirtualMachine, Disturbance], Array]
    datum: IntArray | None
    columns: Mapping[str, Array]
    labels: Mapping[str, np.ndarray] = field(default_factory=dict)
    truth: Callable[[VirtualMachine], dict[str, Any]] = lambda machine: {}


def since_first(values: Array, group: IntArray | None) -> Array:
    """Values minus the first of their group, in the order of the readings."""
    if group is None:
        return values
    _, first, inverse = np.unique(group, return_index=True, return_inverse=True)
    change: Array = values - values[first][inverse]
    return change
