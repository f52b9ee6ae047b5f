# SPDX-License-Identifier: Apache-2.0
"""What a contributor does to the readings, and which readings share one value of it.

Along the beam a position enters at first order; across it, and as an angle of the beam, at second: the cosine error of
Ibaraki et al. 2014 (Fig. 2), which shortens every reading, whatever the sign.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from machine_tool_calibration.arrays import Array, BoolArray, IntArray, groups
from machine_tool_calibration.errors import ModelError
from machine_tool_calibration.instruments.refractive_index import STANDARD_AIR, refractivity
from machine_tool_calibration.model.observations import Observations
from machine_tool_calibration.planning.design import SharedErrors
from machine_tool_calibration.session.contributor import Contributor
from machine_tool_calibration.session.session import distinct_places

_MOST_VALUES = 200  # values of a contributor beyond which its readings are taken to scatter each by itself


def shared_errors(observed: Observations) -> SharedErrors | None:
    """What the budget that a session states does to its readings, for choosing a plan; None where it states none."""
    budget, sigma = observed.session.description.budget, observed.session.sigma
    if not budget:
        return None
    squares, change = 0.0, []
    for contributor in budget:
        own = pattern(contributor, [observed])
        if own.curvature.any():
            change.append(own.mean)
        if contributor.varies == "reading" or own.count > _MOST_VALUES:
            squares += float(np.mean(own.size**2)) / sigma**2
            continue
        change += [own.signed * (own.group == g) for g in np.unique(own.group[own.size > 0])]
    return SharedErrors(float(np.sqrt(squares)), np.array(change).reshape(len(change), len(observed)))


# Directions that differ by less are one, and the shortest length that a beam has across which something is off, m.
_SAME_DIRECTION = 1e6
_SHORTEST = 1e-3


@dataclass(frozen=True)
class Pattern:
    """A contributor at all readings of all sessions."""

    contributor: Contributor  # of which
    slope: Array  # (n,) change of each reading per unit of the value; 0 where it enters at second order
    curvature: Array  # (n,) change of each reading per squared unit, one half of the second derivative
    group: IntArray  # (n,) number of the value that a reading has, from 0
    single: bool  # whether the readings of a value are alike but for the repeat: one in each repeat of one setup

    @property
    def count(self) -> int:
        """Number of values."""
        return int(self.group.max(initial=-1)) + 1

    @property
    def size(self) -> Array:
        """(n,) standard deviation of what it does to each reading, m."""
        u, fourth = self.contributor.u, self.contributor.fourth
        return np.asarray(np.abs(self.slope) * u + np.abs(self.curvature) * u**2 * np.sqrt(fourth - 1.0))

    @property
    def signed(self) -> Array:
        """(n,) one standard deviation of what it does to each reading with the sign of that, m."""
        return np.where(self.slope + self.curvature < 0, -self.size, self.size)

    @property
    def mean(self) -> Array:
        """(n,) what it does to each reading on the average, m: not zero at second order."""
        return self.curvature * self.contributor.u**2

    def change(self, values: Array) -> Array:
        """(n,) change of the readings for (count,) values."""
        own = values[self.group]
        return np.asarray(self.slope * own + self.curvature * own**2)


def pattern(contributor: Contributor, observed: Sequence[Observations]) -> Pattern:
    """A contributor at the readings of sessions; a ModelError if it is of an instrument that none of them has."""
    mine = [not contributor.instrument or o.session.instrument == contributor.instrument for o in observed]
    if not any(mine):
        read = ", ".join(dict.fromkeys(str(o.session.instrument or "no instrument that is named") for o in observed))
        raise ModelError(f"contributor {contributor.name!r} is of a {contributor.instrument}, and {read} read this")
    each = [effect_on_readings(contributor, o) for o in observed]
    slope, curvature = (np.concatenate([on * e[k] for on, e in zip(mine, each, strict=True)]) for k in (0, 1))
    numbers, single, first = [], True, 0
    for o in observed:
        own = sharing(contributor, o)
        single &= _repeats_alone(own, o)
        numbers.append(own + (0 if contributor.varies == "never" else first))
        first += int(own.max(initial=-1)) + 1
    return Pattern(contributor, slope, curvature, np.concatenate(numbers), single)


def effect_on_readings(contributor: Contributor, observed: Observations) -> tuple[Array, Array]:
    """(n,) change of each reading per unit of a contributor's value, and (n,) per squared unit.

    reading and along: 1. length: the measured length L. Temperature, pressure and humidity of the air: L times the
    change of the refractive index with them (Edlén's equation, at standard air). across: -1 / (2 L). angle: -L / 2.
    temperature: the coefficient of expansion times the distance from the machine's (or table's) zero along the
    direction that is read, as the machine or part expands from there and not the beam.
    """
    n = len(observed)
    one, zero = np.ones(n), np.zeros(n)
    enters = contributor.enters
    if enters in ("reading", "along"):
        return one, zero
    length = measured_length(observed)
    if enters == "across":
        far = np.abs(length) > _SHORTEST
        return zero, np.where(far, -0.5 / np.where(far, np.abs(length), 1.0), 0.0)
    if enters == "angle":
        return zero, -0.5 * np.abs(length)
    if enters == "length":
        return length, zero
    if enters == "temperature":
        return float(contributor.expansion or 0.0) * _from_zero(observed), zero
    return _of_air(enters) * length, zero


def measured_length(observed: Observations) -> Array:
    """(n,) length to which a relative error belongs, m.

    The path of a beam from its instrument; of deviations that are read directly and of a probe, the signed distance
    of the functional point from the machine's zero along the direction that is read.
    """
    return observed.path if np.any(observed.path) else _from_zero(observed)


def _from_zero(observed: Observations) -> Array:
    return np.asarray(np.einsum("nj,nj->n", observed.position, observed.direction))


def sharing(contributor: Contributor, observed: Observations) -> IntArray:
    """(n,) number of the value of a contributor that each reading of a session has, from 0."""
    readings = observed.readings
    match contributor.varies:
        case "reading":
            return np.arange(len(observed))
        case "place":
            return distinct_places(observed.position)[1]
        case "angle":
            return groups(readings.setup, *np.round(observed.direction * _SAME_DIRECTION).astype(np.int64).T)
        case "run":
            return groups(observed.run, readings.repeat)
        case "setup":
            return groups(readings.setup)
    return np.zeros(len(observed), dtype=np.int64)


def _repeats_alone(group: IntArray, observed: Observations) -> bool:
    """Whether every group has one reading in each repeat of one setup, all in as many repeats."""
    readings = observed.readings
    size = np.bincount(group)
    if len(size) == 0 or size.min() != size.max():
        return False
    if size[0] == 1:
        return True
    setups = np.full(len(size), -1)
    setups[group] = readings.setup
    alone: BoolArray = setups[group] == readings.setup
    each = len(np.unique(groups(group, readings.repeat))) == len(group)
    return bool(alone.all() and each and size[0] == len(np.unique(readings.repeat)))


def _of_air(enters: str) -> float:
    """Relative change of a length per unit of what the air is off: its wavelength is inverse to the index."""
    index = ("air_temperature", "air_pressure", "air_humidity").index(enters)
    step = (0.1, 100.0, 0.01)[index]
    low, high = ([np.array([v + s * step * (k == index)]) for k, v in enumerate(STANDARD_AIR)] for s in (-1, 1))
    return -float((refractivity(*high) - refractivity(*low))[0]) / (2.0 * step)
