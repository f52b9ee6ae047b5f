# SPDX-License-Identifier: Apache-2.0
"""What residuals can be drawn against: recorded columns, and what follows from the geometry."""

from collections.abc import Mapping

import numpy as np

from machine_tool_calibration.arrays import Array, IntArray
from machine_tool_calibration.effects.error_motion import sensed_motion
from machine_tool_calibration.machine.error_motions import ErrorMotion
from machine_tool_calibration.model.observations import Observations, azimuth
from machine_tool_calibration.session.catalogue import spec_of

LEAST_SENSITIVITY = 1e-6  # change of a reading per displacement of an axis that is sensed, m/m (C: m/rad)
_BINS = 8


def covariates(observations: Observations) -> dict[str, Array]:
    """Everything that varies from reading to reading, in SI units, by name.

    Returns:
        (n,) arrays, NaN where a column has gaps: the recorded columns; `order` in the recording; `path`; `azimuth` and
        `elevation` of the sensed direction; `normal`, the angle of a probed surface's normal; and for each axis
        `dir_x along x`: the direction of approach times how much a displacement of X changes the reading (C: m/rad).
    """
    readings = observations.readings
    out: dict[str, Array] = {"order": readings.row.astype(float), "repeat": readings.repeat.astype(float)}
    out |= {name: values for name, values in readings.columns.items() if name not in ("gx", "gy", "gz")}
    if np.ptp(observations.path) > 0:
        out["path"] = observations.path
    if spec_of(observations.session).beam_from_pointer:
        out.setdefault("azimuth", azimuth(observations.direction))
        out.setdefault("elevation", np.arcsin(np.clip(observations.direction[:, 2], -1.0, 1.0)))
    if spec_of(observations.session).probes_surface:
        out["normal"] = azimuth(observations.table_direction)
    for axis in "xyzabc":
        approach = readings.columns.get(f"dir_{axis}")
        along = sensed(observations, axis)
        if approach is not None and np.ptp(along) > LEAST_SENSITIVITY:
            out[f"dir_{axis} along {axis}"] = approach * along
    return {name: values for name, values in out.items() if _varies(values)}


def sensed(observations: Observations, axis: str) -> Array:
    """(n,) change of each reading with a displacement of x, y or z, 1, or with a turn of a, b or c, m/rad."""
    if axis in "xyz":
        return observations.direction[:, "xyz".index(axis)]
    return sensed_motion(observations, ErrorMotion(axis.upper(), axis.upper()))


def rank_covariates(values: Mapping[str, Array], residual: Array, most: int = _BINS) -> list[tuple[str, float]]:
    """Covariates in the order in which a running mean over them follows the residuals (n,).

    For the choice of pictures only: it tests nothing, and covariates that go together all come first. Names with the
    share of the residuals' variance that the mean in so many bins takes, adjusted for their number.
    """
    shares = []
    for name, column in values.items():
        good = np.isfinite(column)
        part, number = residual[good], bins(column[good], most)
        count = np.bincount(number)
        mean = np.bincount(number, part) / np.maximum(count, 1)
        total = float(np.sum((part - part.mean()) ** 2))
        left, k = float(np.sum((part - mean[number]) ** 2)), int((count > 0).sum())
        if total <= 0 or len(part) <= k + 1:
            continue
        shares.append((name, 1.0 - left / total * (len(part) - 1) / (len(part) - k)))
    return sorted(shares, key=lambda entry: -entry[1])


def bins(values: Array, most: int = _BINS) -> IntArray:
    """(n,) number of each value's bin: one for each distinct value where these are few, else equally filled ones."""
    # Positions that differ by rounding are the same.
    extent = float(np.ptp(values)) if len(values) else 0.0
    rounded = np.round(values / max(extent, 1e-300), 6)
    distinct, number = np.unique(rounded, return_inverse=True)
    if len(distinct) <= most:
        return np.asarray(number.reshape(-1))
    edges = np.quantile(rounded, np.linspace(0.0, 1.0, most + 1)[1:-1])
    return np.searchsorted(np.unique(edges), rounded, side="right")


def _varies(values: Array) -> bool:
    good = values[np.isfinite(values)]
    return len(good) > 1 and float(np.ptp(good)) > 1e-9 * max(float(np.abs(good).max()), 1e-9)
