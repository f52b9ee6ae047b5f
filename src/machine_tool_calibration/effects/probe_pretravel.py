# SPDX-License-Identifier: Apache-2.0
"""Pre-travel of a probe, in waves over the direction of the contact's normal (ISO 230-10)."""

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.effects.families import HarmonicEffect
from machine_tool_calibration.model.observations import Observations, azimuth
from machine_tool_calibration.words import say


class ProbePretravel(HarmonicEffect):
    """The way from contact to trigger depends on the direction of the contact's normal (three lobes, typically)."""

    id = "probe_pretravel"
    title = say("effect.pretravel")
    formula = say("formula.harmonics", angle=say("formula.angle_normal"))
    source = "ISO 230-10, pre-travel variation"
    limit = 3e-5
    covariates = ("normal",)
    methods = ("probing",)

    def angle(self, observations: Observations) -> Array:
        """Direction of the normal in the machine frame."""
        return azimuth(observations.table_direction)
