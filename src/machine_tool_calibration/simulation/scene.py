# SPDX-License-Identifier: Apache-2.0
"""Under which conditions each reading is taken: commands, directions, time, and the temperatures of the workshop."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from machine_tool_calibration.arrays import Array, IntArray, first_of_group, last_sign
from machine_tool_calibration.session.session import ENVIRONMENT_COLUMNS

# Mean, how far a workshop is off it, and how much it wanders, in the quantity's unit.
_AIR = {"air_pressure": (101325.0, 400.0, 60.0), "relative_humidity": (0.5, 0.08, 0.02)}
_TEMPERATURE = (20.0, 0.45, 0.45)


@dataclass(frozen=True)
class Drift:
    """A quantity over time: mean + slope·t + sum of a·sin(2 pi t / period + phase)."""

    mean: float  # in the quantity's unit
    waves: tuple[tuple[float, float, float], ...] = ()  # (a, period in s, phase in rad) of each wave
    slope: float = 0.0  # steady change per second

    def __call__(self, time: Array) -> Array:
        """Values at times (n,), s."""
        waves = (a * np.sin(2.0 * np.pi * time / period + phase) for a, period, phase in self.waves)
        return sum(waves, self.mean + self.slope * time)

    def lagged(self, time: Array, lag: float) -> Array:
        """(n,) what follows the quantity with a first-order lag, s, and was as it at time zero: lag y' = value - y."""
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
        waves = ((a * 2.0 * np.pi / t) * np.cos(2.0 * np.pi * time / t + phase) for a, t, phase in self.waves)
        return sum(waves, np.full(np.shape(time), self.slope))


def random_environment(rng: np.random.Generator, *, swing: float = 1.0) -> dict[str, Drift]:
    """A workshop whose temperatures wander by about a kelvin within hours, times `swing`, each in its own way."""
    drifts = {}
    for name in ENVIRONMENT_COLUMNS:
        usual, off, wanders = _AIR.get(name, _TEMPERATURE)
        mean, scale = usual + off * rng.normal(), wanders * swing
        periods = rng.uniform(2000.0, 14000.0, 3)
        sizes = scale * rng.normal(size=3) * (periods / 10000.0)
        phases = rng.uniform(0, 2 * np.pi, 3)
        waves = tuple((float(a), float(p), float(f)) for a, p, f in zip(sizes, periods, phases, strict=True))
        drifts[name] = Drift(float(mean), waves)
    return drifts


@dataclass(frozen=True)
class Scene:
    """Commands and conditions of n readings in the order of time."""

    time: Array  # (n,) s
    setup: IntArray  # (n,) index of the setup
    repeat: IntArray  # (n,) repetition
    position: Array  # (n, 3) commanded x, y, z, m; zero for an axis that does not move
    angle: Array  # (n,) commanded angle of the rotary axis, rad
    direction: Mapping[str, Array] = field(default_factory=dict)  # sign of the last move by axis letter, (n,)
    # what sensors around the machine would show, by column; others stand at 20 °C, 101325 Pa, 50 %
    environment: Mapping[str, Drift] = field(default_factory=dict)
    axis: str = "C"  # letter of the rotary axis
    ends: Mapping[str, tuple[float, float]] = field(default_factory=dict)  # ends of each axis's travel by letter
    start: Array | None = None  # (n,) time of the first reading of that setup, s; found from the readings if absent
    velocity: Mapping[str, Array] = field(default_factory=dict)  # by axis letter, (n,) m/s; at rest if absent
    # way along the path since an axis reversed, by letter, (n,) m; long ago if absent
    since_reversal: Mapping[str, Array] = field(default_factory=dict)

    def __len__(self) -> int:
        return len(self.time)

    @property
    def columns(self) -> dict[str, Array]:
        """What a session records of them: time, position and sign of the last move of each axis, environment."""
        axes = {axis.lower(): self.along(axis) for axis in self.direction}
        signs = {f"dir_{axis.lower()}": sign for axis, sign in self.direction.items()}
        sensed = {name: drift(self.time) for name, drift in self.environment.items()}
        return {"time": self.time, **axes, **signs, **sensed}

    def along(self, axis: str) -> Array:
        """(n,) commanded position of an axis, m or rad."""
        return self.position[:, "XYZ".index(axis)] if axis in "XYZ" else self.angle

    def sensed(self, column: str, lag: float = 0.0) -> Array:
        """(n,) an environment column, standard air where not recorded, or what follows it with a first-order lag, s."""
        drift = self._drift(column)
        return drift.lagged(self.time, lag) if lag else drift(self.time)

    def rate(self, column: str) -> Array:
        """(n,) change of an environment column, per second; 0 where it is not known."""
        return self._drift(column).rate(self.time)

    def _drift(self, column: str) -> Drift:
        return self.environment.get(column, Drift(_AIR.get(column, _TEMPERATURE)[0]))

    def toward(self, axis: str) -> Array:
        """(n,) sign of the last move of an axis; +1 where it did not move."""
        return self.direction.get(axis, np.ones(len(self)))

    def since_setup(self) -> Array:
        """(n,) s since the first reading of that setup."""
        return np.asarray(self.time - (self.time[first_of_group(self.setup)] if self.start is None else self.start))


def last_direction(command: Array, initial: float = 1.0) -> Array:
    """(n,) sign of the last move of one axis up to each reading; `initial` before it has moved."""
    return last_sign(np.diff(command, prepend=command[:1]), 1e-12, initial)


def blocks(*keys: IntArray) -> IntArray:
    """(n,) number, from 0, of the stretch of consecutive readings that share all keys."""
    return np.cumsum(np.any([np.diff(key, prepend=key[:1]) != 0 for key in keys], axis=0))


def ordered_times(setup: IntArray, interval: float, pause: float) -> Array:
    """(n,) times of readings `interval` apart, with `pause` more before each new setup, s."""
    return np.arange(len(setup)) * interval + blocks(setup) * pause
