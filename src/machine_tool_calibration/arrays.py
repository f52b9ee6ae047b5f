"""Array types used throughout."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

__all__ = ["Array", "BoolArray", "IntArray"]

Array = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]
BoolArray = npt.NDArray[np.bool_]
