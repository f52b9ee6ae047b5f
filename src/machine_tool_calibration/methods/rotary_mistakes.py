"""A rotary axis's session that contradicts its own geometry."""

from __future__ import annotations

import numpy as np

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.methods.rotary_geometry import TableReadings, table_readings
from machine_tool_calibration.methods.rotary_start import Start, aligned, find_start
from machine_tool_calibration.methods.suspicions import refuse_mistake
from machine_tool_calibration.session.description import RotaryAxis
from machine_tool_calibration.session.session import Session

__all__ = ["refuse_mistakes"]

# Share of the readings' range, and of the arrangement's size, that no rotary axis and no survey is wrong by.
_ABSURD = 2e-3
_MISPLACED = 0.05
_MANY = 20.0


def refuse_mistakes(session: Session, start: Start) -> None:
    """Refuse readings that a table turning without error misses by far, if a common mistake explains them.

    Also looked at is where stations and targets had to be put: with all places free, exchanged ones fit perfectly, at
    each other's place.

    Raises:
        ModelError: the mistake.
    """

    def misfit(other: Session) -> float:
        table = table_readings(other)
        description = other.description
        assert isinstance(description, RotaryAxis)
        stations = np.array([setup.position for setup in description.setups])
        targets = np.array([target.position for target in description.targets])
        return _misfit(other, table, find_start(table, stations, targets))

    refuse_mistake(session, misfit, _misfit(session, table_readings(session), start), _ABSURD)


def _misfit(session: Session, table: TableReadings, start: Start) -> float:
    description = session.description
    assert isinstance(description, RotaryAxis)
    reading = table.readings.displacement
    extent = max(float(np.ptp(reading)), 1e-12)
    nominal = np.array([setup.position for setup in description.setups])
    stated = np.array([setup.position_uncertainty or 0.0 for setup in description.setups])
    used = np.unique(table.readings.setup)
    size = max(float(np.ptp(nominal[used], axis=0).max()), 1e-3)
    moved = aligned(start.stations, nominal, used)
    stations = _too_far((moved - nominal)[used], stated[used])
    places = np.array([target.position for target in description.targets])
    stated = np.array([target.position_uncertainty or 0.0 for target in description.targets])
    targets = _too_far(start.targets - places, stated)
    return start.misfit / extent + (stations + targets) / size


def _too_far(moved: Array, stated: Array) -> float:
    """How much further the worst place is off than a survey can be, m."""
    allowed = np.maximum(_MISPLACED, _MANY * stated)
    return float(np.max(np.clip(np.linalg.norm(moved, axis=1) - allowed, 0.0, None)))
