# SPDX-License-Identifier: Apache-2.0
"""Form error of the retroreflector, in waves over the angle of incidence (Takatsuji et al. 1999)."""

import numpy as np

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.effects.effect import table_axis
from machine_tool_calibration.effects.families import HarmonicEffect
from machine_tool_calibration.effects.pointed_beam import POINTED_INSTRUMENTS, POINTED_METHODS
from machine_tool_calibration.model.observations import Observations, azimuth
from machine_tool_calibration.session.catalogue import spec_of
from machine_tool_calibration.words import say


class RetroreflectorForm(HarmonicEffect):
    """Path change with the direction in which the beam meets the retroreflector.

    The retroreflector keeps its orientation to the machine on a spindle, and turns with a rotary table. In a plane
    the angle of incidence is the azimuth; in space it is the angle to the spindle's axis; on a table it is the angle
    about the table's axis, as seen from the table.
    """

    id = "retroreflector_form"
    title = say("effect.retroreflector")
    formula = say("formula.harmonics", angle=say("formula.angle_incidence"))
    source = "Takatsuji et al. 1999; Ibaraki et al. 2014, Table 3"
    limit = 2e-5
    covariates = ("azimuth", "elevation", "c")
    methods = POINTED_METHODS
    instruments = POINTED_INSTRUMENTS

    def angle(self, observations: Observations) -> Array:
        """The angle of incidence."""
        session = observations.session
        if spec_of(session).turns_one_axis:
            axis = table_axis(observations)
            i, j = (("ABC".index(axis) + k) % 3 for k in (1, 2))
            about = np.arctan2(observations.direction[:, j], observations.direction[:, i])
            return np.asarray(about - session.rotation_sign * observations.readings.column(axis.lower()))
        if session.description.axes == "xy":
            return azimuth(observations.direction)
        return np.asarray(np.arccos(np.clip(observations.direction[:, 2], -1.0, 1.0)))
