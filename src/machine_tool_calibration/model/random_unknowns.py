# SPDX-License-Identifier: Apache-2.0
"""Unknowns of a model that are small random functions, such as angular errors that are hardly there."""

from dataclasses import dataclass
from typing import Protocol

from machine_tool_calibration.arrays import Array


@dataclass(frozen=True)
class RandomPosterior:
    """What the readings say of unknowns that are random functions."""

    size: float  # root mean square of their size over all that is possible, in their unit
    probability: float  # that they are not zero
    theta: Array  # (m,) mean of all unknowns, the random ones last and counted from zero
    covariance: Array  # (m, m) of these


class RandomUnknowns(Protocol):
    """Unknowns of a model that are small random functions, and what is expected of them."""

    @property
    def names(self) -> tuple[str, ...]:
        """Of the unknowns."""

    @property
    def root(self) -> Array:
        """(q, r) unknowns per unit of r independent coefficients whose standard deviation is the functions' size."""

    @property
    def sizes(self) -> dict[float, float]:
        """Sizes that are possible, in their unit, with their probabilities before any reading; 0 among them."""

    def posterior(
        self, matrix: Array, right: Array, constraints: Array, values: Array, squares: Array
    ) -> RandomPosterior:
        """From the normal equations of all unknowns, these last and without what is expected of them."""
