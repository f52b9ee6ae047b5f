# SPDX-License-Identifier: Apache-2.0
"""Structure in the residuals, whether or not an effect explains it: functions of every covariate."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import combinations

import numpy as np

from machine_tool_calibration.arrays import Array, IntArray
from machine_tool_calibration.diagnosis.search.candidates import Candidate, Shaped
from machine_tool_calibration.model.imperfection import scaled_values
from machine_tool_calibration.model.observations import Observations
from machine_tool_calibration.residuals.covariates import covariates
from machine_tool_calibration.residuals.periodogram import strongest_periods
from machine_tool_calibration.residuals.pool import Pool
from machine_tool_calibration.session.catalogue import spec_of

__all__ = ["structure_candidates"]

_DEGREE = 4
_ORDERS = (1, 2, 3, 4, 5)
_SIGNS = ("dir_x", "dir_y", "dir_z", "dir_c")
_ANGLES = ("c", "azimuth", "elevation", "normal")
# Fewer readings than this show neither a step nor a wave.
_ENOUGH = 40
# Moments at which a step is tried.
_MOMENTS = 24
# Range of a direction's component below which it is the same for all readings.
_SAME = 1e-6


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
            out.append(replace(candidate, name=pool.label(k) + candidate.name, shapes=shapes))
    return out


def _of_session(observations: Observations, residual: Array) -> Iterator[Candidate]:
    for functions in (_of_one, _products, _lost_motions):
        for name, columns in functions(observations):
            yield Candidate(name, (Shaped((), columns),))
    if len(observations) >= _ENOUGH:
        yield from _events(observations, residual)


def _of_one(observations: Observations) -> Iterator[tuple[str, Array]]:
    """Functions of one covariate, and of some of them displacements."""
    axes = [(axis, along) for axis, along in zip("xyz", observations.direction.T, strict=True) if np.ptp(along) > _SAME]
    for name, values in _covariates(observations).items():
        within = scaled_values(values)
        if within is None:
            continue
        functions = {"its sign": np.sign(values)[None]} if name in _SIGNS else {"smooth": _smooth(within)}
        if name in _ANGLES:
            functions["periodic"] = np.array([wave(k * values) for k in _ORDERS for wave in (np.sin, np.cos)])
        displaces = name in _SIGNS or name == "time" or name.startswith("temperature")
        for shape, columns in functions.items():
            yield f"{name}: {shape}", columns
            for axis, along in axes if displaces else ():
                yield f"{name}: {shape}, as a displacement along {axis}", columns * along


def _smooth(scaled: Array) -> Array:
    """Polynomials of a covariate from -1 to 1, no more than it has values."""
    degree = min(_DEGREE, len(np.unique(np.round(scaled, 9))) - 1)
    return np.asarray(np.polynomial.legendre.legvander(scaled, degree)[:, 1:].T)


def _positions(observations: Observations) -> dict[str, Array]:
    """Those of the axes that move, from -1 to 1."""
    scaled = {axis: scaled_values(values) for axis, values in zip("xyz", observations.position.T, strict=True)}
    return {axis: values for axis, values in scaled.items() if values is not None}


def _products(observations: Observations) -> Iterator[tuple[str, Array]]:
    for (a, u), (b, v) in combinations(_positions(observations).items(), 2):
        columns = np.concatenate([w * observations.direction.T for w in (u * v, u**2 * v, u * v**2)])
        yield f"{a} and {b}: product, as a displacement", columns[np.abs(columns).max(axis=1) > 1e-9]


def _lost_motions(observations: Observations) -> Iterator[tuple[str, Array]]:
    for axis, direction in zip("xyz", observations.direction.T, strict=True):
        sign = np.sign(observations.readings.columns.get(f"dir_{axis}", np.zeros(len(observations))))
        along = sign * direction
        # Where the direction of approach is unknown for some readings, the last is not a number.
        if len(np.unique(sign[sign != 0])) == 2 and np.ptp(along) >= _SAME:
            for other, scaled in _positions(observations).items():
                name = f"dir_{axis} and {other}: lost motion of {axis.upper()} that varies along {other}"
                yield name, _smooth(scaled) * along


def _events(observations: Observations, residual: Array) -> Iterator[Candidate]:
    """What comes suddenly, and what comes and goes; the nonlinear coefficient is the moment or the period, s.

    Where no time was recorded, the order of the readings serves, and both are counts of readings.
    """
    name, time = "time" if observations.timed else "order", observations.clock
    moments = np.quantile(time, (np.arange(_MOMENTS) + 1.0) / (_MOMENTS + 1.0))
    yield Candidate(
        f"{name}: a step at", tuple(Shaped((float(m),), (time > m).astype(float)[None]) for m in np.unique(moments))
    )
    waves = []
    for period in strongest_periods(time, residual):
        phase = 2.0 * np.pi * (time - time[0]) / period
        waves.append(Shaped((period,), np.array([np.sin(phase), np.cos(phase)])))
    if waves:
        yield Candidate(f"{name}: a wave with a period of", tuple(waves), equally=len(time) // 2)


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
