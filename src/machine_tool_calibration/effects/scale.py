"""One relative scale for all axes."""

from __future__ import annotations

import numpy as np

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.effects.effect import Coefficient, Effect
from machine_tool_calibration.model.observations import Observations

__all__ = ["Scale"]


class Scale(Effect):
    """The part or the machine was not at 20 degrees Celsius when it was made or measured."""

    id = "scale"
    title = "one scale for all axes"
    formula = "e = s position"
    source = "ISO 1; linear expansion of part or machine"
    kind = "position"
    coefficients = (Coefficient("s", "1", -2e-3, 2e-3),)
    covariates = ("x", "y", "z", "path", "displacement")
    methods = ("step_diagonal", "tracking_interferometer", "probing", "direct")

    def columns(self, observations: Observations, shape: tuple[float, ...] = ()) -> Array:
        """The position, as far as it is sensed."""
        return np.asarray(np.einsum("nj,nj->n", observations.position, observations.direction))[None]
