# SPDX-License-Identifier: Apache-2.0
"""What every model lacks a little: smooth functions of where a reading was taken, and laws that hold to some percent.

No model of a real machine is exactly true. What it misses is mostly smooth in place and small; were it not part of the
comparison, the effect of the catalogue that comes nearest to it would be taken for its cause.
"""

from __future__ import annotations

from itertools import combinations
from typing import TYPE_CHECKING

import numpy as np

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.model.observations import Observations

if TYPE_CHECKING:
    from machine_tool_calibration.residuals.pool import Pool

__all__ = ["IMPERFECTION_SIZES", "imperfection", "law_tolerance", "smooth_share"]

IMPERFECTION_SIZES = {0.0: 0.5, 0.25: 0.17, 0.5: 0.17, 1.0: 0.11, 2.0: 0.05}
"""Sizes of what every model lacks, in units of the noise, with their prior probabilities: no larger than the readings
scatter, since what is larger is an effect, or a structure to be named."""

# Highest degree of a coordinate, and of a product of two; highest order of a wave in an angle.
_DEGREE, _TOGETHER, _ORDER = 4, 3, 4
# Degrees of the deviation from a law, in time and in the effect's own size.
_IN_TIME, _IN_SIZE = 4, 2


def imperfection(observations: Observations) -> Array:
    """(k, n) smooth functions of place, whose sum has about the size 1 if each coefficient is of size 1.

    Legendre polynomials of the coordinates that vary, products of two of them, and waves in the angles. None where the
    machine's errors are read themselves: there a smooth function of place is an error motion, and to be named.
    """
    if observations.session.spec.reads_machine:
        return np.zeros((0, len(observations)))
    place = {a: v for a, v in zip("xyz", observations.position.T, strict=True)}
    scaled = {a: s for a, s in ((a, _scaled(v)) for a, v in place.items()) if s is not None}
    series = {a: np.polynomial.legendre.legvander(s, _DEGREE).T for a, s in scaled.items()}
    out = [values[d] / d for values in series.values() for d in range(1, _DEGREE + 1)]
    for a, b in combinations(series, 2):
        degrees = [(i, j) for i in range(1, _TOGETHER) for j in range(1, _TOGETHER) if i + j <= _TOGETHER]
        out += [series[a][i] * series[b][j] / (i + j) for i, j in degrees]
    for angle in _angles(observations):
        out += [wave(k * angle) / k for k in range(1, _ORDER + 1) for wave in (np.sin, np.cos)]
    if not out:
        return np.zeros((0, len(observations)))
    columns = np.array(out)
    whole = np.sqrt(np.mean(np.sum(columns**2, axis=0)))
    return np.asarray(columns / max(float(whole), 1e-300))


def law_tolerance(pool: Pool, signal: Array, tolerance: float) -> Array:
    """(j, n) by what an effect may differ from its law, each per standard deviation, m: of Z b (1 + delta) the Z b delta.

    The relative deviation delta is smooth in time; where no time was recorded, in the size of the effect itself.

    Args:
        pool: the readings.
        signal: (n,) what the effect changes in the readings, m.
        tolerance: root mean square of delta.
    """
    functions = smooth_share(pool, signal)
    # Most of an effect may be taken up by the model: what shows of the deviation is limited by what shows of the effect.
    inner = np.diag(pool.screen(np.concatenate([signal[None], functions])).gram)[:-1]
    shown = np.sqrt(np.maximum(inner, 0.0))
    share = np.minimum(shown[0] / np.maximum(shown[1:], 1e-300), 1.0)
    return np.asarray(tolerance / np.sqrt(max(len(functions), 1)) * share[:, None] * functions)


def smooth_share(pool: Pool, signal: Array) -> Array:
    """(j, n) a signal times smooth functions, of root mean square 1, of time; of its own size where there is no time."""
    time = np.concatenate([o.clock if o.timed else np.zeros(len(o)) for o in pool.observations])
    covariate, degree = (time, _IN_TIME) if np.ptp(time) > 0 else (signal, _IN_SIZE)
    scaled = _scaled(covariate)
    if scaled is None:
        return np.zeros((0, len(pool)))
    functions = np.polynomial.legendre.legvander(scaled, degree).T[1:]
    functions /= np.sqrt(np.mean(functions**2, axis=1, keepdims=True))
    return np.asarray(functions * signal)


def _angles(observations: Observations) -> list[Array]:
    angles = []
    if "c" in observations.readings.columns:
        angles.append(observations.readings.columns["c"])
    spec = observations.session.spec
    if spec.beam_from_pointer:
        angles.append(np.arctan2(observations.direction[:, 1], observations.direction[:, 0]))
    if spec.probes_surface:
        angles.append(np.arctan2(observations.table_direction[:, 1], observations.table_direction[:, 0]))
    return [angle for angle in angles if np.ptp(angle) > 0]


def _scaled(values: Array) -> Array | None:
    half = float(np.ptp(values)) / 2.0 if len(values) else 0.0
    return (values - values.min()) / half - 1.0 if half > 1e-12 else None
