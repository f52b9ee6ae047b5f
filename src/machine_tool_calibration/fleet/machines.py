# SPDX-License-Identifier: Apache-2.0
"""All machines of a logbook: which of them need attention, which effects occur where."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import groupby
from typing import Any

from machine_tool_calibration.budget.conformity import VOLUMETRIC
from machine_tool_calibration.coverage import K
from machine_tool_calibration.errors import ModelError, did_you_mean
from machine_tool_calibration.trends.logbook import Entry
from machine_tool_calibration.trends.statement import Size
from machine_tool_calibration.trends.trend import Trend, trend

CAUSES = ("limit", "change", "effect", "uncertain")
"""Why a machine needs attention, the most urgent first."""
_LACKING = ("missing_effect", "unexplained")


@dataclass(frozen=True, eq=False)
class Machine:
    """One machine of a fleet."""

    entries: tuple[Entry, ...]  # its sessions by date
    trend: Trend  # what changed on it
    # what its sessions' diagnoses say, in their order; None of one that was not diagnosed
    diagnoses: tuple[Mapping[str, Any] | None, ...]
    largest_u: float | None = None  # the largest U (95 %) that is no cause of attention, m; None for any

    @property
    def name(self) -> str:
        """Its name."""
        return self.trend.machine

    @property
    def diagnosis(self) -> Mapping[str, Any] | None:
        """Of its last session."""
        return self.diagnoses[-1]

    @property
    def uncertain(self) -> Size | None:
        """What its last session knows worst, of lengths; None where there are none."""
        return max(self._lengths, key=lambda size: size.u, default=None)

    @property
    def size(self) -> Size | None:
        """The volumetric error of its last session; the largest length where it has none."""
        whole = [size for size in self._lengths if size.name == VOLUMETRIC]
        return max(whole or self._lengths, key=lambda size: abs(size.value), default=None)

    @cached_property
    def causes(self) -> tuple[str, ...]:
        """Why it needs attention, of `CAUSES`; empty where it does not."""
        against = [one.against_limit for one in self.trend.courses if one.dates[-1] == self.trend.dates[-1]]
        worst = self.uncertain
        wide = self.largest_u is not None and worst is not None and K * worst.u > self.largest_u
        there = {
            "limit": "exceeded" in against,
            "change": any(one.changed for one in self.trend.courses),
            "effect": self.diagnosis is not None and self.diagnosis["verdict"] in _LACKING,
            "uncertain": "open" in against or wide,
        }
        return tuple(cause for cause in CAUSES if there[cause])

    @property
    def _lengths(self) -> tuple[Size, ...]:
        return tuple(size for size in self.entries[-1].sizes if size.unit == "m")


@dataclass(frozen=True)
class Occurrence:
    """An effect on a machine."""

    machine: str  # the machine's name
    found: Mapping[str, Any]  # what its last session says of it: `probability` and `parameters`
    sessions: int  # in how many of its sessions it was found


@dataclass(frozen=True, eq=False)
class Machines:
    """All machines of a logbook."""

    machines: tuple[Machine, ...]  # those that need attention first, the most urgent at the top
    problems: tuple[tuple[str, str], ...] = ()  # sessions that could not be evaluated, with the reason
    added: int = 0  # sessions that were entered now

    @property
    def attention(self) -> tuple[Machine, ...]:
        """Machines that need attention."""
        return tuple(one for one in self.machines if one.causes)

    @cached_property
    def occurrences(self) -> dict[str, tuple[Occurrence, ...]]:
        """By effect, the machines whose last session lacks it; the effect that most lack first."""
        found: dict[str, list[Occurrence]] = {}
        for machine in sorted(self.machines, key=lambda one: one.name):
            counted = Counter(one["effect"] for own in machine.diagnoses if own for one in own["effects"])
            for one in machine.diagnosis["effects"] if machine.diagnosis else ():
                name = one["effect"]
                found.setdefault(name, []).append(Occurrence(machine.name, one, counted[name]))
        return {name: tuple(found[name]) for name in sorted(found, key=lambda name: (-len(found[name]), name))}


def judged(
    entries: Sequence[Entry],
    diagnoses: Mapping[str, Mapping[str, Any]],
    *,
    limits: Mapping[str, float] | None = None,
    largest_u: float | None = None,
    problems: Sequence[tuple[str, str]] = (),
    added: int = 0,
) -> Machines:
    """Judge all machines of a logbook by their entries, and by diagnoses by the SHA-256 of the session.

    Limits of sizes by name, m or rad, are for every machine that has such a size; `largest_u` is the U (95 %) of a
    length beyond which a machine needs attention, m. A ModelError as for `trend`.
    """
    names = {size.name for entry in entries for size in entry.sizes}
    for name in limits or {}:
        if entries and name not in names:
            raise ModelError(f"no session has {name!r}{did_you_mean(name, names) or f'; there are {sorted(names)}'}")
    machines = []
    # By the label within a day: the order in which sessions were entered is that in which they were finished.
    ordered = sorted(entries, key=lambda one: (one.machine, one.date, one.label))
    for _, several in groupby(ordered, key=lambda one: one.machine):
        own = tuple(several)
        has = {size.name for entry in own for size in entry.sizes}
        found = trend(own, {name: value for name, value in (limits or {}).items() if name in has})
        machines.append(Machine(own, found, tuple(diagnoses.get(entry.sha256) for entry in own), largest_u))
    # the most urgent first
    ranked = sorted(machines, key=lambda one: (not one.causes, [cause not in one.causes for cause in CAUSES], one.name))
    return Machines(tuple(ranked), tuple(sorted(problems)), added)
