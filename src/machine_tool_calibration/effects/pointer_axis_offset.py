# SPDX-License-Identifier: Apache-2.0
"""Offsets of a pointer's axes: reading = -d cos(elevation) - q / (2 path) (Hughes et al. 2011, ISO 10360-10)."""

import numpy as np

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.effects import pointed_beam
from machine_tool_calibration.effects.effect import Coefficient, Effect
from machine_tool_calibration.model.observations import Observations
from machine_tool_calibration.words import say


class PointerAxisOffset(Effect):
    """The elevation axis stands in front of the azimuth axis by d, and the beam passes it at a distance h.

    The axis in front turns with the azimuth, towards the target: the path is shorter by d cos(elevation). A beam that
    follows the target and misses the elevation axis by h reads a leg of the triangle: shorter by h^2 / (2 path); one
    that is held on its direction (open loop) reads the projection whatever h. In a plane, where the elevation does not
    change, the dead path takes d up.
    """

    id = "pointer_axis_offset"
    title = say("effect.pointer_axes")
    formula = say("formula.pointer_axes")
    source = "Hughes et al. 2011, laser tracker error determination; ISO 10360-10, offset of axes and beam"
    kind = "reading"
    coefficients = (
        Coefficient("d", "m", -1e-3, 1e-3, say("coefficient.elevation_in_front")),
        Coefficient("q", "m^2", 0.0, 1e-5, say("coefficient.beam_off")),
    )
    covariates = ("elevation", "path")
    methods = pointed_beam.POINTED_METHODS
    instruments = pointed_beam.POINTED_INSTRUMENTS

    def coefficients_for(self, observations: Observations, shape: tuple[float, ...] = ()) -> tuple[Coefficient, ...]:
        """The beam's distance only where the beam follows."""
        return self.coefficients[:1] if pointed_beam.is_open_loop(observations) else self.coefficients

    def columns(self, observations: Observations, shape: tuple[float, ...] = ()) -> Array:
        """Minus the cosine of the beam's elevation, and minus the reciprocal of twice the path."""
        every = np.asarray([-pointed_beam.cosine_of_elevation(observations), -0.5 / observations.path])
        return every[: len(self.coefficients_for(observations))]
