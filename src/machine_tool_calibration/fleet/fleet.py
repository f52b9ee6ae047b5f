# SPDX-License-Identifier: Apache-2.0
"""All machines of a logbook, in sentences and tables, and as a document."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from machine_tool_calibration.coverage import K
from machine_tool_calibration.fleet.each import Done
from machine_tool_calibration.fleet.machines import Machine, Machines, Occurrence
from machine_tool_calibration.fleet.sessions import Identified, Place
from machine_tool_calibration.interface.show import Answer
from machine_tool_calibration.reports.quantities import micrometres, probability, quantity
from machine_tool_calibration.reports.tables import Part, TextTable, heads
from machine_tool_calibration.reports.trends import trend_words
from machine_tool_calibration.reports.verdict import verdict_said
from machine_tool_calibration.words import Said, Verbatim, enumeration, say, together

# Sentences of a trend that tell why a machine needs attention.
_ALARMING = ("trend.says_jump", "trend.says_drift", "trend.says_exceeded", "trend.says_open")
_MOST_SENTENCES, _NAMED = 3, 8  # sentences and machines that a line names


def identified_table(done: Sequence[Done[Place, Identified]]) -> TextTable:
    """Sessions that were identified each by itself, one a row."""
    rows = []
    for one in done:
        row = [Verbatim(one.item.label), *[""] * 5, Verbatim(one.item.told(one.problem))]
        if one.found is not None:
            told = one.found.document
            largest = K * float(one.found.values.loc[one.found.values["unit"] == "m", "u"].max())
            model = ", ".join([told["model"], *told["effects"]])
            residual, u = micrometres(told["rms_residual"]), micrometres(largest)
            row[1:6] = [told["method"], model, str(told["used"]), residual, u]
        rows.append(tuple(row))
    problems = sum(1 for one in done if one.problem)
    columns = heads("session", "method", "model", "readings", "residual_um", "largest_U_um", "why")
    failed = say("fleet.failed", n=problems) if problems else ""
    return TextTable(say("fleet.identified", n=len(done)), columns, tuple(rows), failed)


def identified_document(done: Sequence[Done[Place, Identified]]) -> dict[str, Any]:
    """The same for programs."""
    sessions = [
        {"session": one.item.label, "path": str(one.item.path)}
        | ({"problem": one.problem} if one.found is None else {"result": one.found.document})
        for one in done
    ]
    return {"format": "mtcal-each/1", "sessions": sessions}


def fleet_line(fleet: Machines) -> Said:
    """How many machines and sessions there are, and how many need attention."""
    dates = [date for one in fleet.machines for date in (one.trend.dates[0], one.trend.dates[-1])]
    if not dates:
        return say("fleet.none")
    sessions = sum(len(one.entries) for one in fleet.machines)
    said = [
        say("fleet.machines", n=len(fleet.machines)),
        say("fleet.sessions", n=sessions, first=min(dates)[:10], last=max(dates)[:10]),
    ]
    said.append(say("fleet.attention", n=len(fleet.attention)) if fleet.attention else say("fleet.quiet"))
    if fleet.problems:
        said.append(say("fleet.failed", n=len(fleet.problems)))
    return together(said)


def reasons_of(machine: Machine) -> Iterator[Said]:
    """Why it needs attention, a sentence each."""
    for words in trend_words(machine.trend):
        if isinstance(words, Said) and words.key in _ALARMING:
            yield words
    if "effect" in machine.causes and machine.diagnosis is not None:
        names = enumeration([_sized(one) for one in machine.diagnosis["effects"]])
        yield say("fleet.lacks", names=names) if names else say("fleet.unexplained")
    worst = machine.uncertain
    if worst is not None and machine.largest_u is not None and K * worst.u > machine.largest_u:
        expanded, most = quantity(K * worst.u, "m"), quantity(machine.largest_u, "m")
        yield say("fleet.wide", name=worst.name, u=expanded, most=most)


def verdict_of(diagnosis: Mapping[str, Any] | None) -> str:
    """What a diagnosis says, in a few words."""
    if diagnosis is None:
        return say("fleet.not_diagnosed")
    names = enumeration([_sized(one) for one in diagnosis["effects"]])
    return verdict_said(diagnosis["verdict"], names, diagnosis["outliers"])


def _sized(one: Mapping[str, Any]) -> str:
    """An effect with the size of its first coefficient, or with its probability."""
    told = {"name": Verbatim(one["effect"]), "p": probability(one["probability"])}
    if not one["parameters"]:
        return say("verdict.with_probability", **told)
    return say("fleet.sized", name=told["name"], size=_first_size(one))


def _first_size(one: Mapping[str, Any]) -> str:
    first = one["parameters"][0]
    return quantity(first["value"], first["unit"], first["standard_uncertainty"])


def machines_table(machines: Sequence[Machine]) -> TextTable:
    """Machines with why they need attention, in sentences."""
    rows = []
    for one in machines:
        words = list(reasons_of(one))
        more = [say("fleet.more", n=len(words) - _MOST_SENTENCES)] if len(words) > _MOST_SENTENCES else []
        rows.append((Verbatim(one.name), *_state(one), together([*words[:_MOST_SENTENCES], *more])))
    columns = heads("machine", "last_session", "sessions", "error_now", "largest_u_of", "attention")
    return TextTable(say("fleet.section_attention"), columns, tuple(rows), say("fleet.note"))


def states_table(fleet: Machines) -> TextTable:
    """All machines by name, each in a line."""
    rows = [
        (Verbatim(one.name), *_state(one), together(_causes(one), "; ") if one.causes else verdict_of(one.diagnosis))
        for one in sorted(fleet.machines, key=lambda own: own.name)
    ]
    columns = heads("machine", "last_session", "sessions", "error_now", "largest_u_of", "state")
    return TextTable(say("fleet.section_all"), columns, tuple(rows), say("fleet.note"))


def _causes(one: Machine) -> Iterator[str]:
    """Why it needs attention, with names alone."""
    courses = one.trend.courses
    names = {
        "limit": [own.name for own in courses if own.against_limit == "exceeded"],
        "change": [own.name for own in courses if own.changed],
        "effect": [own["effect"] for own in one.diagnosis["effects"]] if one.diagnosis else [],
        "uncertain": [own.name for own in courses if own.against_limit == "open"],
    }
    for cause in one.causes:
        said = say(f"fleet.cause_{cause}")
        yield say("text.join", one=said, other=", ".join(names[cause])) if names[cause] else said


def _state(one: Machine) -> tuple[str, ...]:
    size, worst = one.size, one.uncertain
    return (
        one.trend.dates[-1],
        str(len(one.entries)),
        "" if size is None else say("text.sized", name=size.name, size=quantity(size.value, size.unit, size.u)),
        "" if worst is None else say("text.sized", name=worst.name, size=quantity(K * worst.u, worst.unit)),
    )


def effects_table(fleet: Machines) -> TextTable:
    """Effects that the last sessions' models lack, and on which machines."""
    rows = []
    for name, where in fleet.occurrences.items():
        ranked = sorted(where, key=_magnitude, reverse=True)
        named = [_where(one) for one in ranked[:_NAMED]]
        more = [say("fleet.more_machines", n=len(ranked) - _NAMED)] if len(ranked) > _NAMED else []
        count = sum(one.sessions for one in where)
        rows.append((Verbatim(name), str(len(where)), str(count), together([*named, *more], ", ")))
    columns = heads("effect", "machines", "sessions", "where")
    return TextTable(say("fleet.section_effects"), columns, tuple(rows), say("fleet.effects_note"))


