# SPDX-License-Identifier: Apache-2.0
"""Columns and readings at random, their inner products, and what is known of these by explicit covariance matrices."""

import numpy as np
from scipy.stats import multivariate_t

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
    """log p(y) up to what all models share: of a multivariate Student distribution for each prior of the noise."""
    shape = [multivariate_t(shape=covariance, df=dof).logpdf(readings) for dof in priors.NOISE_DOF]
    return float(np.logaddexp(*shape)) + ALL_SHARE


ALL_SHARE = 0.5 * N * np.log(np.pi)
"""What `Gram.log_likelihood` leaves out: what the readings' number alone gives to any model."""
