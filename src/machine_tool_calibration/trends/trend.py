# SPDX-License-Identifier: Apache-2.0
"""The sizes of a machine's errors over time: what jumped, drifts, was read by another sensor, or is beyond a limit."""

import datetime
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from machine_tool_calibration.arrays import Array, IntArray
from machine_tool_calibration.budget.conformity import unit_of_figure
from machine_tool_calibration.errors import ModelError, did_you_mean
from machine_tool_calibration.estimation.priors import ACCEPTED
from machine_tool_calibration.trends.explain import FEWEST, Explanation, explain
from machine_tool_calibration.trends.logbook import Entry

_COVERAGE = 2.0
_DAY = 86400.0


@dataclass(frozen=True, eq=False)
class Course:
    """One number of a machine from session to session."""

    name: str  # of the error
    unit: str  # SI
    dates: tuple[str, ...]  # when it was measured
    days: Array  # (n,) since the first one
    value: Array  # value, u: (n,) with standard uncertainties, in the unit
    u: Array
    way: IntArray  # (n,) which way of measuring each is of
    ways: tuple[str, ...]  # their names: the instrument, and the model where instruments do not tell them apart
    explanation: Explanation | None  # None of fewer sessions than say something
    limit: float | None = None  # that its absolute value should keep; None without one

    @property
    def changed(self) -> bool:
        """Whether it has jumped or drifts."""
        return self.explanation is not None and self.explanation.changed

    @property
    def shifted(self) -> bool:
        """Whether ways of measuring differ in it."""
        return self.explanation is not None and self.explanation.shifted

    @property
    def suspected(self) -> bool:
        """Whether a change is more probable than none, and yet no alarm."""
        return self.explanation is not None and not self.changed and self.explanation.probability > ACCEPTED

    @property
    def kind(self) -> str:
        """`jump`, `drift`, `instrument`, `steady`, or `few` sessions; of a suspected change which one it would be."""
        if self.explanation is None:
            return "few"
        if self.changed or self.suspected:
            return "jump" if self.explanation.jump >= self.explanation.drift else "drift"
        return "instrument" if self.shifted else "steady"

    @property
    def began(self) -> tuple[str, str]:
        """Dates between which the change began, with a probability of 95 %."""
        assert self.explanation is not None
        return self.dates[self.explanation.first], self.dates[self.explanation.last]

    @property
    def against_limit(self) -> str | None:
        """Of the last session: `exceeded`, `kept`, or `open` where U contains the limit; None without a limit."""
        if self.limit is None:
            return None
        size, room = abs(self.value[-1]), _COVERAGE * self.u[-1]
        return "exceeded" if size - room > self.limit else "kept" if size + room <= self.limit else "open"

    @property
    def alarm(self) -> bool:
        """Whether it has changed, or is beyond its limit."""
        return self.changed or self.against_limit == "exceeded"


@dataclass(frozen=True)
class Trend:
    """A machine over time."""

    machine: str  # its name
    dates: tuple[str, ...]  # of all sessions
    courses: tuple[Course, ...]  # of its errors; first what changed, then what other instruments read otherwise

    @property
    def alarms(self) -> tuple[Course, ...]:
        """What has changed, or is beyond its limit."""
        return tuple(one for one in self.courses if one.alarm)


def trend(entries: Sequence[Entry], limits: Mapping[str, float] | None = None) -> Trend:
    """Follow the sizes of one machine's errors over entries by date, with limits by name, in m or rad.

    A ModelError: a limit for what is in no entry, or in another unit.
    """
    limits = limits or {}
    names = {size.name: size.unit for entry in entries for size in entry.sizes}
    for name in limits:
        if name not in names:
            known = did_you_mean(name, names) or f"; there are {', '.join(names)}"
            raise ModelError(f"no session has {name!r}{known}")
        if names[name] != unit_of_figure(name):
            raise ModelError(f"{name} is in {names[name]}: limits are for errors in m and squareness in rad")
    ways = _ways(entries)
    courses = [_course(name, entries, ways, len(names), limits.get(name)) for name in names]
    alarms = [one for one in courses if one.alarm]
    rank = {"jump": 0, "drift": 0, "instrument": 1, "steady": 2, "few": 3}
    ordered = sorted(courses, key=lambda one: (one not in alarms, rank[one.kind]))
    return Trend(entries[0].machine, tuple(entry.date for entry in entries), tuple(ordered))


def _ways(entries: Sequence[Entry]) -> list[str]:
    """How each session was measured, and by which model: sizes by different ones differ without any change."""
    models = [", ".join([str(e.result.get("model")), *e.result.get("effects", ())]) for e in entries]
    several = len(set(zip((e.instrument for e in entries), models, strict=True))) > len({e.instrument for e in entries})
    return [f"{e.instrument} ({m})" if several else e.instrument for e, m in zip(entries, models, strict=True)]


def _course(name: str, entries: Sequence[Entry], ways: Sequence[str], among: int, limit: float | None) -> Course:
    rows = [(e, w, s) for e, w in zip(entries, ways, strict=True) for s in e.sizes if s.name == name]
    moments = [datetime.datetime.fromisoformat(entry.date).replace(tzinfo=None) for entry, _, _ in rows]
    days = np.array([(moment - moments[0]).total_seconds() / _DAY for moment in moments])
    value, u = np.array([size.value for _, _, size in rows]), np.array([size.u for _, _, size in rows])
    listed = list(dict.fromkeys(way for _, way, _ in rows))
    way = np.array([listed.index(own) for _, own, _ in rows])
    told = explain(days, value, u, way, among) if len(rows) >= FEWEST and days[-1] > 0 else None
    dates = tuple(entry.date for entry, _, _ in rows)
    return Course(name, rows[0][2].unit, dates, days, value, u, way, tuple(listed), told, limit)
