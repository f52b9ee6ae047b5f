"""Common mistakes in a measurement, tried when its fit is absurd.

Nothing is refused because it fits badly: that is for the diagnosis. Only where the readings contradict the model by
orders of magnitude, and the same readings with one mistake undone agree with it, is that mistake named.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from machine_tool_calibration.errors import ModelError
from machine_tool_calibration.session.session import Readings, Session

__all__ = ["Suspicion", "refuse_mistake", "suspicions"]

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


def refuse_mistake(session: Session, misfit: Callable[[Session], float], now: float, limit: float) -> None:
    """Name the mistake that explains an absurd misfit, if one does.

    Args:
        session: the measurement.
        misfit: how badly a measurement fits, comparable between alternatives (free of the unit of the readings).
        now: misfit of the measurement as it is.
        limit: misfit above which it is absurd.

    Raises:
        ModelError: the measurement is absurd, and a mistake is found that explains it; the best one is named.
    """
    if not now > limit:
        return
    best, what = min(now / _BETTER, limit), ""
    for suspicion in suspicions(session):
        try:
            value = misfit(suspicion.session)
        except (ModelError, np.linalg.LinAlgError):
            continue
        if value < best:
            best, what = value, suspicion.what
    if what:
        raise ModelError(f"{session.source}: the readings do not fit at all, but {what}: then they would")


def _column(readings: Readings, name: str, values: np.ndarray) -> Readings:
    return replace(readings, columns={**readings.columns, name: values})


def _turned(session: Session) -> Iterator[Suspicion]:
    if session.method not in ("rotary_axis", "probing"):
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
