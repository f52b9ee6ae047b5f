# SPDX-License-Identifier: Apache-2.0
"""What is said of one machine over months: its logbook, whether an earlier map still holds, and what changes."""

from collections.abc import Iterator, Sequence

import numpy as np

from machine_tool_calibration.budget.published import POSITION_ERROR
from machine_tool_calibration.reports.quantities import probability, quantity, rounded
from machine_tool_calibration.reports.tables import TextTable, heads, table
from machine_tool_calibration.trends.check import SESSIONS, Change, Check
from machine_tool_calibration.trends.logbook import Entry
from machine_tool_calibration.trends.statement import SCATTER
from machine_tool_calibration.trends.trend import Course, Trend
from machine_tool_calibration.words import enumeration, say

# Figures of a hash that text shows, and changes that one line names.
_SHORT, _MOST_CHANGES = 12, 3


def entries_table(entries: Sequence[Entry]) -> TextTable:
    """The entries of a logbook, one a row."""
    return table(
        say("logbook.title", n=len(entries)),
        entries,
        number=lambda one: str(one.number),
        date=lambda one: one.date,
        machine=lambda one: one.machine,
        session=lambda one: one.label,
        instrument=lambda one: one.instrument,
        model=lambda one: ", ".join([str(one.result.get("model", "")), *one.result.get("effects", ())]),
        sizes=lambda one: str(len(one.sizes)),
        sum=lambda one: one.sha256[:_SHORT],
    )


def check_table(check: Check) -> TextTable:
    """Every error that both have, the most significant change first."""
    return table(
        say("check.title", earlier=check.earlier, now=check.now),
        check.changes,
        say("check.note", n=len(check.changes)),
        figure=_name,
        was=lambda one: quantity(one.before, one.unit),
        is_now=lambda one: quantity(one.after, one.unit),
        largest_change=lambda one: quantity(one.change, one.unit, one.u),
        changed_at=_where,
        adjusted_p=lambda one: probability(one.adjusted),
        verdict=lambda one: say(f"check.{_verdict_of(one)}"),
    )


def check_verdict(check: Check) -> str:
    """Whether the map still holds, in one line."""
    if check.contradicted and not check.moved:
        before, after = map(rounded, check.scatter)
        return say("check.contradicted", n=len(check.changes), now=check.now, before=before, after=after)
    if not (check.moved or check.open):
        return say("check.holds" if check.holds else "check.open", n=len(check.changes))
    # Position errors are made of the others: they are named only where none of these is found.
    told_of = check.moved or check.open
    moved = [one for one in told_of if one.name != POSITION_ERROR] or list(told_of)
    told = []
    for one in moved[:_MOST_CHANGES]:
        size, where = quantity(one.change, one.unit, one.u), _where(one)
        key = "check.changed_at" if where else "check.changed"
        told.append(say(key, name=_name(one), size=size, **({"where": where} if where else {})))
    if len(moved) > _MOST_CHANGES:
        told.append(say("check.more", n=len(moved) - _MOST_CHANGES))
    return say("check.fails" if check.moved else "check.may_fail", what=enumeration(told))


def check_remarks(check: Check) -> Iterator[str]:
    """Since when, what could not be told, and what U contains; a sentence each."""
    if check.moved and check.since:
        dates = dict(zip(("since", "until"), sorted((check.since, check.until or check.since)), strict=True))
        yield say("check.since_until", **dates) if check.until else say("check.since", since=check.since)
    if check.blind:
        yield say("check.blind_words", names=enumeration([_name(one) for one in check.blind]))
    if check.places[0] < check.places[1]:
        n, count = check.places
        yield say("check.places", n=n, count=count) if n else say("check.no_places")
    if check.not_compared:
        yield say("check.not_compared", names=", ".join(check.not_compared))
    if check.misfit and (check.moved or not check.contradicted):
        yield say("check.misfit", now=check.now, ratio=rounded(check.scatter[1]))
    if check.map_misfit and not check.contradicted:
        yield say("check.map_misfit", earlier=check.earlier, ratio=rounded(check.scatter[0]))
    if not check.correlated:
        yield say("check.uncorrelated")
    yield say("check.between", n=check.sessions) if check.sessions else say("check.no_between", n=SESSIONS)


