# SPDX-License-Identifier: Apache-2.0
"""Models put together and solved by least squares."""

from dataclasses import dataclass
from functools import cached_property

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.estimation.problem import Problem
from machine_tool_calibration.estimation.robust import scaled_residuals
from machine_tool_calibration.estimation.solve import Solution
from machine_tool_calibration.model.model import Assembly, assemble
from machine_tool_calibration.model.random_unknowns import RandomUnknowns


@dataclass(frozen=True)
class Solved:
    """Several sessions in one problem; for a single session it has one part."""

    assembly: Assembly  # the models and their problem
    solution: Solution  # where the sum of squares is least, every reading for itself
    random: RandomUnknowns | None = None  # unknowns that are small random functions; None without any

    def normalised(self, index: int) -> Array:
        """(n,) measured minus predicted over the declared uncertainty, of a session."""
        part = self.assembly.problem.parts[index]
        return scaled_residuals(part, self.solution.theta, self.solution.local[index])

    @cached_property
    def without_expectations(self) -> Problem:
        """The problem without what is expected of unknowns that are random functions."""
        if self.random is None:
            return self.assembly.problem
        names = frozenset(self.random.names)
        return assemble([model.without_priors(names) for model in self.assembly.models], self.assembly.labels).problem
