# SPDX-License-Identifier: Apache-2.0
"""Readings that contradict the stated geometry by more than any machine and any survey can be off.

Each method says what its stated geometry makes of places, beams and displacements, and how far these may be off
(`MethodSpec.held`). What is commanded contradicts by a single row; of what is read, only by more than gross errors do.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable, Iterator

import numpy as np

from machine_tool_calibration.arrays import Array, IntArray
from machine_tool_calibration.errors import SessionError
from machine_tool_calibration.session.catalogue import spec_of
from machine_tool_calibration.session.checks.mistakes import explanation, shifted, with_values
from machine_tool_calibration.session.description import Place
from machine_tool_calibration.session.judgements import Held, Judgement, Supposition
from machine_tool_calibration.session.session import Session
from machine_tool_calibration.words import figures

__all__ = ["refuse_contradictions"]

_FEWEST = 3  # readings: fewer are single whatever their share
_ROWS = 20_000  # enough to judge by
# Share of a setup's readings that may be left, and of those that contradict, where a mistake explains them: the ends.
_LEFT, _BETTER = 0.06, 0.2
# What a column may have been multiplied by.
_TIMES = ((2.0, "doubled"), (0.5, "halved"), (-1.0, "of the opposite sign"))


Expected = Callable[[Session], Iterable[Held]]
"""Of a session, what in it is held against what."""


def refuse_contradictions(session: Session, place: Place, expected: Expected | None = None) -> None:
    """Refuse readings that contradict what the session states.

    Args:
        session: all its readings are there.
        place: names for messages.
        expected: what is held against what; what the method says if absent.

    Raises:
        SessionError: one line that names the setup, the worst row, by how much it is off what, how many others are, and
            what is likelier meant.
    """
    with np.errstate(all="ignore"):
        _refuse(session, place, expected or spec_of(session).held)


def _refuse(session: Session, place: Place, expected: Expected) -> None:
    every = list(expected(session))
    if sum(int(held.bad.sum()) for held in every) < _FEWEST and not any(_contradicted(session, h) for h in every):
        return

    def misfit(other: Session) -> float:
        return float(np.mean(np.any([held.bad for held in expected(other)], axis=0)))

    some = session.with_readings(session.readings.select(np.arange(min(len(session.readings), _ROWS))))
    slip = explanation(some, [Judgement(misfit, _slips(some), 0.0, _LEFT, _BETTER)])
    # Few that contradict are gross errors, unless all of them come from one slip.
    for held in every:
        if _contradicted(session, held) or (slip and held.bad.any()):
            raise SessionError(_words(session, place, held, slip or ""))


def _contradicted(session: Session, held: Held) -> bool:
    """Whether more of a group's readings contradict than single gross errors do."""
    _, share, bad = _shares(session, held)
    return bool(((share > held.share) & ((bad >= _FEWEST) | (held.share == 0.0))).any())


def _shares(session: Session, held: Held) -> tuple[IntArray, Array, Array]:
    """(n,) group of each reading, and of each group the share of readings that contradict, and how many they are."""
    group = session.readings.setup if held.group is None else held.group
    every = np.bincount(group)
    bad = np.bincount(group, held.bad, minlength=len(every))
    return group, bad / np.maximum(every, 1), np.asarray(bad, dtype=float)


def _worst(session: Session, held: Held) -> tuple[IntArray, int, int]:
    """In the group where the most contradict: those readings, the worst first, how many it has, and its setup."""
    group, share, _ = _shares(session, held)
    mine = group == np.argmax(share)
    rows = np.flatnonzero(held.bad & mine)
    rows = rows[np.argsort(-held.off[rows], kind="stable")]
    return rows, int(mine.sum()), int(session.readings.setup[rows[0]])


def _words(session: Session, place: Place, held: Held, likelier: str) -> str:
    """What contradicts what, in the group where the most do, and what is likelier meant."""
    read = session.readings
    rows, count, setup = _worst(session, held)
    by = f"contradicts {held.against}"
    if held.unit:
        by = f"is {_size(float(held.off[rows[0]]), held.unit)} off {held.against}"
    likelier = likelier or held.hint(setup)
    owner = f"setup {session.setup_ids[setup]!r}"
    if held.label:
        owner = f"{held.label} {str(read.labels[held.label][rows[0]])!r}"
    return (
        f"{place.row(read.row[rows[0]])}: {held.what} of {owner} {by}, one of {len(rows)} "
        f"of its {count} readings that do{f': {likelier}' if likelier else ''}"
    )


def _slips(session: Session) -> Iterator[Supposition]:
    """Columns that were shifted, multiplied or exchanged."""
    readings = session.readings
    values = {n: readings.columns[n] for n in (*"xyzabc", "azimuth", "elevation") if n in readings.columns}
    values["displacement"] = readings.displacement
    for name, value in values.items():
        yield from shifted(session, name, value)
        for factor, what in _TIMES:
            yield with_values(session, f"{name} looks {what}", **{name: value / factor})
    for one, other in itertools.combinations(values, 2):
        what = f"the columns {one} and {other} look exchanged"
        yield with_values(session, what, **{one: values[other], other: values[one]})


def _size(value: float, unit: str) -> str:
    return f"{figures(value)} rad" if unit == "rad" else f"{figures(1e3 * value, 4)} mm"
