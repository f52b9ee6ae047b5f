# SPDX-License-Identifier: Apache-2.0
"""Deviations that are read directly."""

from typing import ClassVar

import numpy as np

from machine_tool_calibration.arrays import first_true
from machine_tool_calibration.errors import SessionError
from machine_tool_calibration.session.description import Direct, Place
from machine_tool_calibration.session.method import MethodSpec
from machine_tool_calibration.session.session import Session


class DirectSpec(MethodSpec):
    """Deviations that are read directly."""

    description = Direct
    # Real deviations often come without times and repeats: one pass, in the order given.
    always = ("setup", "gx", "gy", "gz", "displacement")
    any_axis = True
    model = "machine_tool_calibration.methods.direct.model"
    models: ClassVar = {
        "rigid_body": "the default: the axes are rigid bodies, their errors tables over their positions",
        "free": "every place that was read has errors of its own, whatever moves the tool: for a map of these places",
    }
    reads_deviations = reads_machine = True
    tables = "rigid_body"
    alone = ("free",)
    by_axes = ("rigid_body",)
    no_tables = "the session names no terms (such as terms: [EXX, C0Y]) to be determined, or the model is 'free'"
    steps = "machine_tool_calibration.procedure.steps:direct_steps"
    planned = "machine_tool_calibration.planning.forecast:directly"
    pictures = "machine_tool_calibration.plots.direct"

    def mounted(self, description: Direct) -> str:
        """Nothing where there is no datum: the instrument stands where it is said to."""
        return "" if description.datum == "none" else "the instrument or part"

    def magnitudes(self, session: Session, place: Place) -> None:
        """Refuse directions gx, gy, gz that are not of length 1."""
        columns = session.readings.columns
        length = np.sqrt(columns["gx"] ** 2 + columns["gy"] ** 2 + columns["gz"] ** 2)
        bad = first_true(np.isfinite(session.readings.displacement) & ~(np.abs(length - 1.0) <= 0.05))
        if bad is not None:
            where = place.row(session.readings.row[bad])
            raise SessionError(f"{where}: the direction (gx, gy, gz) has length {length[bad]:g}, not 1")


SPEC = DirectSpec()
