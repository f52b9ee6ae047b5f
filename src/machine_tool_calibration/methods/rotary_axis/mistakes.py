# SPDX-License-Identifier: Apache-2.0
"""Sessions of a rotary axis that contradict their own geometry, and the common mistake that explains it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from machine_tool_calibration.arrays import Array, IntArray, best_motion, group_ranges
from machine_tool_calibration.errors import ModelError, SessionError, suspected
from machine_tool_calibration.methods.rotary_axis.geometry import table_readings
from machine_tool_calibration.methods.rotary_axis.spec import turning_mistakes
from machine_tool_calibration.methods.rotary_axis.start import Start, find_start
from machine_tool_calibration.session.checks.contradictions import refuse_contradictions
from machine_tool_calibration.session.checks.mistakes import exchanged, explanation, shifted
from machine_tool_calibration.session.checks.nominal_geometry import off_prediction
from machine_tool_calibration.session.description import Place, RotaryAxis, StationSetup, Target
from machine_tool_calibration.session.judgements import Held, Judgement, Supposition
from machine_tool_calibration.session.session import Session

__all__ = ["SURVEYED", "refuse_mistakes", "refuse_wrong_rows", "suppositions"]

# Share of the readings' range, and of the arrangement's size, that no rotary axis and no survey is wrong by; and the
# share of the misfit that is left without a mistake that is named.
_ABSURD, _BETTER = 2e-3, 0.1
# A reading is off by an error of the axis, or by less than this, m.
_WRONG = 2e-3
# What a survey may be off by: m, or so many of its uncertainties.
_MISPLACED, _MANY = 0.05, 20.0
SURVEYED = "state the stations to a decimetre and the targets to some centimetres"


def suppositions(session: Session) -> Iterator[Supposition]:
    """The measurement without each common mistake."""
    yield from turning_mistakes(session)
    yield from shifted(session, "displacement", session.readings.displacement)
    yield from exchanged(session, "setup", [session.setup_ids[k] for k in np.unique(session.readings.setup)])
    yield from exchanged(session, "target", np.unique(session.readings.labels["target"]).tolist())


def refuse_mistakes(session: Session, start: Start) -> None:
    """Refuse readings that a table turning without error misses by far, if a common mistake explains them.

    Also looked at is where stations and targets had to be put: with all places free, exchanged ones fit perfectly, at
    each other's place.

    Raises:
        ModelError: the mistake.
    """
    description = session.description.as_a(RotaryAxis)
    stations, stations_u = _stated(description.setups)
    targets, targets_u = _stated(description.targets)

    def misfit(other: Session) -> float:
        table = table_readings(other)
        found = start if other is session else find_start(table, stations, targets)
        extent = max(float(np.ptp(table.readings.displacement)), 1e-12)
        used = np.unique(table.readings.setup)
        size = max(float(np.ptp(stations[used], axis=0).max()), 1e-3)
        turn, shift = best_motion(found.stations[used], stations[used])
        off = found.stations[used] @ turn.T + shift - stations[used]
        misplaced = _too_far(off, stations_u[used]) + _too_far(found.targets - targets, targets_u)
        return found.misfit / extent + misplaced / size

    what = explanation(session, [Judgement(misfit, suppositions(session), _ABSURD, _ABSURD, _BETTER)])
    if what is not None:
        with suspected():
            raise ModelError(f"{session.source}: the readings do not fit at all; they would without a mistake: {what}")


def refuse_wrong_rows(session: Session, start: Start, *, found: bool = True) -> None:
    """Refuse readings that a table turning without error misses by far.

    Args:
        session: the measurement.
        start: where stations and targets are.
        found: those are the places at which most readings fit, and a run is judged by them; else they are the stated
            ones, and a station or a target is.

    Raises:
        ModelError: the run, station or target, by how much, and what its readings look like.
    """

    def held(other: Session) -> Iterator[Held]:
        table = table_readings(other)
        arm = table.turned(start.targets)
        path = np.linalg.norm(arm - start.stations[table.readings.setup], axis=1)
        off = off_prediction(other, path, table.run)
        allowed = np.full(len(off), _WRONG if found else _MISPLACED)
        if found:
            against = "the change of distance from where the station was found"
            yield Held("displacement", against, off, allowed, group=table.run)
            return

        def worst(owner: tuple[str, IntArray]) -> float:
            return float(np.nanmax(group_ranges(off, owner[1], int(owner[1].max()) + 1)[1]))

        against = "the change of distance between the stated places of station and target"
        for label, group in sorted((("", table.readings.setup), ("target", table.target)), key=worst, reverse=True):
            yield Held("displacement", against, off, allowed, group=group, label=label, hint=lambda setup: SURVEYED)

    read = session.with_readings(table_readings(session).readings)
    try:
        with suspected():
            refuse_contradictions(read, Place(session.source, session.source), held)
    except SessionError as error:
        raise ModelError(str(error)) from None


def _stated(entries: Sequence[StationSetup | Target]) -> tuple[Array, Array]:
    """(k, 3) stated places, m, and (k,) their uncertainties; 0 where none is stated."""
    places = np.array([entry.position for entry in entries])
    return places, np.array([entry.position_uncertainty or 0.0 for entry in entries])


def _too_far(moved: Array, stated: Array) -> float:
    """How much further the worst place is off than a survey can be, m."""
    allowed = np.maximum(_MISPLACED, _MANY * stated)
    return float(np.max(np.clip(np.linalg.norm(moved, axis=1) - allowed, 0.0, None)))
