# SPDX-License-Identifier: Apache-2.0
"""Where stations and targets stand if the table turned without error: the point from which the fit sets out."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.methods.rotary_axis.geometry import TableReadings

__all__ = ["Start", "find_start"]

# Errors of a rotary axis are some micrometres; a nominal position may be wrong by centimetres. Both only shape the way
# to the start: the fit that follows holds no such knowledge.
_ERRORS = 1e-5
_NOMINAL = 0.05
# Misfit at which other places to set out from are tried, m, and how many.
_ABSURD = 3e-5
_TRIES = 8
# The same for places beside the stated ones; how far beside, at most, m; and how far the fit may then go.
_DOUBTFUL = 1e-5
_BESIDE = 20
_STATIONS_BESIDE = 0.15
_TARGETS_BESIDE = 0.03
_WIDE = 0.2
# Readings off by so many times the median of all say that there are gross errors. Then Huber's weights (1964), until
# none changes by more than this, and so often at most. Least squares may spread gross errors over all readings, so that
# none stands out: some millimetres leave no more than this misfit, m, and were the cause where these weights leave less
# than this share of it.
_WILD = 20.0
_SMEARED, _SPREAD = 1e-3, 0.2
_TUNING = 1.345
_AT_REST = 0.02
_REWEIGHTED = 15


@dataclass(frozen=True)
class Start:
    """First estimates.

    Attributes:
        stations: (S, 3) m, in the frame of the axis; the nominal one where a station read nothing.
        targets: (T, 3) m, table frame.
        misfit: median absolute residual of the readings, m.
    """

    stations: Array
    targets: Array
    misfit: float


def find_start(table: TableReadings, stations: Array, targets: Array, *, tilted: bool = False) -> Start:
    """Fit stations and targets with the table turning without error.

    The datum of each run is taken out by subtracting the run's mean.

    Args:
        table: the readings.
        stations: (S, 3) nominal, m.
        targets: (T, 3) nominal at c = 0, m.
        tilted: where the nominal places lead nowhere, try whether the axis stands tilted in the machine, by up to a
            right angle: then all stations are first turned together; and whether they are wrong by decimetres: then
            the fit sets out from places beside them.
    """
    start = _fitted(table, stations, targets)
    if _DOUBTFUL < start.misfit < _SMEARED:
        resisting = _fitted(table, stations, targets, resisting=True)
        start = resisting if resisting.misfit < _SPREAD * start.misfit else start
    if not tilted or start.misfit < _DOUBTFUL:
        return start
    if start.misfit > _ABSURD:
        start = _from_tilted(table, stations, targets, start)
    rng = np.random.default_rng(0)
    for _ in range(_BESIDE):
        if start.misfit < _DOUBTFUL:
            break
        away = stations + _STATIONS_BESIDE * rng.normal(size=stations.shape)
        found = _fitted(table, away, targets + _TARGETS_BESIDE * rng.normal(size=targets.shape), _WIDE)
        start = min(start, found, key=lambda one: one.misfit)
    return start


def _from_tilted(table: TableReadings, stations: Array, targets: Array, start: Start) -> Start:
    """The best of a start and those from a tilted axis."""
    turned = [_turned(stations, table.axis, tilt) for tilt in _tilts()]
    rough = [_misfit(table, places, targets) for places in turned]
    posed = [_posed(table, turned[k], targets) for k in np.argsort(rough)[:_TRIES]]
    # The nearest to where the rotation is as stated is the one that fits; a mirror image may fit as well.
    tries = [_fitted(table, places, targets) for places in posed]
    return min([start, *tries], key=lambda found: found.misfit)


def _posed(table: TableReadings, stations: Array, targets: Array) -> Array:
    """All stations moved as one body to where the readings fit best, targets as stated."""
    arm, reading = table.turned(targets), table.readings.displacement
    count = np.bincount(table.run)

    def place(x: Array) -> Array:
        return np.asarray(Rotation.from_rotvec(x[3:]).apply(stations) + x[:3])

    def residual(x: Array) -> Array:
        off = np.linalg.norm(arm - place(x)[table.readings.setup], axis=1) - reading
        return np.asarray(off - (np.bincount(table.run, off) / count)[table.run])

    found = least_squares(residual, np.zeros(6), method="lm", xtol=1e-8, ftol=1e-8)
    return place(np.asarray(found.x))


def _tilts() -> list[tuple[float, float]]:
    """Turns about the two directions across the axis, rad: up to a right angle, beyond it would turn the other way."""
    around = np.arange(12) * np.pi / 6
    return [(a * np.cos(b), a * np.sin(b)) for a in np.radians([20, 40, 60, 75, 90]) for b in around]


def _turned(stations: Array, axis: str, tilt: tuple[float, float]) -> Array:
    """Stations seen from an axis that is tilted by a rotation vector across it."""
    along = "ABC".index(axis)
    vector = np.zeros(3)
    vector[(along + 1) % 3], vector[(along + 2) % 3] = tilt
    return np.asarray(Rotation.from_rotvec(-vector).apply(stations))


def _misfit(table: TableReadings, stations: Array, targets: Array) -> float:
    """Median absolute difference between readings and places as they are, m."""
    return float(np.median(np.abs(_off(table, stations, targets))))


def _fitted(
    table: TableReadings, stations: Array, targets: Array, within: float = _NOMINAL, *, resisting: bool = False
) -> Start:
    """Reweighted as long as some readings are off by far more than the others: gross errors must not lead astray.

    `resisting` also where none is.
    """
    x = np.concatenate([stations.ravel(), targets.ravel()])
    off = np.abs(_off(table, stations, targets))
    usual = max(float(np.median(off)), 1e-9)  # m; 0 where most runs have a single reading
    weight = np.minimum(1.0, _WILD * usual / np.maximum(off, 1e-12)) ** 2
    for _ in range(_REWEIGHTED):
        x, left = _weighted(table, stations, targets, within, x, weight)
        scale = max(float(np.median(np.abs(left))) / 0.6745, 1e-9)
        if not resisting and not (np.abs(left) > _WILD * scale).any() and (weight == 1.0).all():
            break
        before, weight = weight, np.minimum(1.0, _TUNING * scale / np.maximum(np.abs(left), 1e-12))
        if np.abs(weight - before).max() < _AT_REST:
            break
    size = stations.size
    return Start(x[:size].reshape(-1, 3), x[size:].reshape(-1, 3), float(np.median(np.abs(left))))


def _off(table: TableReadings, stations: Array, targets: Array) -> Array:
    """(n,) readings minus what the places say, from the middle of each run, m."""
    length = np.linalg.norm(table.turned(targets) - stations[table.readings.setup], axis=1)
    off = np.asarray(table.readings.displacement - length)
    for run in range(int(table.run.max()) + 1):
        mine = table.run == run
        off[mine] -= np.median(off[mine])
    return off


def _weighted(
    table: TableReadings, stations: Array, targets: Array, within: float, start: Array, weight: Array
) -> tuple[Array, Array]:
    """Stations and targets by weighted least squares from a start, and (n,) the readings' residuals, m."""
    setup, reading = table.readings.setup, table.readings.displacement
    size = len(stations) * 3
    nominal = np.concatenate([stations.ravel(), targets.ravel()])
    count = np.bincount(table.run, weight)
    root = np.sqrt(weight)
    share = np.zeros((len(count), len(reading)))  # of each reading in its run's mean
    share[table.run, np.arange(len(reading))] = weight / count[table.run]

    def centred(values: Array) -> Array:
        return np.asarray(values - (np.bincount(table.run, weight * values) / count)[table.run])

    def split(x: Array) -> tuple[Array, Array]:
        return x[:size].reshape(-1, 3), x[size:].reshape(-1, 3)

    def line(x: Array) -> tuple[Array, Array]:
        s, t = split(x)
        away = table.turned(t) - s[setup]
        length = np.linalg.norm(away, axis=1)
        return length, away / np.maximum(length, 1e-12)[:, None]

    def residual(x: Array) -> Array:
        return np.concatenate([root * centred(line(x)[0] - reading) / _ERRORS, (x - nominal) / within])

    def jacobian(x: Array) -> Array:
        _, g = line(x)
        on_table = np.einsum("nij,ni->nj", table.rotation, g)
        out = np.zeros((len(reading), len(x)))
        rows = np.arange(len(reading))
        for j in range(3):
            out[rows, 3 * setup + j] = -g[:, j]
            out[rows, size + 3 * table.target + j] = on_table[:, j]
        out -= (share @ out)[table.run]
        return np.concatenate([root[:, None] * out / _ERRORS, np.eye(len(x)) / within])

    found = least_squares(residual, start, jacobian, method="lm", xtol=1e-9, ftol=1e-9, gtol=1e-9, max_nfev=60)
    return np.asarray(found.x), centred(line(found.x)[0] - reading)
