# SPDX-License-Identifier: Apache-2.0
"""Pre-travel of a touch-trigger probe."""

from __future__ import annotations

import numpy as np

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.effects.harmonics import HarmonicEffect
from machine_tool_calibration.model.observations import Observations

__all__ = ["ProbePretravel"]


class ProbePretravel(HarmonicEffect):
    """The way from contact to trigger depends on the direction of the contact's normal (three lobes, typically)."""

    id = "probe_pretravel"
    title = "pre-travel variation of the probe"
    formula = "reading = sum of s_k sin(k normal) + c_k cos(k normal), k from 2"
    source = "ISO 230-10, pre-travel variation"
    coefficients = ()
    limit = 3e-5
    covariates = ("normal",)
    methods = ("probing",)

    def angle(self, observations: Observations) -> Array:
        """Direction of the normal in the machine frame."""
        normal = observations.table_direction
        return np.asarray(np.arctan2(normal[:, 1], normal[:, 0]))
