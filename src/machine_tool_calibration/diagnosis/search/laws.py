# SPDX-License-Identifier: Apache-2.0
"""Laws that hold to some percent: by what an effect may differ from its columns times its coefficients."""

from __future__ import annotations

import numpy as np

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.model.imperfection import scaled
from machine_tool_calibration.residuals.pool import Pool

__all__ = ["law_tolerance", "smooth_share"]

# Degrees of the relative deviation, in time and in the effect's own size.
_IN_TIME, _IN_SIZE = 4, 2


def law_tolerance(pool: Pool, signal: Array, tolerance: float) -> Array:
    """(j, n) by what an effect may differ from its law, m per standard deviation: of Z b (1 + delta) the Z b delta.

    The relative deviation delta is smooth in time; where no time was recorded, in the size of the effect itself.

    Args:
        pool: the readings.
        signal: (n,) what the effect changes in the readings, m.
        tolerance: root mean square of delta.
    """
    functions = smooth_share(pool, signal)
    # The model may absorb most of an effect: what shows of the deviation is limited by what shows of the effect.
    inner = np.diag(pool.screen(np.concatenate([signal[None], functions])).gram)[:-1]
    shown = np.sqrt(np.maximum(inner, 0.0))
    share = np.minimum(shown[0] / np.maximum(shown[1:], 1e-300), 1.0)
    return np.asarray(tolerance / np.sqrt(max(len(functions), 1)) * share[:, None] * functions)


def smooth_share(pool: Pool, signal: Array) -> Array:
    """(j, n) a signal times smooth functions of time, or of its own size where no time was recorded."""
    time = np.concatenate([o.clock if o.timed else np.zeros(len(o)) for o in pool.observations])
    covariate, degree = (time, _IN_TIME) if np.ptp(time) > 0 else (signal, _IN_SIZE)
    within = scaled(covariate)
    if within is None:
        return np.zeros((0, len(pool)))
    functions = np.polynomial.legendre.legvander(within, degree).T[1:]
    functions /= np.sqrt(np.mean(functions**2, axis=1, keepdims=True))
    return np.asarray(functions * signal)
