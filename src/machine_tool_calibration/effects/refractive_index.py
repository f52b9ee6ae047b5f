# SPDX-License-Identifier: Apache-2.0
"""Refractive index n of the air, not compensated in full: reading = g (n - n_standard) path (Edlén)."""

import numpy as np

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.effects.effect import Coefficient
from machine_tool_calibration.effects.families import AirEffect
from machine_tool_calibration.model.observations import Observations
from machine_tool_calibration.words import say


class RefractiveIndex(AirEffect):
    """The part g of the wavelength's compensation that is missing, in proportion to the path (Edlén)."""

    id = "refractive_index"
    title = say("effect.air")
    formula = say("formula.air")
    source = "Edlén; Bönsch and Potulski 1998; ISO 230-2:2014 Annex on laser interferometers"
    coefficients = (Coefficient("g", "1", -20.0, 20.0, say("coefficient.not_compensated"), usual=2.0),)
    covariates = (*AirEffect.covariates, "path", "displacement")

    def columns(self, observations: Observations, shape: tuple[float, ...] = ()) -> Array:
        """Deviation of the index times path."""
        return np.asarray(self.deviation(observations) * observations.path)[None]
