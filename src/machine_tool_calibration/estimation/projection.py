"""What is left of further columns once a fitted model has taken its share.

Screening an effect costs one pass over the readings and small matrices, not a fit: the reduced Gram matrix of the
model's unknowns and the further columns holds all of it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from machine_tool_calibration.arrays import Array

__all__ = ["Projected", "project"]


@dataclass(frozen=True)
class Projected:
    """Further columns and the residual, with the model projected off; weighted by the declared uncertainty.

    Attributes:
        gram: (k + 1, k + 1) inner products of the k columns and, last, the residual.
        squares: (k + 1,) squared norms before anything was projected off.
        after_points: (k + 1,) squared norms once the points' own unknowns have taken their share.
        response: (m, k) change of the model's shared unknowns per unit of each column that it absorbs.
        names: (k,) of the columns, where they have names.
    """

    gram: Array
    squares: Array
    after_points: Array
    response: Array
    names: tuple[str, ...] = ()


def project(total: Array, squares: Array, half: Array, k: int, names: tuple[str, ...] = ()) -> Projected:
    """Project the model off the last k columns and the residual.

    Args:
        total: (m + k + 1) square reduced Gram matrix of [model, further columns, residual] at the solution.
        squares: (m + k + 1,) squared norms of the columns before the points were eliminated.
        half: (m, r) root of the covariance of the model's shared unknowns under its datum.
        k: number of further columns.
        names: of these.
    """
    m = len(total) - k - 1
    cross = total[:m, m:].copy()
    # At the solution the residual has nothing left along the model; where the model is nearly degenerate, what the
    # iteration left over would be blown up by the covariance.
    cross[:, -1] = 0.0
    # The covariance itself is not formed: its largest entries would leave rounding in what is told well.
    seen = half.T @ cross
    response = half @ seen
    gram = total[m:, m:] - seen.T @ seen
    return Projected((gram + gram.T) / 2, squares[m:], np.diag(total)[m:].copy(), response[:, :k], names)
