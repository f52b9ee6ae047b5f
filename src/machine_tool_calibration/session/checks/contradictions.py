# SPDX-License-Identifier: Apache-2.0
"""Readings that contradict the stated geometry by more than any machine and any survey can be off.

Each method says what its stated geometry makes of places, beams and displacements, and how far these may be off
(`MethodSpec.held`). What is commanded contradicts by a single row; of what is read, only by more than gross errors do.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from machine_tool_calibration.arrays import Array, BoolArray, IntArray
from machine_tool_calibration.errors import SessionError
from machine_tool_calibration.session.checks.mistakes import Judgement, Supposition, explanation, with_columns
from machine_tool_calibration.session.description import Place
from machine_tool_calibration.session.session import Session

__all__ = ["GROSS", "Held", "refuse_contradictions"]

GROSS = 0.2
"""Share of a setup's readings up to which those that contradict are single gross errors, which are set aside."""
_FEWEST = 3  # readings: fewer are single whatever their share
_ROWS = 20_000  # enough to judge by
# Share of a setup's readings that may be left, and of those that contradict, where a mistake explains them: the ends.
_LEFT, _BETTER = 0.06, 0.2
# What may have happened to a column: by how many rows it slipped, and by what it was multiplied.
_SLIPPED, _TIMES = (1, -1, 2, -2), ((2.0, "doubled"), (0.5, "halved"), (-1.0, "of the opposite sign"))


@dataclass(frozen=True)
class Held:
    """What was commanded or read, held against the stated geometry.

    Attributes:
        what: was held, such as `azimuth`.
        against: what the geometry says, in words.
        off: (n,) how far each reading is off it, m or rad; NaN where it says nothing.
        allowed: (n,) how far a machine and a survey may be off.
        unit: m, rad, or empty for what only agrees or not.
        share: of a setup's readings up to which the contradicting ones are no contradiction.
        hint: of a setup, what its readings say instead; may be empty.
    """

    what: str
    against: str
    off: Array
    allowed: Array
    unit: str = "m"
    share: float = GROSS
    hint: Callable[[int], str] = lambda setup: ""

    @property
    def bad(self) -> BoolArray:
        """(n,) readings that contradict."""
        return np.asarray(self.off > self.allowed)


def refuse_contradictions(session: Session, place: Place) -> None:
    """Refuse readings that contradict what the session states.

    Raises:
        SessionError: one line that names the setup, the worst row, by how much it is off what, how many others are, and
            what is likelier meant.
    """
    with np.errstate(all="ignore"):
        _refuse(session, place)


def _refuse(session: Session, place: Place) -> None:
    every = list(session.spec.held(session))
    if sum(int(held.bad.sum()) for held in every) < _FEWEST and not any(_contradicted(session, h) for h in every):
        return
    some = session.with_readings(session.readings.select(np.arange(min(len(session.readings), _ROWS))))
    slip = explanation(some, [Judgement(_misfit, _slips(some), 0.0, _LEFT, _BETTER)])
    # Few that contradict are gross errors, unless all of them come from one slip.
    for held in (h for h in every if _contradicted(session, h) or (slip and h.bad.any())):
        raise SessionError(_words(session, place, held, slip))


def _contradicted(session: Session, held: Held) -> bool:
    """Whether more of a setup's readings contradict than single gross errors do."""
    share, bad = _shares(session, held)
    return bool(((share > held.share) & ((bad >= _FEWEST) | (held.share == 0.0))).any())


def _shares(session: Session, held: Held) -> tuple[Array, Array]:
    """(setups,) share of readings that contradict, and how many they are."""
    setup, count = session.readings.setup, len(session.setup_ids)
    every, bad = np.bincount(setup, minlength=count), np.bincount(setup, held.bad, minlength=count)
    return bad / np.maximum(every, 1), np.asarray(bad, dtype=float)


def _words(session: Session, place: Place, held: Held, slip: str | None) -> str:
    """What contradicts what, in the setup where the most do, and what is likelier meant."""
    read = session.readings
    setup = int(np.argmax(_shares(session, held)[0]))
    mine = read.setup == setup
    rows, count = np.flatnonzero(held.bad & mine), int(mine.sum())
    worst = rows[int(np.argmax(held.off[rows]))]
    by = f"contradicts {held.against}"
    if held.unit:
        by = f"is {_size(float(held.off[worst]), held.unit)} off {held.against}"
    if not slip and not np.ptp(read.displacement):
        slip = f"all {count} readings are {read.displacement[0]:g} m: was the instrument read?"
    likelier = slip or (2 * len(rows) < count and _elsewhere(session, rows)) or held.hint(setup)
    return (
        f"{place.row(read.row[worst])}: {held.what} of setup {session.setup_ids[setup]!r} {by}, one of {len(rows)} "
        f"of its {count} readings that do{f': {likelier}' if likelier else ''}"
    )


def _misfit(session: Session) -> float:
    """Share of all readings that contradict."""
    return float(np.mean(np.any([held.bad for held in session.spec.held(session)], axis=0)))


def _slips(session: Session) -> Iterator[Supposition]:
    """Columns that were shifted, multiplied or exchanged."""
    readings = session.readings
    values = {n: readings.columns[n] for n in ("x", "y", "z", "azimuth", "elevation") if n in readings.columns}
    values["displacement"] = readings.displacement
    for name, value in values.items():
        for rows in _SLIPPED:
            which = f"{abs(rows)} row{'s' if abs(rows) > 1 else ''} {'down' if rows > 0 else 'up'}"
            yield _with(session, f"{name} looks shifted by {which}", **{name: np.roll(value, -rows)})
        for factor, what in _TIMES:
            yield _with(session, f"{name} looks {what}", **{name: value / factor})
    for one, other in itertools.combinations(values, 2):
        what = f"the columns {one} and {other} look exchanged"
        yield _with(session, what, **{one: values[other], other: values[one]})


def _with(session: Session, what: str, **columns: Array) -> Supposition:
    displacement = columns.pop("displacement", session.readings.displacement)
    changed = session.with_readings(replace(session.readings, displacement=displacement))
    return with_columns(changed, what, **columns)


def _elsewhere(session: Session, rows: IntArray) -> str:
    """Whether readings would be right in another setup."""
    for other, name in enumerate(session.setup_ids):
        setup = session.readings.setup.copy()
        setup[rows] = other
        moved = session.with_readings(replace(session.readings, setup=setup))
        if not any(held.bad[rows].any() for held in session.spec.held(moved)):
            return f"they look like readings of setup {name!r}"
    return ""


def _size(value: float, unit: str) -> str:
    return f"{value:.3g} rad" if unit == "rad" else f"{1e3 * value:.4g} mm"
