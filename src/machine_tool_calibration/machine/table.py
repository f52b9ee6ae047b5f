"""Tables of an error motion: values at nodes of the axis, straight lines between."""

from __future__ import annotations

import numpy as np

from machine_tool_calibration.arrays import Array

__all__ = ["interpolation"]


def interpolation(nodes: Array, position: Array) -> Array:
    """Weights of the nodes at each position (the probing paper's Eqs. (8)(9)).

    Args:
        nodes: (k,) increasing positions of the table, m or rad.
        position: (n,) commanded positions; beyond the last node the last interval is extended.

    Returns:
        (k, n) weights; each column sums to 1.
    """
    k = len(nodes)
    weights = np.zeros((k, len(position)))
    if k == 1:
        weights[0] = 1.0
        return weights
    right = np.clip(np.searchsorted(nodes, position, side="right"), 1, k - 1)
    share = (position - nodes[right - 1]) / (nodes[right] - nodes[right - 1])
    columns = np.arange(len(position))
    weights[right - 1, columns] = 1.0 - share
    weights[right, columns] = share
    return weights
