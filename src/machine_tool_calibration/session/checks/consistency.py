# SPDX-License-Identifier: Apache-2.0
"""Readings against nominal geometry: whether a common mistake is the better explanation.

The nominal geometry predicts every reading to about the uncertainty of the stations. Where it does not, and one
mistake (another unit, the other sense of rotation, two setups exchanged) explains the readings far better, that
mistake is named. Nothing is refused merely because it fits badly: that is for the model and its diagnosis.
"""

from __future__ import annotations

import numpy as np

from machine_tool_calibration.errors import SessionError
from machine_tool_calibration.session.checks.mistakes import Comparison
from machine_tool_calibration.session.description import Place
from machine_tool_calibration.session.session import Readings, Session

__all__ = ["check_consistency"]

_ROWS = 20_000  # enough to judge by
_FITS = 0.1  # of the readings' extent
_BETTER = 0.2  # of the misfit as it is


def check_consistency(session: Session, place: Place) -> None:
    """Refuse a session whose readings a common mistake explains and its geometry does not.

    Raises:
        SessionError: the mistake that is suspected.
    """
    readings = _sample(session.readings)
    if len(readings) < 4:
        return
    with np.errstate(all="ignore"):
        for comparison in session.spec.nominal(session, readings, place):
            _decide(place.readings, comparison)


def _decide(source: str, comparison: Comparison) -> None:
    """Raise for the first mistake that fits where the data as they are do not."""
    worst = float(np.nanmax(comparison.misfit, initial=0.0))
    if not worst > _FITS * comparison.scale:
        return
    for mistake in comparison.mistakes:
        misfit = float(np.nanmax(mistake.misfit, initial=0.0))
        if misfit < _FITS * mistake.scale and misfit * comparison.scale < _BETTER * worst * mistake.scale:
            raise SessionError(f"{source}: {mistake.what}")


def _sample(readings: Readings) -> Readings:
    rows = np.flatnonzero(np.isfinite(readings.displacement))
    step = max(1, -(-len(rows) // _ROWS))
    return readings.select(rows[::step])
