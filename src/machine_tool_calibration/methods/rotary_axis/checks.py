# SPDX-License-Identifier: Apache-2.0
"""Sessions of a rotary axis that contradict their own geometry, and the common mistake that explains it."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.errors import ModelError, suspected
from machine_tool_calibration.methods.rotary_axis.geometry import TableReadings, table_readings
from machine_tool_calibration.methods.rotary_axis.start import Start, aligned, find_start
from machine_tool_calibration.session.description import RotaryAxis
from machine_tool_calibration.session.session import Readings, Session

__all__ = ["Suspicion", "refuse_mistake", "refuse_mistakes", "suspicions"]


# An alternative must fit this many times better to be named.
_BETTER = 10.0
_ANGLES = ("a", "b", "c", "azimuth", "elevation")
_LENGTHS = ("x", "y", "z")
_UNITS = (
    (1e-3, "displacement looks like millimetres; lengths are in metres"),
    (1e-6, "displacement looks like micrometres; lengths are in metres"),
    (-1.0, "displacement has the opposite sign"),
    (0.5, "displacement looks like twice the change of path"),
)
# Exchanges are tried among so many setups or targets.
_MOST = 8


@dataclass(frozen=True)
class Suspicion:
    """A mistake that may have been made.

    Attributes:
        what: for the message.
        session: the measurement as it would be without the mistake.
    """

    what: str
    session: Session


def suspicions(session: Session) -> Iterator[Suspicion]:
    """The measurement with each common mistake undone, made one by one."""
    readings = session.readings
    for factor, what in _UNITS:
        yield Suspicion(what, session.with_readings(replace(readings, displacement=factor * readings.displacement)))
    for name in _ANGLES:
        if name in readings.columns:
            undone = _column(readings, name, np.radians(readings.columns[name]))
            what = f"the column {name} looks like degrees; angles are in radians"
            yield Suspicion(what, session.with_readings(undone))
    if all(name in readings.columns for name in ("azimuth", "elevation")):
        undone = _column(readings, "azimuth", readings.columns["elevation"])
        undone = _column(undone, "elevation", readings.columns["azimuth"])
        yield Suspicion("azimuth and elevation look exchanged", session.with_readings(undone))
    if any(name in readings.columns for name in _LENGTHS):
        columns = {n: 1e-3 * v if n in _LENGTHS else v for n, v in readings.columns.items()}
        what = "x, y and z look like millimetres; lengths are in metres"
        yield Suspicion(what, session.with_readings(replace(readings, columns=columns)))
    yield from _turned(session)
    yield from _exchanged_setups(session)
    yield from _exchanged_targets(session)


def refuse_mistake(session: Session, misfit: Callable[[Session], float], now: float) -> None:
    """Name the mistake that explains an absurd misfit, if one does.

    Args:
        session: the measurement.
        misfit: how badly a measurement fits, comparable between alternatives (free of the unit of the readings).
        now: misfit of the measurement as it is.

    Raises:
        ModelError: the measurement is absurd, and a mistake is found that explains it; the best one is named.
    """
    if not now > _ABSURD:
        return
    best, what = min(now / _BETTER, _ABSURD), ""
    for suspicion in suspicions(session):
        try:
            value = misfit(suspicion.session)
        except (ModelError, np.linalg.LinAlgError):
            continue
        if value < best:
            best, what = value, suspicion.what
    if what:
        with suspected():
            raise ModelError(f"{session.source}: the readings do not fit at all, but {what}: then they would")


def _column(readings: Readings, name: str, values: np.ndarray) -> Readings:
    return replace(readings, columns={**readings.columns, name: values})


def _turned(session: Session) -> Iterator[Suspicion]:
    if not session.spec.on_turning_table:
        return
    description = session.description
    machine = description.machine.model_copy(update={"rotation_sign": -session.rotation_sign})
    update: dict[str, object] = {"machine": machine}
    if hasattr(description, "rotation_sign"):
        update["rotation_sign"] = -session.rotation_sign
    what = "the rotary axis looks as if it turned the other way (check rotation_sign)"
    yield Suspicion(what, replace(session, description=description.model_copy(update=update)))


def _exchanged_setups(session: Session) -> Iterator[Suspicion]:
    setup = session.readings.setup
    used = np.unique(setup)[:_MOST]
    for one, other in itertools.combinations(used.tolist(), 2):
        exchanged = np.where(setup == one, other, np.where(setup == other, one, setup))
        names = f"{session.setup_ids[one]!r} and {session.setup_ids[other]!r}"
        undone = session.with_readings(replace(session.readings, setup=exchanged))
        yield Suspicion(f"the setups {names} look exchanged", undone)


def _exchanged_targets(session: Session) -> Iterator[Suspicion]:
    target = session.readings.labels.get("target")
    if target is None:
        return
    for one, other in itertools.combinations(np.unique(target).tolist()[:_MOST], 2):
        exchanged = np.where(target == one, other, np.where(target == other, one, target))
        labels = {**session.readings.labels, "target": exchanged}
        undone = session.with_readings(replace(session.readings, labels=labels))
        yield Suspicion(f"the targets {one!r} and {other!r} look exchanged", undone)


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

    refuse_mistake(session, misfit, _misfit(session, table_readings(session), start))


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
