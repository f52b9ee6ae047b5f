"""Array types used throughout."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

__all__ = ["Array", "BoolArray", "IntArray", "groups"]

Array = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]
BoolArray = npt.NDArray[np.bool_]


def groups(*keys: IntArray) -> IntArray:
    """(n,) number of the group of each entry, from 0: entries with the same keys share one; sorted by the keys.

    As `np.unique` of the stacked keys does, without sorting columns.

    Args:
        keys: one or several (n,) of small integers from 0.
    """
    code = keys[0].astype(np.int64)
    for key in keys[1:]:
        code = code * (int(key.max(initial=0)) + 1) + key
    return np.unique(code, return_inverse=True)[1].reshape(-1)
