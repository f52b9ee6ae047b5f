# SPDX-License-Identifier: Apache-2.0
"""Under which conditions each reading is taken: commands, directions, time, environment."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from machine_tool_calibration.arrays import Array, IntArray
from machine_tool_calibration.simulation.environment import Drift, Environment

__all__ = ["Scene", "blocks", "last_direction", "last_sign", "ordered_times"]

_STANDARD = {"air_pressure": 101325.0, "relative_humidity": 0.5}


@dataclass(frozen=True)
class Scene:
    """Commands and conditions of n readings in the order of time.

    Attributes:
        time: (n,) s.
        setup: (n,) index of the setup.
        repeat: (n,) repetition.
        position: (n, 3) commanded x, y, z, m; zero for an axis that does not move.
        angle: (n,) commanded angle of the rotary axis, rad.
        direction: sign of the last move by axis letter, (n,).
        environment: temperatures, pressure and humidity over time.
        axis: letter of the rotary axis.
        ends: lower and upper end of each axis's travel by letter.
        start: (n,) time of the first reading of that setup, s; found from the readings if absent.
    """

    time: Array
    setup: IntArray
    repeat: IntArray
    position: Array
    angle: Array
    direction: Mapping[str, Array] = field(default_factory=dict)
    environment: Environment = field(default_factory=Environment)
    axis: str = "C"
    ends: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    start: Array | None = None

    def __len__(self) -> int:
        return len(self.time)

    def along(self, axis: str) -> Array:
        """(n,) commanded position of an axis, m or rad."""
        return self.position[:, "XYZ".index(axis)] if axis in "XYZ" else self.angle

    def sensed(self, column: str) -> Array:
        """(n,) an environment column; 20 °C, 101325 Pa or 50 % where it is not recorded."""
        return self._drift(column)(self.time)

    def sensed_late(self, column: str, lag: float) -> Array:
        """(n,) what follows an environment column with a first-order lag, s."""
        return self._drift(column).lagged(self.time, lag)

    def rate(self, column: str) -> Array:
        """(n,) change of an environment column, per second; 0 where it is not known."""
        return self._drift(column).rate(self.time)

    def _drift(self, column: str) -> Drift:
        return self.environment.drifts.get(column, Drift(_STANDARD.get(column, 20.0)))

    def toward(self, axis: str) -> Array:
        """(n,) sign of the last move of an axis; +1 where it did not move."""
        return self.direction.get(axis, np.ones(len(self)))

    def since_setup(self) -> Array:
        """(n,) s since the first reading of that setup."""
        if self.start is not None:
            return self.time - self.start
        first = np.full(int(self.setup.max(initial=-1)) + 1, np.inf)
        np.minimum.at(first, self.setup, self.time)
        since: Array = self.time - first[self.setup]
        return since


def last_direction(command: Array, initial: float = 1.0) -> Array:
    """(n,) sign of the last move of one axis up to each reading; `initial` before it has moved."""
    return last_sign(np.diff(command, prepend=command[:1]), 1e-12, initial)


def last_sign(moves: Array, least: float, initial: float = 1.0) -> Array:
    """(n,) sign of the last of the moves (n,) so far that was no less than `least`; `initial` before there was one."""
    counts = np.abs(moves) >= least
    last = np.maximum.accumulate(np.where(counts, np.arange(len(moves)), -1))
    return np.where(last >= 0, np.sign(moves[last]), initial)


def blocks(*keys: IntArray) -> IntArray:
    """(n,) number, from 0, of the stretch of consecutive readings that share all keys."""
    new = np.zeros(len(keys[0]), bool)
    for key in keys:
        new[1:] |= key[1:] != key[:-1]
    return np.cumsum(new)


def ordered_times(setup: IntArray, interval: float, pause: float) -> Array:
    """(n,) times of readings `interval` apart, with `pause` more before each new setup, s."""
    return np.arange(len(setup)) * interval + blocks(setup) * pause
