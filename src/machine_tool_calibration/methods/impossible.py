# SPDX-License-Identifier: Apache-2.0
"""What no machine has: errors of centimetres, and instruments that do not stand where they are stated to stand."""

from __future__ import annotations

import numpy as np

from machine_tool_calibration.errors import ModelError, suspected
from machine_tool_calibration.methods.build import error_map
from machine_tool_calibration.methods.fitted import FittedSessions
from machine_tool_calibration.model.result import ErrorMap
from machine_tool_calibration.session.checks.places import has_stations, refuse_misplaced

__all__ = ["refuse_impossible"]

# Position error that no machine tool has, m, and by how many of its uncertainties it must be known.
_IMPOSSIBLE = 0.01
_KNOWN = 5.0


@suspected()
def refuse_impossible(fitted: FittedSessions) -> None:
    """Refuse what readings that contradict the geometry say of the machine, unless a session says `trust_units`.

    The map is that of all sessions; an instrument stands where its own session says.

    Args:
        fitted: one session or several.

    Raises:
        ModelError: a position error of centimetres, or a station far from where it is stated to be.
    """
    sessions = [fit.model.observations.session for fit in fitted.joint.fits]
    if not any(session.description.trust_units for session in sessions):
        labels = fitted.joint.assembly.labels
        _refuse_errors(sessions[0].source if len(sessions) == 1 else ", ".join(labels or ()), fitted.error_map)
    for session, fit in zip(sessions, fitted.joint.fits, strict=True):
        if has_stations(session) and not session.description.trust_units:
            own = fitted.error_map if len(sessions) == 1 else error_map(fit)
            refuse_misplaced(session, own.content)


def _refuse_errors(name: str, error_map: ErrorMap) -> None:
    size = np.abs(error_map.error)
    there = np.isfinite(size) & (size > _KNOWN * error_map.uncertainty) & (size > _IMPOSSIBLE)
    if there.any():
        k, j = np.argwhere(there)[int(np.argmax(size[there]))]
        place = ", ".join(f"{1e3 * v:.6g}" for v in error_map.points[k])
        raise ModelError(
            f"{name}: the position error along {'xyz'[j]} at ({place}) mm comes out as "
            f"{1e3 * size[k, j]:.3g} mm, which no machine has: check units, columns and signs, and where the "
            "instrument stood"
        )
