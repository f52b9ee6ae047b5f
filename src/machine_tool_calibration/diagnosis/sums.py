"""Weighted sums of residuals with the uncertainty that they have although a model was fitted."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.model.fit import Fit, screen

__all__ = ["Sums", "residual_sums"]

# Sums of one pass: few enough for the memory of large sessions.
_BATCH = 64
# Share of its variance that the model leaves a sum, below which the sum says nothing.
_LEFT = 1e-6


@dataclass(frozen=True)
class Sums:
    """Sums w.r of the residuals r.

    Attributes:
        value: (k,) the sums; NaN where the model takes everything up, so that they are zero whatever was read.
        uncertainty: (k,) their standard uncertainties if the readings have the declared one.
        added: (k,) coefficient of w that the model would find if w were added to it, per unit of w.
        added_uncertainty: (k,) its standard uncertainty.
    """

    value: Array
    uncertainty: Array
    added: Array
    added_uncertainty: Array


def residual_sums(fit: Fit, weights: Array) -> Sums:
    """Sums of the residuals of a fit.

    The residuals of a fitted model are smaller than the readings' errors and go together; with M the projector off the
    model, the variance of w.r is w' V^1/2 M V^1/2 w and not sigma^2 w'w.

    Args:
        fit: of a single session.
        weights: (k, n).
    """
    variance = fit.model.sigma**2
    value, own, raw, slope = (np.empty(len(weights)) for _ in range(4))
    for first in range(0, len(weights), _BATCH):
        pick = slice(first, first + _BATCH)
        # Columns V w, so that their product with the weighted residuals is w.r.
        sums = screen(fit, weights[pick] * variance)
        value[pick], own[pick], raw[pick] = sums.gram[:-1, -1], np.diag(sums.gram)[:-1], sums.squares[:-1]
    seen = own > _LEFT * np.maximum(raw, np.finfo(float).tiny)
    value = np.where(seen, value, np.nan)
    own = np.where(seen, own, np.nan)
    # w as a column of the model: the sum with weights V^-1 w over that sum's variance; the same w only where V is even.
    even = float(np.ptp(variance)) <= 1e-9 * float(variance.max())
    if even:
        slope = value / own * variance[0]
        slope_u = variance[0] / np.sqrt(own)
    else:
        slope, slope_u = np.empty(len(weights)), np.empty(len(weights))
        for first in range(0, len(weights), _BATCH):
            pick = slice(first, first + _BATCH)
            sums = screen(fit, weights[pick])
            inner = np.where(seen[pick], np.diag(sums.gram)[:-1], np.nan)
            slope[pick], slope_u[pick] = sums.gram[:-1, -1] / inner, 1.0 / np.sqrt(inner)
    return Sums(value, np.sqrt(own), slope, slope_u)
