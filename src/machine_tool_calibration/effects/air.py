# SPDX-License-Identifier: Apache-2.0
"""The air's refractive index, as far as the instrument did not compensate it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.effects.effect import Coefficient, Effect
from machine_tool_calibration.instruments.refractive_index import index_deviation
from machine_tool_calibration.model.observations import Observations
from machine_tool_calibration.words import say

__all__ = ["DeadPath", "RefractiveIndex"]

# A beam in air whose wavelength measures.
_BEAMS = ("laser_interferometer", "tracking_interferometer", "laser_tracker")
_OPTICAL = ("step_diagonal", "tracking_interferometer", "rotary_axis", "direct")


# A dead path of this length is usual on any machine, m.
_LEAST_USUAL = 0.5


def _deviation(observations: Observations) -> Array:
    columns = observations.readings.columns
    return index_deviation(columns["temperature_air"], columns.get("air_pressure"), columns.get("relative_humidity"))


class RefractiveIndex(Effect):
    """The part g of the wavelength's compensation that is missing, in proportion to the path (Edlén)."""

    id = "refractive_index"
    title = say("effect.air")
    formula = say("formula.air")
    source = "Edlén; Bönsch and Potulski 1998; ISO 230-2:2014 Annex on laser interferometers"
    kind = "reading"
    coefficients = (Coefficient("g", "1", -20.0, 20.0, say("coefficient.not_compensated"), usual=2.0),)
    needs = ("temperature_air",)
    covariates = ("temperature_air", "air_pressure", "relative_humidity", "path", "displacement")
    methods = _OPTICAL
    instruments = _BEAMS

    def columns(self, observations: Observations, shape: tuple[float, ...] = ()) -> Array:
        """Deviation of the index times path."""
        return np.asarray(_deviation(observations) * observations.path)[None]


class DeadPath(Effect):
    """The path in front of the datum, which is not in the reading but changes with the air (ISO 230-2)."""

    id = "dead_path"
    title = say("effect.dead_path")
    formula = say("formula.dead_path")
    source = "ISO 230-2:2014, dead path; Ibaraki et al. 2014, Table 4, u14"
    kind = "reading"
    coefficients = (Coefficient("D", "m", -20.0, 20.0, say("coefficient.dead_path"), usual=_LEAST_USUAL),)
    needs = ("temperature_air",)
    covariates = ("temperature_air", "air_pressure", "relative_humidity")
    methods = _OPTICAL
    instruments = _BEAMS

    def coefficients_for(self, observations: Observations, shape: tuple[float, ...] = ()) -> tuple[Coefficient, ...]:
        """Usually no longer than the machine or the paths that were measured: who has a longer one sees it."""
        travel = [abs(end - start) for start, end in observations.session.description.machine.travel.values()]
        longest = max([_LEAST_USUAL, *travel, float(np.abs(observations.path).max(initial=0.0))])
        return (replace(self.coefficients[0], usual=longest),)

    def columns(self, observations: Observations, shape: tuple[float, ...] = ()) -> Array:
        """Deviation of the index."""
        return np.asarray(_deviation(observations))[None]
