# SPDX-License-Identifier: Apache-2.0
"""What is said of one machine over months: its logbook, whether an earlier map still holds, and what changes."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

import numpy as np

from machine_tool_calibration.budget.published import POSITION_ERROR
from machine_tool_calibration.reports.quantities import probability, quantity
from machine_tool_calibration.reports.tables import TextTable, heads
from machine_tool_calibration.trends.check import SESSIONS, Change, Check
from machine_tool_calibration.words import enumeration, say

if TYPE_CHECKING:
    from machine_tool_calibration.trends.logbook import Entry

__all__ = ["check_remarks", "check_table", "check_verdict", "entries_table"]

# Figures of a hash that text shows, and changes that one line names.
_SHORT, _MOST = 12, 3


def entries_table(entries: Sequence[Entry]) -> TextTable:
    """The entries of a logbook, one a row."""
    rows = tuple(
        (
            *(str(one.number), one.date, one.machine, one.label, one.instrument),
            ", ".join([str(one.result.get("model", "")), *one.result.get("effects", ())]),
            *(str(len(one.sizes)), one.sha256[:_SHORT]),
        )
        for one in entries
    )
    columns = heads("number", "date", "machine", "session", "instrument", "model", "sizes", "sum")
    return TextTable(say("logbook.title", n=len(entries)), columns, rows)


def check_table(check: Check) -> TextTable:
    """Every error that both have, the most significant change first."""
    rows = tuple(
        (
            *(_name(one), quantity(one.before, one.unit), quantity(one.after, one.unit)),
            *(quantity(one.change, one.unit, one.u), _where(one)),
            *(
                probability(one.adjusted),
                say("check.moved" if one.moved else "check.blind" if one.blind else "check.stayed"),
            ),
        )
        for one in check.changes
    )
    columns = heads("figure", "was", "is_now", "largest_change", "changed_at", "adjusted_p", "verdict")
    title = say("check.title", earlier=check.earlier, now=check.now)
    return TextTable(title, columns, rows, say("check.note", n=len(check.changes)))


def check_verdict(check: Check) -> str:
    """Whether the map still holds, in one line."""
    if not check.moved:
        return say("check.holds", n=len(check.changes))
    # Position errors are made of the others: they are named only where none of these is found.
    moved = [one for one in check.moved if one.name != POSITION_ERROR] or list(check.moved)
    told = []
    for one in moved[:_MOST]:
        size, where = quantity(one.change, one.unit, one.u), _where(one)
        key = "check.changed_at" if where else "check.changed"
        told.append(say(key, name=_name(one), size=size, **({"where": where} if where else {})))
    if len(moved) > _MOST:
        told.append(say("check.more", n=len(moved) - _MOST))
    return say("check.fails", what=enumeration(told))


def check_remarks(check: Check) -> Iterator[str]:
    """Since when, what could not be told, and what U contains; a sentence each."""
    if check.moved and check.since:
        dates = {"since": check.since, "until": check.until}
        yield say("check.since_until", **dates) if check.until else say("check.since", since=check.since)
    if check.blind:
        yield say("check.blind_words", names=enumeration([_name(one) for one in check.blind]))
    if check.untold:
        yield say("check.untold", names=", ".join(check.untold))
    if not check.correlated:
        yield say("check.uncorrelated")
    yield say("check.between", n=check.sessions) if check.sessions else say("check.no_between", n=SESSIONS)


def _name(change: Change) -> str:
    return say("check.position_error") if change.name == POSITION_ERROR else change.name


def _where(change: Change) -> str:
    if change.along is not None:
        place = ", ".join(f"{1e3 * v:.6g}" for v in change.at)
        return say("check.along_at", axis="xyz"[change.along], place=place)
    if not change.at:
        return ""
    turned = change.name[-1] in "ABC"
    return say("check.at", place=f"{np.degrees(change.at[0]):.6g}°" if turned else f"{1e3 * change.at[0]:.6g} mm")
