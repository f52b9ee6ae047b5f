# SPDX-License-Identifier: Apache-2.0
"""Columns and readings at random, their inner products, and what is known of these by explicit covariance matrices."""

import numpy as np

from machine_tool_calibration.estimation import priors
from machine_tool_calibration.estimation.marginal import Gram

N = 24


def columns(seed: int, count: int, size: float = 1.0) -> np.ndarray:
    """(N, count) at random."""
    return size * np.random.default_rng(seed).normal(size=(N, count))


def gram_of(candidates: np.ndarray, spread: np.ndarray, readings: np.ndarray) -> Gram:
    """Inner products without any model: all that lies outside it is everything."""
    every, family = np.column_stack([candidates, spread]), np.zeros(spread.shape[1], dtype=np.int64)
    return Gram(every.T @ every, every.T @ readings, float(readings @ readings), family, len(readings))


def log_marginal(readings: np.ndarray, covariance: np.ndarray) -> float:
    """log p(y) up to what all models share, the variance of the noise integrated with what was declared as prior."""
    squares = float(readings @ np.linalg.solve(covariance, readings))
    determinant = np.linalg.slogdet(covariance)[1]
    return float(-0.5 * determinant - 0.5 * (N + priors.DECLARED_DOF) * np.log(priors.DECLARED_DOF + squares))
