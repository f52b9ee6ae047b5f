# SPDX-License-Identifier: Apache-2.0
"""The uncertainty that a probing measurement will have, before it is made (Section 6 of the paper).

Which points can distinguish workpiece and machine depends on the part and on the angles of C, so it is worth knowing
beforehand. The model is linear: no Monte Carlo is needed.
"""

from __future__ import annotations

import numpy as np

from machine_tool_calibration.methods.identify import identify
from machine_tool_calibration.methods.probing.geometry import turn
from machine_tool_calibration.model.result import Result
from machine_tool_calibration.session.description import Probing
from machine_tool_calibration.session.session import Readings, Session

__all__ = ["forecast", "planned_session"]


def forecast(description: Probing) -> Result:
    """The result that the planned touches will have; its values are zero, its uncertainties and gaps those to come.

    Args:
        description: workpiece, angles of C, repeats and the uncertainty of one touch.

    Raises:
        ModelError: the touches are fewer than what they would have to determine.
    """
    return identify(planned_session(description), keep_all=True)


def planned_session(description: Probing) -> Session:
    """A session in which every point is touched at every angle as often as planned; all readings are zero."""
    points = np.array([point.position for point in description.workpiece])
    shape = (len(description.setups), description.repeats, len(points))
    setup, repeat, point = (index.ravel() for index in np.indices(shape))
    c = np.array([entry.c for entry in description.setups])[setup]
    sign = description.machine.rotation_sign or -1
    place = turn(points[point], sign * c)
    readings = Readings(
        setup=setup,
        repeat=repeat,
        displacement=np.zeros(len(setup)),
        columns={"x": place[:, 0], "y": place[:, 1], "c": c},
        labels={"point": np.array([entry.id for entry in description.workpiece], dtype=object)[point]},
        row=np.arange(len(setup)),
    )
    return Session(description, readings, "plan")