def _where(one: Occurrence) -> str:
    name = Verbatim(one.machine)
    return say("fleet.sized", name=name, size=_first_size(one.found)) if one.found["parameters"] else name


def _magnitude(one: Occurrence) -> float:
    return abs(one.found["parameters"][0]["value"]) if one.found["parameters"] else 0.0


def problems_table(fleet: Machines) -> TextTable:
    """Sessions that could not be evaluated."""
    rows = tuple((Verbatim(label), Verbatim(problem)) for label, problem in fleet.problems)
    return TextTable(say("fleet.section_failed"), heads("session", "why"), rows)


@dataclass(frozen=True, eq=False, repr=False)
class Fleet(Answer, Machines):
    """All machines of a logbook: which of them need attention and why, which effects occur where."""

    @property
    def headline(self) -> str:
        """How many machines need attention."""
        return fleet_line(self)

    def parts(self) -> Iterator[Part]:
        """Which machines need attention and why, which effects occur where, and what was not evaluated."""
        yield fleet_line(self)
        tables = (machines_table(self.attention), effects_table(self), problems_table(self))
        yield from (table for table in tables if table.rows)

    @cached_property
    def _document(self) -> dict[str, Any]:
        return {
            "format": "mtcal-fleet/1",
            "added": self.added,
            "sessions": sum(len(one.entries) for one in self.machines),
            "machines": [_document_of(one) for one in self.machines],
            "effects": [
                {
                    "effect": name,
                    "machines": [{"machine": one.machine, "sessions": one.sessions, **one.found} for one in where],
                }
                for name, where in self.occurrences.items()
            ],
            "problems": [{"session": label, "problem": problem} for label, problem in self.problems],
        }


def _document_of(machine: Machine) -> dict[str, Any]:
    return {
        "machine": machine.name,
        "causes": machine.causes,
        "sentences": list(reasons_of(machine)),
        "sessions": len(machine.entries),
        "first": machine.trend.dates[0],
        "last": machine.trend.dates[-1],
        "verdict": machine.diagnosis and machine.diagnosis["verdict"],
        "effects": [one["effect"] for one in machine.diagnosis["effects"]] if machine.diagnosis else [],
        "alarms": [one.name for one in machine.trend.alarms],
        "size": machine.size,
        "most_uncertain": machine.uncertain,
    }
