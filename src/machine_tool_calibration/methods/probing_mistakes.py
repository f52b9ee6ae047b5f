"""Touches that cannot be what they say: displacements in another unit."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from machine_tool_calibration.errors import ModelError
from machine_tool_calibration.model.fit import fit_models
from machine_tool_calibration.model.model import MethodModel
from machine_tool_calibration.session.session import Session

__all__ = ["refuse_mistakes"]

# Displacement beyond which a touch is looked at, m: no ground surface is off by so much, a casting may be.
_LARGE = 2e-4
# Median residual over the declared uncertainty: absurd, and good.
_ABSURD, _GOOD = 100.0, 30.0


def refuse_mistakes(session: Session, build: Callable[[Session], MethodModel]) -> None:
    """Refuse displacements that are a thousand or a million times too large.

    Raises:
        ModelError: the mistake.
    """
    readings = session.readings
    read = readings.displacement[np.isfinite(readings.displacement)]
    if not len(read) or np.median(np.abs(read)) < _LARGE or not _misfit(session, build) > _ABSURD:
        return
    for factor, unit in ((1e-3, "millimetres"), (1e-6, "micrometres")):
        scaled = session.with_readings(replace(readings, displacement=factor * readings.displacement))
        if _misfit(scaled, build) < _GOOD:
            raise ModelError(f"{session.source}: displacement looks like {unit}; lengths are in metres")


def _misfit(session: Session, build: Callable[[Session], MethodModel]) -> float:
    """Median absolute residual over the declared uncertainty."""
    return float(np.median(np.abs(fit_models([build(session)]).fits[0].residuals)) / session.sigma)
