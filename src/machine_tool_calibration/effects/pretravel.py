"""Pre-travel of a touch-trigger probe."""

from __future__ import annotations

import numpy as np

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.effects.effect import Effect
from machine_tool_calibration.effects.harmonics import harmonic_coefficients, harmonics
from machine_tool_calibration.model.observations import Observations

__all__ = ["ProbePretravel"]

_ORDERS = range(2, 7)


class ProbePretravel(Effect):
    """The way from contact to trigger depends on the direction of the contact's normal (three lobes, typically)."""

    id = "probe_pretravel"
    title = "pre-travel variation of the probe"
    formula = "reading = sum of s_k sin(k normal) + c_k cos(k normal), k = 2 … 6"
    source = "ISO 230-10, pre-travel variation"
    kind = "reading"
    coefficients = harmonic_coefficients(_ORDERS, 3e-5)
    methods = ("probing",)

    def columns(self, observations: Observations, shape: tuple[float, ...] = ()) -> Array:
        """Harmonics of the normal's direction in the machine frame; order 1 is an offset of the stylus."""
        normal = observations.table_direction
        return harmonics(np.arctan2(normal[:, 1], normal[:, 0]), _ORDERS)
