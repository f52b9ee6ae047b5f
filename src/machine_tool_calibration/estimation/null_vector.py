"""The one combination of a point's readings in which its own unknowns drop out, where there is just one.

Of d + 1 readings with d unknowns of their own, the projector off these unknowns is w w^T with the unit vector w whose
components are, up to their sign, the d x d minors of the readings' derivatives: products and sums of whole arrays
instead of a factorisation, and without the digits that subtracting two Gram matrices costs.
"""

from __future__ import annotations

from itertools import combinations

import numpy as np

from machine_tool_calibration.arrays import Array, BoolArray

__all__ = ["null_vector"]


def null_vector(local: Array, least: float) -> tuple[Array, BoolArray]:
    """Unit vectors w with local w = 0.

    Args:
        local: (d, d + 1, n) derivatives by the points' own unknowns, 1 <= d.
        least: a point whose normal matrix has a determinant of no more than this times its trace^d is not sound: one of
            its pivots may be smaller than this share of the trace, and there may be more than one such vector.

    Returns:
        (d + 1, n) the vectors, 0 for points that are not sound, and (n,) which are sound.
    """
    d, slots, n = local.shape
    minors: dict[tuple[int, ...], Array] = {(s,): local[0, s] for s in range(slots)}
    scratch = np.empty(n)
    for a in range(1, d):
        larger: dict[tuple[int, ...], Array] = {}
        for chosen in combinations(range(slots), a + 1):
            # Along the last row; its common sign changes no vector.
            value = larger[chosen] = local[a, chosen[0]] * minors[chosen[1:]]
            for j in range(1, a + 1):
                np.multiply(local[a, chosen[j]], minors[chosen[:j] + chosen[j + 1 :]], out=scratch)
                (np.subtract if j % 2 else np.add)(value, scratch, out=value)
        minors = larger
    vector = np.empty((slots, n))
    for s in range(slots):
        rest = minors[tuple(k for k in range(slots) if k != s)]
        np.multiply(rest, -1.0 if s % 2 else 1.0, out=vector[s])
    # The sum of the squared minors is the determinant of the normal matrix (Cauchy and Binet).
    determinant = np.einsum("sn,sn->n", vector, vector)
    trace = np.einsum("dsn,dsn->n", local, local)
    limit = trace * least
    for _ in range(d - 1):
        limit *= trace
    sound = determinant > limit
    if not sound.all():
        vector[:, ~sound] = 0.0
        determinant[~sound] = 1.0
    np.sqrt(determinant, out=determinant)
    vector /= determinant
    return vector, sound
