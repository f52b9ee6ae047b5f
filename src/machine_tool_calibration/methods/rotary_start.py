"""Where stations and targets stand if the table turned without error: the point from which the fit sets out."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.methods.rotary_geometry import TableReadings

__all__ = ["Start", "find_start"]

# Errors of a rotary axis are some micrometres; a nominal position may be wrong by centimetres. Both only shape the way
# to the start: the fit that follows holds no such knowledge.
_ERRORS = 1e-5
_NOMINAL = 0.05


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


def find_start(table: TableReadings, stations: Array, targets: Array) -> Start:
    """Fit stations and targets with the table turning without error.

    The datum of each run is taken out by subtracting the run's mean.

    Args:
        table: the readings.
        stations: (S, 3) nominal, m.
        targets: (T, 3) nominal at c = 0, m.
    """
    setup, reading = table.readings.setup, table.readings.displacement
    size = len(stations) * 3
    nominal = np.concatenate([stations.ravel(), targets.ravel()])
    count = np.bincount(table.run).astype(float)

    def centred(values: Array) -> Array:
        return np.asarray(values - (np.bincount(table.run, values) / count)[table.run])

    def split(x: Array) -> tuple[Array, Array]:
        return x[:size].reshape(-1, 3), x[size:].reshape(-1, 3)

    def line(x: Array) -> tuple[Array, Array]:
        s, t = split(x)
        away = table.turned(t) - s[setup]
        length = np.linalg.norm(away, axis=1)
        return length, away / np.maximum(length, 1e-12)[:, None]

    def residual(x: Array) -> Array:
        return np.concatenate([centred(line(x)[0] - reading) / _ERRORS, (x - nominal) / _NOMINAL])

    def jacobian(x: Array) -> Array:
        _, g = line(x)
        on_table = np.einsum("nij,ni->nj", table.rotation, g)
        out = np.zeros((len(reading), len(x)))
        rows = np.arange(len(reading))
        for j in range(3):
            out[rows, 3 * setup + j] = -g[:, j]
            out[rows, size + 3 * table.target + j] = on_table[:, j]
        mean = np.zeros((len(count), len(x)))
        np.add.at(mean, table.run, out)
        out -= (mean / count[:, None])[table.run]
        return np.concatenate([out / _ERRORS, np.eye(len(x)) / _NOMINAL])

    found = least_squares(residual, nominal, jacobian, method="trf", xtol=1e-9, ftol=1e-9, gtol=1e-9, max_nfev=60)
    at_stations, at_targets = split(np.asarray(found.x))
    misfit = float(np.median(np.abs(centred(line(found.x)[0] - reading))))
    return Start(at_stations, at_targets, misfit)
