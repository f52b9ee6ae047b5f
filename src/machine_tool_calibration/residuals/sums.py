# SPDX-License-Identifier: Apache-2.0
"""Sums of residuals (means, slopes, differences) with their uncertainties, which allow for what the model took up."""

from dataclasses import dataclass

import numpy as np

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.model.fit import Fit, screen

# Sums of one pass: few enough for the memory of large sessions.
_BATCH = 64
# Share of its variance that the model leaves a sum, below which the sum says nothing.
_LEFT = 1e-6


@dataclass(frozen=True)
class Sums:
    """Sums w.r of the residuals r."""

    value: Array  # (k,) the sums; NaN where the model takes everything up, so that they are zero whatever was read
    uncertainty: Array  # (k,) their standard uncertainties if the readings have the declared one
    added: Array  # (k,) coefficient of w that the model would find if w were added to it, per unit of w
    added_uncertainty: Array  # (k,) its standard uncertainty


def residual_sums(fit: Fit, weights: Array) -> Sums:
    """Sums with weights w (k, n) of the residuals of a session's fit.

    The residuals of a fitted model are smaller than the readings' errors and go together; with M the projector off the
    model, the variance of w.r is w' V^1/2 M V^1/2 w and not sigma^2 w'w.
    """
    variance = fit.model.sigma**2
    # Columns V w, so that their product with the weighted residuals is w.r.
    value, own, raw = _screened(fit, weights, variance)
    seen = own > _LEFT * np.maximum(raw, np.finfo(float).tiny)
    value, own = np.where(seen, value, np.nan), np.where(seen, own, np.nan)
    # w as a column of the model: the sum with weights V^-1 w over that sum's variance; the same w only where V is even.
    if float(np.ptp(variance)) <= 1e-9 * float(variance.max()):
        return Sums(value, np.sqrt(own), value / own * variance[0], variance[0] / np.sqrt(own))
    product, inner, raw = _screened(fit, weights, np.ones(1))
    inner = np.where(seen & (inner > _LEFT * raw), inner, np.nan)
    return Sums(value, np.sqrt(own), product / inner, 1.0 / np.sqrt(inner))


def _screened(fit: Fit, weights: Array, scale: Array) -> tuple[Array, Array, Array]:
    """Of each column: its product with the residuals, its square outside the model, and its square."""
    out = np.empty((3, len(weights)))
    for first in range(0, len(weights), _BATCH):
        pick = slice(first, first + _BATCH)
        sums = screen(fit, weights[pick] * scale)
        out[:, pick] = sums.gram[:-1, -1], np.diag(sums.gram)[:-1], sums.squares[:-1]
    return out[0], out[1], out[2]
