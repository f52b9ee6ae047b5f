# SPDX-License-Identifier: Apache-2.0
"""Zero of a pointer's azimuth: reading = -q path cos(elevation)^2 (Ibaraki et al. 2014)."""

import numpy as np

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.effects.effect import Coefficient, Effect
from machine_tool_calibration.effects.pointed_beam import cosine_of_elevation, is_open_loop
from machine_tool_calibration.model.observations import Observations
from machine_tool_calibration.words import say


class PointerZeroOffset(Effect):
    """The azimuth counts from another zero: a beam that is held reads the path's projection (cosine error).

    Turned about the azimuth axis by a small angle, a beam is off its direction by cos(elevation) times the angle. One
    that follows the target stays on it wherever the azimuth counts from. An elevation's zero makes all paths shorter
    alike, as a scale does.
    """

    id = "pointer_zero_offset"
    title = say("effect.pointer_zero")
    formula = say("formula.pointer_zero")
    source = "Ibaraki et al. 2014, Section 4 and Table 4, u41"
    kind = "reading"
    coefficients = (Coefficient("q", "1", 0.0, 2e-4, say("coefficient.half_square")),)
    covariates = ("path", "displacement")
    methods = ("tracking_interferometer",)
    instruments = ("tracking_interferometer",)

    def why_not(self, observations: Observations) -> str | None:
        """Also where the beam follows the target."""
        if (why := super().why_not(observations)) is not None:
            return why
        return None if is_open_loop(observations) else "does not occur where the beam follows the target"

    def columns(self, observations: Observations, shape: tuple[float, ...] = ()) -> Array:
        """Minus the path's part in the plane of azimuth, times the cosine of the elevation."""
        return np.asarray(-observations.path * cosine_of_elevation(observations) ** 2)[None]
