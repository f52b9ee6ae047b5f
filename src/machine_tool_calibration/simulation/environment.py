# SPDX-License-Identifier: Apache-2.0
"""Temperatures, pressure and humidity that drift smoothly over the hours of a measurement."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from machine_tool_calibration.arrays import Array

__all__ = ["COLUMNS", "Drift", "Environment", "random_environment"]

COLUMNS = (
    "temperature_air",
    "temperature_x",
    "temperature_y",
    "temperature_z",
    "temperature_table",
    "temperature_work",
    "air_pressure",
    "relative_humidity",
)
"""Columns of a session that describe the environment: degrees Celsius, Pa, 0 … 1."""

_MEAN = {"air_pressure": 101325.0, "relative_humidity": 0.5}
_OFFSET = {"air_pressure": 400.0, "relative_humidity": 0.08}
_SWING = {"air_pressure": 60.0, "relative_humidity": 0.02}


@dataclass(frozen=True)
class Drift:
    """A quantity over time: mean + slope·t + sum of a·sin(2 pi t / period + phase).

    Attributes:
        mean: in the quantity's unit.
        waves: (a, period in s, phase in rad) of each wave.
        slope: steady change per second.
    """

    mean: float
    waves: tuple[tuple[float, float, float], ...] = ()
    slope: float = 0.0

    def __call__(self, time: Array) -> Array:
        """Values at times (n,), s."""
        value = self.mean + self.slope * time
        for amplitude, period, phase in self.waves:
            value = value + amplitude * np.sin(2.0 * np.pi * time / period + phase)
        return value

    def lagged(self, time: Array, lag: float) -> Array:
        """What follows the quantity with a first-order lag, and was as it at time zero: lag y' = value - y.

        Args:
            time: (n,) s.
            lag: time constant, s.
        """
        faded = np.exp(-time / lag)
        value = self.mean + self.slope * (time - lag * (1.0 - faded))
        for amplitude, period, phase in self.waves:
            speed = 2.0 * np.pi / period * lag
            share, late = amplitude / np.hypot(1.0, speed), np.arctan(speed)
            steady = share * np.sin(2.0 * np.pi * time / period + phase - late)
            value = value + steady + (amplitude * np.sin(phase) - share * np.sin(phase - late)) * faded
        return np.asarray(value)

    def rate(self, time: Array) -> Array:
        """Change per second at times (n,), s."""
        value = np.full(np.shape(time), self.slope)
        for amplitude, period, phase in self.waves:
            value = value + amplitude * 2.0 * np.pi / period * np.cos(2.0 * np.pi * time / period + phase)
        return value


@dataclass(frozen=True)
class Environment:
    """What the sensors around the machine would show, by column name; others stand at 20 °C, 101325 Pa, 50 %."""

    drifts: Mapping[str, Drift]

    def __post_init__(self) -> None:
        waves = max((len(drift.waves) for drift in self.drifts.values()), default=0)
        table = np.zeros((3, len(self.drifts), waves))
        table[1] = 1.0
        for row, drift in enumerate(self.drifts.values()):
            for column, wave in enumerate(drift.waves):
                table[:, row, column] = wave
        object.__setattr__(self, "_waves", table)  # all columns at once: nodes ask for one moment at a time

    def __call__(self, time: Array) -> dict[str, Array]:
        """Every recorded column at times (n,), s."""
        amplitude, turns, phase = self._parts(time)
        swing = np.einsum("cw,cwn->cn", amplitude, np.sin(turns + phase[..., None]))
        return {
            name: drift.mean + drift.slope * time + swing[row]
            for row, (name, drift) in enumerate(self.drifts.items())
        }

    def behind(self, time: Array) -> Callable[[str, float], Array]:
        """What follows a column, by its name, with a lag in s, at times (n,)."""
        return lambda name, lag: self.drifts[name].lagged(time, lag)

    def rate(self, time: Array) -> dict[str, Array]:
        """How fast every recorded column changes at times (n,), per second."""
        amplitude, turns, phase = self._parts(time)
        speed = amplitude * 2.0 * np.pi / self._waves[1]  # type: ignore[attr-defined]
        rates = np.einsum("cw,cwn->cn", speed, np.cos(turns + phase[..., None]))
        return {name: drift.slope + rates[row] for row, (name, drift) in enumerate(self.drifts.items())}

    def _parts(self, time: Array) -> tuple[Array, Array, Array]:
        amplitude, period, phase = self._waves  # type: ignore[attr-defined]
        return amplitude, 2.0 * np.pi * time / period[..., None], phase


def random_environment(
    rng: np.random.Generator, *, swing: float = 1.0, columns: tuple[str, ...] = COLUMNS
) -> Environment:
    """A workshop whose temperatures wander by about a kelvin within hours, each in its own way.

    Args:
        rng: source of chance.
        swing: factor on all changes over time; 0 for a laboratory where nothing changes.
        columns: what is recorded.
    """
    drifts = {}
    for name in COLUMNS:
        mean = _MEAN.get(name, 20.0) + _OFFSET.get(name, 0.45) * rng.normal()
        scale = _SWING.get(name, 0.45) * swing
        periods = rng.uniform(2000.0, 14000.0, 3)
        sizes = scale * rng.normal(size=3) * (periods / 10000.0)
        phases = rng.uniform(0, 2 * np.pi, 3)
        waves = tuple((float(a), float(p), float(f)) for a, p, f in zip(sizes, periods, phases, strict=True))
        if name in columns:
            drifts[name] = Drift(float(mean), waves)
    return Environment(drifts)