def _verdict_of(change: Change) -> str:
    if change.moved:
        return "moved"
    return "open_change" if change.open else "blind" if change.blind else "stayed"


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


def trend_table(found: Trend) -> TextTable:
    """Every number that is followed: alarms first."""
    columns = heads("figure", "at_first", "at_last", "change_U", "explanation", "probability", "spread", "limit")
    title = say("trend.title", machine=found.machine, n=len(found.dates), first=found.dates[0], last=found.dates[-1])
    return TextTable(title, columns, tuple(_course_row(one) for one in found.courses), say("trend.note"))


def _course_row(one: Course) -> tuple[str, ...]:
    values = (one.name, quantity(float(one.value[0]), one.unit), _last(one))
    limit = "" if one.limit is None else say(f"trend.{one.against_limit}", limit=quantity(one.limit, one.unit))
    if one.explanation is None:
        return (*values, "", say("trend.few"), "", "", limit)
    change = ""
    if one.changed or one.suspected:
        change = quantity(one.explanation.change, one.unit, one.explanation.u)
    elif one.kind == "temperature":
        change = _per_kelvin(one)
    elif one.shifted:
        change = quantity(one.explanation.step, one.unit, one.explanation.u_step)
    kind = say(f"trend.possible_{one.kind}" if one.suspected else f"trend.{one.kind}")
    changed = one.explanation.probability
    other = {"instrument": one.explanation.shift, "temperature": one.explanation.warm, "steady": 1.0 - changed}
    chance = other.get(one.kind, changed)
    spread = one.explanation.spread
    told = rounded(spread) if one.unit == "1" else quantity(spread, one.unit)
    return (*values, change, kind, probability(chance), told, limit)


def trend_words(found: Trend) -> Iterator[str]:
    """What has changed, what another instrument explains, what is beyond a limit; a sentence each."""
    for one in found.courses:
        if one.changed and one.explanation is not None:
            size = quantity(one.explanation.change, one.unit, one.explanation.u)
            p, (first, last) = probability(one.explanation.probability), one.began
            more = {"now": one.dates[-1]} if one.kind == "drift" else {}
            yield say(f"trend.says_{one.kind}", name=one.name, size=size, first=first, last=last, p=p, **more)
            if one.name == SCATTER:
                yield say("trend.says_misfit")
        if one.against_limit in ("exceeded", "open") and one.limit is not None:
            limit, date = quantity(one.limit, one.unit), one.dates[-1]
            yield say(f"trend.says_{one.against_limit}", name=one.name, limit=limit, size=_last(one), date=date)
    # Another instrument may scatter otherwise, which is nothing that it reads more.
    lengths = [one for one in found.courses if one.name != SCATTER]
    shifted = [(one, one.explanation) for one in lengths if one.explanation is not None and one.shifted]
    if shifted:
        most, said = max(shifted, key=lambda pair: abs(pair[1].step) / pair[1].u_step)
        names, size = enumeration([one.name for one, _ in shifted]), quantity(said.step, most.unit, said.u_step)
        yield say("trend.says_instrument", names=names, name=most.name, instrument=most.ways[most.way[-1]], size=size)
    if warm := [one for one in found.courses if one.kind == "temperature"]:
        each = [f"{one.name} ({_per_kelvin(one)})" for one in warm]
        yield say("trend.says_temperature", n=len(warm), names=enumeration(each))
    told = sum(one.kind != "few" for one in found.courses)
    if not found.alarms:
        yield say("trend.quiet", n=told) if told else say("trend.untold")
    ended: dict[str, list[str]] = {}
    for one in found.courses:
        if one.dates[-1] != found.dates[-1]:
            ended.setdefault(one.dates[-1], []).append(one.name)
    for date, which in sorted(ended.items()):
        yield say("trend.says_ended", n=len(which), names=enumeration(which), date=date)


def _per_kelvin(one: Course) -> str:
    assert one.explanation is not None
    return quantity(
        one.explanation.per_kelvin, "1/K" if one.unit == "1" else f"{one.unit}/K", one.explanation.u_per_kelvin
    )


def _last(one: Course) -> str:
    return quantity(float(one.value[-1]), one.unit, float(one.u[-1]))
