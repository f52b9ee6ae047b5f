"""Form error of the retroreflector."""

from __future__ import annotations

import numpy as np

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.effects.effect import Effect
from machine_tool_calibration.effects.harmonics import harmonic_coefficients, harmonics
from machine_tool_calibration.effects.pointer import beam_azimuth
from machine_tool_calibration.model.observations import Observations

__all__ = ["RetroreflectorForm"]

_ORDERS = range(2, 7)


class RetroreflectorForm(Effect):
    """Path change with the direction in which the beam meets the retroreflector.

    The retroreflector keeps its orientation to the machine on a spindle, and turns with a rotary table. In a plane
    the angle of incidence is the azimuth; in space it is the angle to the spindle's axis.
    """

    id = "retroreflector_form"
    title = "form error of the retroreflector"
    formula = "reading = sum of s_k sin(k incidence) + c_k cos(k incidence), k = 2 … 6"
    source = "Takatsuji et al. 1999; Ibaraki et al. 2014, Table 3"
    kind = "reading"
    coefficients = harmonic_coefficients(_ORDERS, 1e-5)
    methods = ("tracking_interferometer", "rotary_axis")

    def columns(self, observations: Observations, shape: tuple[float, ...] = ()) -> Array:
        """Harmonics of the angle of incidence."""
        session = observations.session
        if session.method == "rotary_axis":
            angle = beam_azimuth(observations) - session.rotation_sign * observations.readings.column("c")
        elif getattr(session.description, "dimension", 3) == 2:
            angle = beam_azimuth(observations)
        else:
            angle = np.arccos(np.clip(observations.direction[:, 2], -1.0, 1.0))
        return harmonics(angle, _ORDERS)
