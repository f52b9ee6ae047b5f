# SPDX-License-Identifier: Apache-2.0
"""Temperatures, pressure and humidity that drift smoothly over the hours of a measurement."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

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

    drifts: Mapping[str, Drift] = field(default_factory=dict)

    def __call__(self, time: Array) -> dict[str, Array]:
        """Every recorded column at times (n,), s."""
        return {name: drift(time) for name, drift in self.drifts.items()}


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
