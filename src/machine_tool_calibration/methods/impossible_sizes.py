"""Maps and stations that cannot be: errors of centimetres are a mistake of input, not of the machine."""

from __future__ import annotations

import numpy as np

from machine_tool_calibration.errors import ModelError
from machine_tool_calibration.model.result import ErrorMap
from machine_tool_calibration.session.description import TrackingInterferometer
from machine_tool_calibration.session.session import Session

__all__ = ["refuse_impossible"]

# Position error that no machine tool has, m, and by how many of its uncertainties it must be known.
_IMPOSSIBLE = 0.01
_KNOWN = 5.0
# A station may be off by so many of its stated uncertainties, and by this where none is stated, m.
_STATED = 10.0
_UNSTATED = 0.1


def refuse_impossible(session: Session, error_map: ErrorMap, *, allow: bool = False) -> None:
    """Refuse what was identified from readings that contradict the geometry.

    Args:
        session: the measurement.
        error_map: what was identified.
        allow: whether it is accepted nevertheless.

    Raises:
        ModelError: a position error of centimetres, or a station far from where it is stated to be.
    """
    if allow:
        return
    size = np.abs(error_map.error)
    there = np.isfinite(size) & (size > _KNOWN * error_map.uncertainty) & (size > _IMPOSSIBLE)
    if there.any():
        k, j = np.argwhere(there)[int(np.argmax(size[there]))]
        place = ", ".join(f"{1e3 * v:.6g}" for v in error_map.points[k])
        raise ModelError(
            f"{session.source}: the position error along {'xyz'[j]} at ({place}) mm comes out as "
            f"{1e3 * size[k, j]:.3g} mm, which no machine has: check units, columns and signs, and where the "
            "instrument stood"
        )
    description = session.description
    if not isinstance(description, TrackingInterferometer) or "stations" not in error_map.content:
        return
    found, known = error_map.content["stations"], error_map.content["stations_u"]
    for setup, position, uncertainty in zip(description.setups, found, known, strict=True):
        off = np.abs(position - np.asarray(setup.position))[: description.dimension]
        limit = _STATED * setup.position_uncertainty if setup.position_uncertainty else _UNSTATED
        bad = (off > limit) & (off > _IMPOSSIBLE) & (off > _KNOWN * uncertainty[: description.dimension])
        if bad.any():
            j = int(np.argmax(np.where(bad, off, 0.0)))
            raise ModelError(
                f"{session.source}: station {setup.id!r} is found {1e3 * off[j]:.3g} mm off its stated position along "
                f"{'xyz'[j]}: check its position and position_uncertainty, and the columns x, y and z"
            )
