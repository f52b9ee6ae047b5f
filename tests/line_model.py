# SPDX-License-Identifier: Apache-2.0
"""The smallest model there is: an offset of all readings, beside terms."""

from dataclasses import dataclass

import numpy as np

from machine_tool_calibration.arrays import IntArray
from machine_tool_calibration.estimation.problem import LinearPart, Part, group_rows
from machine_tool_calibration.model.model import MethodModel, Parameter


@dataclass(frozen=True)
class Line(MethodModel):
    """Readings of an offset, which counts from a reference, m, and of terms."""

    reference: float = 0.0

    @property
    def own(self) -> tuple[Parameter, ...]:
        return (Parameter("offset", "m", reference=self.reference),)

    def part(self, own_index: IntArray, dense_index: IntArray) -> Part:
        n = len(self.observations)
        return LinearPart(
            group_rows(np.zeros(n, dtype=np.int64)),
            self.observations.readings.displacement,
            self.sigma,
            np.zeros((0, n)),
            np.ones((1, n)),
            self.dense(),
            own_index.reshape(1, 1),
            dense_index,
        )
