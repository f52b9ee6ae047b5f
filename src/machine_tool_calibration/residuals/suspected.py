# SPDX-License-Identifier: Apache-2.0
"""Which of the readings that were held out stand out of all others."""

from __future__ import annotations

import numpy as np

from machine_tool_calibration.arrays import Array, IntArray

__all__ = ["HELD", "UNSEEN", "standing_out", "told"]

HELD = 1e-8
"""Weight of a reading that is held out: it still places what nothing else places."""

UNSEEN = 1e-6
"""A residual that holds less than this of its reading's variance says nothing of it."""


def told(products: Array, deviation: Array, weight: Array) -> tuple[Array, Array]:
    """What all other readings tell of a few.

    Args:
        products: (k, k) covariance of the predictions of these readings, in which they took part themselves.
        deviation: (k,) of the readings from these predictions.
        weight: (k,) with which each took part, between `HELD` and 1.

    Returns:
        (k, k) inverse covariance of the deviations from predictions in which they have no part at all, and (k,) the
        inverse times these deviations.
    """
    # With h the variance of a prediction without them, h / (1 + w h) is the one at hand. Of what they alone determine,
    # all of it is theirs.
    root = np.sqrt(weight)
    share, vectors = np.linalg.eigh(root[:, None] * products * root)
    shared = share < 1.0 - UNSEEN
    share, some = np.maximum(share[shared], 0.0), vectors[:, shared]
    inverse = some @ np.linalg.solve((some.T * weight) @ some + np.diag(share / (1.0 - share)), some.T)
    inverse = root[:, None] * inverse * root
    return inverse, weight * deviation + inverse @ ((1.0 - weight) * deviation)


def standing_out(products: Array, deviation: Array, limit: float) -> IntArray:
    """Set aside the worst of the suspected, judge the others anew, and put back what stands out no longer.

    Args:
        products: (k, k) covariance of the predictions of the suspected, which took part with the weight `HELD`.
        deviation: (k,) of the suspected from these predictions.
        limit: of a deviation over its standard uncertainty.

    Returns:
        Indices of those that stand out.
    """
    if len(deviation) == 1 and HELD * products[0, 0] < 1e-3:
        return np.flatnonzero(np.abs(deviation) > limit * np.sqrt(1.0 + np.diag(products)))
    inverse, pulled = told(products, deviation, np.full(len(deviation), HELD))
    # With all put back: the residuals over what they would be with a variance of one, and what each is known by.
    whole, pull = inverse.copy(), pulled.copy()
    apart = np.zeros(len(deviation), dtype=bool)
    while True:
        seen = np.diag(inverse)
        size = np.where(apart | (seen < UNSEEN), 0.0, np.abs(pulled) / np.sqrt(np.maximum(seen, UNSEEN)))
        worst = int(np.argmax(size))
        if size[worst] <= limit:
            break
        apart[worst] = True
        column = inverse[:, worst] / inverse[worst, worst]
        pulled = pulled - column * pulled[worst]
        inverse = inverse - np.outer(column, inverse[worst])
    while apart.any():
        out = np.flatnonzero(apart)
        spread = np.linalg.inv(whole[np.ix_(out, out)])
        size = np.abs(spread @ pull[out]) / np.sqrt(np.diag(spread))
        least = int(np.argmin(size))
        if size[least] > limit:
            break
        apart[out[least]] = False
    return np.flatnonzero(apart)
