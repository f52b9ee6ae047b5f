# SPDX-License-Identifier: Apache-2.0
"""Structure in the residuals, whether or not an effect explains it: functions of every covariate."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import combinations

import numpy as np

from machine_tool_calibration.arrays import Array, IntArray, occurrence
from machine_tool_calibration.diagnosis.search.candidates import Candidate, Shaped
from machine_tool_calibration.model.imperfection import scaled_values
from machine_tool_calibration.model.observations import Observations
from machine_tool_calibration.residuals.covariates import covariates
from machine_tool_calibration.residuals.pool import Pool
from machine_tool_calibration.session.catalogue import spec_of
from machine_tool_calibration.words import Said, named, say, together

__all__ = ["structure_candidates"]

_DEGREE = 4
_ORDERS = (1, 2, 3, 4, 5)
_SIGNS = ("dir_x", "dir_y", "dir_z", "dir_c")
_ANGLES = ("c", "azimuth", "elevation", "normal")
# Fewer readings than this show neither a step nor a wave.
_ENOUGH = 40
# Moments at which a step is tried: evenly among the readings, as effects may hide it at first, and at the largest
# changes, of a run and of all that comes later.
_MOMENTS, _CHANGES = 24, 6
# Range of a direction's component below which it is the same for all readings.
_SAME = 1e-6

# Frequencies of the periodogram for each independent one, its largest peaks that are looked at, and the fewest periods
# over the whole session: slower waves are smooth functions.
_OVERSAMPLED, _PEAKS, _FEWEST = 4, 8, 2.5
_MOST_FREQUENCIES = 20000
# Numbers that are worked on at once; sum of squares of a wave below which it is zero at all readings.
_AT_ONCE, _NOTHING = 4e5, 1e-12


def structure_candidates(pool: Pool) -> list[Candidate]:
    """Functions of every covariate that varies, of each session for itself.

    Smooth functions of every one, periodic ones of angles, steps and waves in time. A function of time, temperature or
    direction of approach is also tried as a displacement along each machine axis; products of two axis positions show
    where the machine does not move as rigid bodies, those of a direction of approach and a position where lost motion
    is not the same everywhere.
    """
    out = []
    for k, (observations, piece) in enumerate(zip(pool.observations, pool.pieces, strict=True)):
        for candidate in _of_session(observations, pool.residuals[piece] / pool.sigma[piece]):
            shapes = tuple(Shaped(s.shape, pool.only(s.columns, piece)) for s in candidate.shapes)
            assert candidate.dependence is not None
            label, (covariate, how) = pool.label(k), candidate.dependence
            of = (together((label, covariate), "") if label else covariate, how)
            out.append(replace(candidate, name=label + candidate.name, shapes=shapes, dependence=of))
    return out


def _of_session(observations: Observations, residual: Array) -> Iterator[Candidate]:
    for functions in (_of_one, _products, _lost_motions):
        for covariate, how, columns in functions(observations):
            yield _structure(covariate, how, (Shaped((), columns),))
    if len(observations) >= _ENOUGH:
        yield from _events(observations, residual)


def _of_one(observations: Observations) -> Iterator[tuple[str, Said, Array]]:
    """Functions of one covariate, and of some of them displacements."""
    axes = [(axis, along) for axis, along in zip("xyz", observations.direction.T, strict=True) if np.ptp(along) > _SAME]
    for name, values in _covariates(observations).items():
        within = scaled_values(values)
        if within is None:
            continue
        functions = {"its_sign": np.sign(values)[None]} if name in _SIGNS else {"smooth": _smooth(within)}
        if name in _ANGLES:
            functions["periodic"] = np.array([wave(k * values) for k in _ORDERS for wave in (np.sin, np.cos)])
        displaces = name in _SIGNS or name == "time" or name.startswith("temperature")
        covariate = named("column", name)
        for shape, columns in functions.items():
            how = say(f"shape.{shape}")
            yield covariate, how, columns
            for axis, along in axes if displaces else ():
                yield covariate, say("shape.displacement", shape=how, axis=axis), columns * along


def _smooth(scaled: Array) -> Array:
    """Polynomials of a covariate from -1 to 1, no more than it has values."""
    degree = min(_DEGREE, len(np.unique(np.round(scaled, 9))) - 1)
    return np.asarray(np.polynomial.legendre.legvander(scaled, degree)[:, 1:].T)


def _positions(observations: Observations) -> dict[str, Array]:
    """Those of the axes that move, from -1 to 1."""
    scaled = {axis: scaled_values(values) for axis, values in zip("xyz", observations.position.T, strict=True)}
    return {axis: values for axis, values in scaled.items() if values is not None}


def _products(observations: Observations) -> Iterator[tuple[str, Said, Array]]:
    for (a, u), (b, v) in combinations(_positions(observations).items(), 2):
        columns = np.concatenate([w * observations.direction.T for w in (u * v, u**2 * v, u * v**2)])
        yield say("shape.axes", one=a, other=b), say("shape.product"), columns[np.abs(columns).max(axis=1) > 1e-9]


def _lost_motions(observations: Observations) -> Iterator[tuple[str, Said, Array]]:
    for axis, direction in zip("xyz", observations.direction.T, strict=True):
        sign = np.sign(observations.readings.columns.get(f"dir_{axis}", np.zeros(len(observations))))
        along = sign * direction
        # Where the direction of approach is unknown for some readings, the last is not a number.
        if len(np.unique(sign[sign != 0])) == 2 and np.ptp(along) >= _SAME:
            for other, scaled in _positions(observations).items():
                both = say("shape.axes", one=named("column", f"dir_{axis}"), other=other)
                yield both, say("shape.lost_motion", axis=axis.upper(), other=other), _smooth(scaled) * along


def _events(observations: Observations, residual: Array) -> Iterator[Candidate]:
    """What comes suddenly, and what comes and goes; the nonlinear coefficient is the moment or the period, s.

    Where no time was recorded, the order of the readings serves, and both are counts of readings.
    """
    name, time = "time" if observations.timed else "order", observations.clock
    moments = np.quantile(time, (np.arange(_MOMENTS) + 1.0) / (_MOMENTS + 1.0))
    changes = [_largest_changes(time, run, residual) for run in (np.zeros_like(observations.run), observations.run)]
    every = np.unique(np.concatenate([moments, *changes]))
    steps = tuple(Shaped((float(m),), (time > m).astype(float)[None]) for m in every)
    yield _structure(named("column", name), say("shape.step_at", at=""), steps, len(time))
    waves = []
    for period in _strongest_periods(time, observations.run, residual):
        phase = 2.0 * np.pi * (time - time[0]) / period
        waves.append(Shaped((period,), np.array([np.sin(phase), np.cos(phase)])))
    if waves:
        yield _structure(named("column", name), say("shape.wave", at=""), tuple(waves), len(time) // 2)


def _structure(covariate: str, how: Said, shapes: tuple[Shaped, ...], equally: int = 0) -> Candidate:
    return Candidate(f"{covariate}: {how}", shapes, equally=equally, dependence=(covariate, how))


def _covariates(observations: Observations) -> dict[str, Array]:
    """What the residuals may depend on."""
    known = covariates(observations)
    # A displacement by the direction of approach is tried with every axis; the order stands for time, if need be.
    out = {name: values for name, values in known.items() if name not in ("order", "repeat") and " along " not in name}
    if "path" in out:
        out["path within the setup"] = _within(observations.path, observations.readings.setup)
        if not spec_of(observations.session).reads_deviations:
            # There the reading is the deviation itself, which explains itself.
            out["displacement"] = observations.readings.displacement
    return out


def _within(values: Array, group: IntArray) -> Array:
    """Values from -1 to 1 over the range of their group."""
    out = np.zeros(len(values))
    for g in np.unique(group):
        scaled = scaled_values(values[group == g])
        if scaled is not None:
            out[group == g] = scaled
    return out


def _largest_changes(time: Array, run: IntArray, residual: Array) -> Array:
    """Moments after which the residuals change most, each the time of the last reading before.

    A counter that loses its count shows so: all that counts from the same zero is off from then on.

    Args:
        time: (n,) of the readings.
        run: (n,) readings with a mean of their own, such as those that count from one zero.
        residual: (n,) over the standard uncertainty.
    """
    order = np.argsort(time, kind="stable")
    time, run, residual = time[order], run[order], residual[order]
    size = np.bincount(run)[run]
    # Of a column that is 1 after a moment, its product with the residuals, and its square beside the runs' means.
    product = residual.sum() - np.cumsum(residual)
    square = np.cumsum((size - 1.0 - 2.0 * occurrence(run)) / size)
    moment = np.append(np.diff(time) > 0, False) & (square > _SAME)
    power = np.pad(np.where(moment, product**2 / np.where(moment, square, 1.0), 0.0), 1)
    peaks = np.flatnonzero((power[1:-1] > power[:-2]) & (power[1:-1] >= power[2:]))
    return time[peaks[np.argsort(-power[1:-1][peaks])][:_CHANGES]]


def _strongest_periods(time: Array, run: IntArray, residual: Array) -> list[float]:
    """Periods of the largest peaks of the periodogram (Lomb 1976, Scargle 1982).

    From the session's length down to two readings'. Only these are looked at more closely: at all others less is to
    be explained.

    Args:
        time: (n,) of the readings.
        run: (n,) readings with a mean of their own: of slow waves it takes up most.
        residual: (n,) over the standard uncertainty.
    """
    length = float(np.ptp(time))
    highest = len(time) / (2.0 * length)
    lowest = _FEWEST / length
    count = int(min(_OVERSAMPLED * (highest - lowest) * length, _MOST_FREQUENCIES))
    if count < 3 or not residual.any():
        return []
    frequency = np.linspace(lowest, highest, count)
    power = _periodogram(time - time[0], run, residual, frequency)
    # The ends may be peaks as well.
    padded = np.pad(power, 1)
    peaks = np.flatnonzero((power > padded[:-2]) & (power >= padded[2:]))
    best = peaks[np.argsort(-power[peaks])][:_PEAKS]
    step = float(frequency[1] - frequency[0])
    return [float(1.0 / (frequency[k] + shift)) for k in best for shift in (-0.5 * step, 0.0, 0.5 * step)]


def _periodogram(time: Array, run: IntArray, values: Array, frequency: Array) -> Array:
    """(f,) sum of squares that a sine and a cosine of each frequency take up beside the means of runs."""
    order = np.argsort(run, kind="stable")
    time, values, run = time[order], values[order], run[order]
    first, size = np.unique(run, return_index=True, return_counts=True)[1:]
    values = values - np.repeat(np.add.reduceat(values, first) / size, size)
    out = np.empty(len(frequency))
    step = max(int(_AT_ONCE / len(time)), 1)
    for part in (slice(k, k + step) for k in range(0, len(frequency), step)):
        phase = 2.0 * np.pi * frequency[part, None] * time
        wave = np.empty(phase.shape, dtype=complex)
        # Faster than the exponential function of a complex number.
        np.cos(phase, out=wave.real)
        np.sin(phase, out=wave.imag)
        means = np.add.reduceat(wave, first, axis=1) / size
        # With z the wave, the sums of z conj(z) and of z z have the products of sine and cosine.
        both = len(time) - np.abs(means) ** 2 @ size
        twice = np.einsum("fn,fn->f", wave, wave) - means**2 @ size
        along = wave @ values
        determinant = both**2 - np.abs(twice) ** 2
        explained = 2.0 * (both * np.abs(along) ** 2 - np.real(np.conj(twice) * along**2))
        seen = determinant > _NOTHING * len(time) ** 2
        out[part] = np.where(seen, explained / np.where(seen, determinant, 1.0), 0.0)
    return out
