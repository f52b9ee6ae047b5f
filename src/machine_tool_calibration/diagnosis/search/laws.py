# SPDX-License-Identifier: Apache-2.0
"""Laws that hold to some percent: by what an effect may differ from its columns times its coefficients."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.effects.effect import Effect
from machine_tool_calibration.model.fit import JointFit
from machine_tool_calibration.model.imperfection import scaled_values
from machine_tool_calibration.model.result import effect_signal
from machine_tool_calibration.residuals.pool import Pool

# Highest degree of the relative deviation in time.
_DEGREE = 4


def law_tolerance(pool: Pool, signal: Array, tolerance: float) -> Array:
    """(j, n) by what an effect may differ from its law, m per standard deviation: of Z b (1 + delta) the Z b delta.

    Z b is the signal (n,), m; the relative deviation delta, whose root mean square is the tolerance, is smooth in time:
    where no time was recorded there is none.
    """
    functions = smooth_share(pool, signal)
    # The model may absorb most of an effect: what shows of the deviation is limited by what shows of the effect.
    inner = np.diag(pool.screen(np.concatenate([signal[None], functions])).gram)[:-1]
    shown = np.sqrt(np.maximum(inner, 0.0))
    share = np.minimum(shown[0] / np.maximum(shown[1:], 1e-300), 1.0)
    return np.asarray(tolerance / np.sqrt(max(len(functions), 1)) * share[:, None] * functions)


def with_laws(fit: JointFit, effects: Sequence[Effect]) -> Pool:
    """The readings of a fit, with what the laws of the effects in its model leave open."""
    pool = Pool(fit)
    functions = [
        effect.tolerance * smooth_share(pool, effect_signal(fit, effect.id)[0]) / np.sqrt(_DEGREE)
        for effect in effects
        if effect.tolerance > 0.0
    ]
    laws = np.concatenate([np.zeros((0, len(pool))), *functions])
    return replace(pool, laws=laws) if len(laws) else pool


def smooth_share(pool: Pool, signal: Array) -> Array:
    """(j, n) a signal times smooth functions of time; none where no time was recorded."""
    time = scaled_values(np.concatenate([o.clock if o.timed else np.zeros(len(o)) for o in pool.observations]))
    if time is None:
        return np.zeros((0, len(pool)))
    functions = np.polynomial.legendre.legvander(time, _DEGREE).T[1:]
    functions /= np.sqrt(np.mean(functions**2, axis=1, keepdims=True))
    return np.asarray(functions * signal)
