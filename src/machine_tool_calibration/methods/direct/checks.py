# SPDX-License-Identifier: Apache-2.0
"""Directions of deviations that are read directly."""

from __future__ import annotations

import numpy as np

from machine_tool_calibration.arrays import first_true
from machine_tool_calibration.errors import SessionError
from machine_tool_calibration.session.description import Place
from machine_tool_calibration.session.judgements import Checks
from machine_tool_calibration.session.session import Session

__all__ = ["DirectChecks"]


class DirectChecks(Checks):
    """Of deviations that are read directly."""

    def magnitudes(self, session: Session, place: Place) -> None:
        """Refuse directions gx, gy, gz that are not of length 1."""
        columns = session.readings.columns
        length = np.sqrt(columns["gx"] ** 2 + columns["gy"] ** 2 + columns["gz"] ** 2)
        bad = first_true(np.isfinite(session.readings.displacement) & ~(np.abs(length - 1.0) <= 0.05))
        if bad is not None:
            where = place.row(session.readings.row[bad])
            raise SessionError(f"{where}: the direction (gx, gy, gz) has length {length[bad]:g}, not 1")
