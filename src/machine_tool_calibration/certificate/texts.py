# SPDX-License-Identifier: Apache-2.0
"""What a certificate says in words: facts, statements, conditions, instruments."""

from collections.abc import Iterator, Sequence
from itertools import islice

from machine_tool_calibration.certificate.particulars import Certificate, Party
from machine_tool_calibration.certificate.points import CONDITIONS
from machine_tool_calibration.report.evaluation import Evaluation
from machine_tool_calibration.report.sections import set_up
from machine_tool_calibration.reports.budget import decision_words, rule_words
from machine_tool_calibration.reports.information import session_tables
from machine_tool_calibration.reports.tables import TextTable, heads
from machine_tool_calibration.session.session import Session
from machine_tool_calibration.session.summary import ColumnSummary, summarize
from machine_tool_calibration.words import Verbatim, say

Fact = tuple[str, Sequence[str]]
"""What is stated, and its lines."""


def facts(own: Certificate) -> list[Fact]:
    """What stands on the first page; without what is not stated."""
    item = own.machine
    days = [] if not own.measured else [own.measured[0].isoformat(), own.measured[-1].isoformat()]
    every: list[Fact] = [
        (say("certificate.machine"), [Verbatim(item.title)]),
        *((say(f"certificate.{key}"), [Verbatim(getattr(item, key))]) for key in ("serial", "inventory", "condition")),
        (say("certificate.customer"), _lines(own.customer)),
        (say("certificate.order"), [Verbatim(own.order)]),
        (say("certificate.place"), [Verbatim(own.place)]),
        (say("certificate.received"), [own.received.isoformat() if own.received else ""]),
        (say("certificate.measured"), [" – ".join(dict.fromkeys(days))]),
        (say("certificate.issued"), [own.issued.isoformat() if own.issued else ""]),
    ]
    return [(name, lines) for name, lines in every if any(lines)]


def _lines(party: Party) -> list[str]:
    return [Verbatim(text) for text in (party.name, *party.lines) if text]


def statements(own: Certificate, found: Evaluation) -> Iterator[str]:
    """The sentences above the signatures."""
    yield Verbatim(own.statement)
    if found.conformity is not None:
        yield say("certificate.conformity", decision=decision_words(found.conformity))
        yield say("certificate.specification", what=Verbatim(own.specification)) if own.specification else ""
        yield say("certificate.rule", rule=rule_words(found.conformity))
        agreed = own.decision_rule.agreed
        yield say("certificate.agreed", what=Verbatim(agreed)) if agreed else ""
    yield say("report.u_is_incomplete" if found.budget is None else "certificate.coverage")
    yield say("report.u_is_general") if found.budget is not None and found.general else ""
    yield Verbatim(own.traceability)
    for key in ("from_customer", "external"):
        yield say(f"certificate.{key}", what=Verbatim(getattr(own, key))) if getattr(own, key) else ""
    yield say("certificate.relates")
    yield say("certificate.whole")


def procedure(own: Certificate, found: Evaluation) -> Iterator[TextTable]:
    """How it was measured, and under what."""
    names = [say("certificate.procedure"), *[""] * len(own.procedure)]
    stated = [(name, Verbatim(text)) for name, text in zip(names, own.procedure, strict=False)]
    stated += [(say(f"certificate.{key}"), Verbatim(getattr(own, key))) for key in ("deviations", "adjustment")]
    yield TextTable("", ("", ""), tuple(row for row in stated if row[1]))
    yield TextTable(say("certificate.conditions"), ("", ""), tuple(stated_conditions(own)))
    for session in found.measured.recorded:
        yield set_up(session)
        summary = summarize(session)
        (columns,) = islice(session_tables(session, summary), 1, 2)
        rows = zip(summary.columns, columns.rows, strict=True)
        told = tuple(row for column, row in rows if column.name.startswith(CONDITIONS))
        yield TextTable(say("certificate.recorded"), columns.columns, told)
    yield TextTable("", ("", ""), ((say("certificate.remarks"), Verbatim(own.remarks)),) if own.remarks else ())


def stated_conditions(own: Certificate) -> Iterator[tuple[str, str]]:
    """Conditions that were stated, and what they are called."""
    for key in ("temperature", "reference_temperature", "compensation", "remarks"):
        if text := getattr(own.conditions, key):
            yield say(f"certificate.{key}"), Verbatim(text)


def recorded_conditions(session: Session) -> list[ColumnSummary]:
    """Columns of a session that tell the conditions."""
    return [one for one in summarize(session).columns if one.name.startswith(CONDITIONS)]


def instruments(own: Certificate) -> Iterator[TextTable]:
    """What it was measured with, and the certificates by which that is traceable."""
    rows = ((one.title, one.serial, one.certificate, one.calibrated, one.calibrated_by) for one in own.instruments)
    more = (say(f"certificate.{key}") for key in ("serial", "certificate", "calibrated", "by"))
    yield TextTable("", (*heads("instrument"), *more), tuple(tuple(map(Verbatim, row)) for row in rows))
