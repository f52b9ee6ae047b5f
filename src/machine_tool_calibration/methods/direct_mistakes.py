"""A session of direct deviations that cannot be what it says."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.errors import ModelError
from machine_tool_calibration.model.fit import fit_models
from machine_tool_calibration.model.model import MethodModel
from machine_tool_calibration.session.session import Session

__all__ = ["refuse_mistakes"]

# Deviations of a machine tool, share of the travel: a tenth of a per cent would be a wreck.
_WRECK = 2e-3
# Share of the readings that a wrong reading explains before it is named.
_EXPLAINED = 0.99
# Residuals over declared uncertainty within which a fit is taken for good.
_GOOD = 30.0


def refuse_mistakes(session: Session, build: Callable[[Session], MethodModel]) -> None:
    """Refuse positions given for deviations, and deviations a thousand times too large.

    Raises:
        ModelError: the mistake.
    """
    readings = session.readings
    model = build(session)
    seen = model.observations
    extent = float(np.ptp(seen.position, axis=0).max())
    if extent == 0.0 or len(seen) < 8:
        return
    reading = seen.readings.displacement
    spread = float(np.sqrt(np.mean((reading - reading.mean()) ** 2)))
    if spread < _WRECK * extent:
        return
    along = np.einsum("nj,nj->n", seen.position, seen.direction)
    if (name := _position_read(reading, along)) is not None:
        raise ModelError(f"{session.source}: displacement looks like {name}; a deviation is actual minus commanded")
    now = _misfit(model, session.sigma)
    for factor, unit in ((1e-3, "millimetres"), (1e-6, "micrometres")):
        scaled = session.with_readings(replace(readings, displacement=factor * readings.displacement))
        if now > _GOOD and _misfit(build(scaled), session.sigma) < _GOOD and spread * factor < _WRECK * extent:
            raise ModelError(f"{session.source}: displacement looks like {unit}; deviations are in metres")


def _position_read(reading: Array, along: Array) -> str | None:
    """Whether the readings are the positions themselves."""
    centred, place = reading - reading.mean(), along - along.mean()
    power = float(place @ place)
    if power == 0.0:
        return None
    slope = float(centred @ place) / power
    left = float(np.sum((centred - slope * place) ** 2))
    if left > (1 - _EXPLAINED) * float(centred @ centred):
        return None
    if abs(abs(slope) - 1.0) < 0.02:
        return "the actual position" if slope > 0 else "commanded minus actual position"
    if abs(slope / 1000.0 - 1.0) < 0.02:
        return "the actual position in millimetres"
    return None


def _misfit(model: MethodModel, sigma: float) -> float:
    """Median absolute residual over the declared uncertainty."""
    return float(np.median(np.abs(fit_models([model]).fits[0].residuals)) / sigma)
