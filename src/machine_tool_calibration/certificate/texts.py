# SPDX-License-Identifier: Apache-2.0
"""What a certificate says in words: facts, statements, conditions, instruments."""

from collections.abc import Iterable, Iterator, Sequence
from itertools import groupby, islice
from operator import attrgetter

from machine_tool_calibration.certificate.particulars import Certificate
from machine_tool_calibration.report.evaluation import Evaluation
from machine_tool_calibration.report.sections import set_up
from machine_tool_calibration.reports.budget import decision_words, rule_words
from machine_tool_calibration.reports.information import session_tables
from machine_tool_calibration.reports.tables import TextTable, heads
from machine_tool_calibration.session.summary import summarize
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
        (say("certificate.customer"), [Verbatim(text) for text in (own.customer.name, *own.customer.lines) if text]),
        (say("certificate.order"), [Verbatim(own.order)]),
        (say("certificate.place"), [Verbatim(own.place)]),
        (say("certificate.received"), [own.received.isoformat() if own.received else ""]),
        (say("certificate.measured"), [" – ".join(dict.fromkeys(days))]),
        (say("certificate.issued"), [own.issued.isoformat() if own.issued else ""]),
    ]
    return [(name, lines) for name, lines in every if any(lines)]


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
    entries = [(name, Verbatim(text)) for name, text in zip(names, own.procedure, strict=False)]
    entries += [(say(f"certificate.{key}"), Verbatim(getattr(own, key))) for key in ("deviations", "adjustment")]
    yield TextTable("", ("", ""), tuple(row for row in entries if row[1]))
    yield TextTable(say("certificate.conditions"), ("", ""), tuple(declared_conditions(own)))
    for session in found.measured.recorded:
        yield set_up(session)
        summary = summarize(session)
        (columns,) = islice(session_tables(session, summary), 1, 2)
        rows = zip(summary.columns, columns.rows, strict=True)
        told = tuple(row for column, row in rows if column.name.startswith(CONDITIONS))
        yield TextTable(say("certificate.recorded"), columns.columns, told)
    yield TextTable("", ("", ""), ((say("certificate.remarks"), Verbatim(own.remarks)),) if own.remarks else ())


def declared_conditions(own: Certificate) -> Iterator[tuple[str, str]]:
    """Conditions that were stated, and what they are called."""
    for key in ("temperature", "reference_temperature", "compensation", "remarks"):
        if text := getattr(own.conditions, key):
            yield say(f"certificate.{key}"), Verbatim(text)


def instruments(own: Certificate) -> Iterator[TextTable]:
    """What it was measured with, and the certificates by which that is traceable."""
    rows = ((one.title, one.serial, one.certificate, one.calibrated, one.calibrated_by) for one in own.instruments)
    more = (say(f"certificate.{key}") for key in ("serial", "certificate", "calibrated", "by"))
    yield TextTable("", (*heads("instrument"), *more), tuple(tuple(map(Verbatim, row)) for row in rows))


CONDITIONS = ("temperature_", "air_pressure", "relative_humidity")
"""How the columns of readings begin that tell the conditions."""
# Points of every report (7.8.2.1) and of a calibration certificate (7.8.4.1), and the keys that meet them.
_NEEDED = {
    "7.8.2.1 b": ("laboratory.name", "laboratory.city"),
    "7.8.2.1 c": ("place",),
    "7.8.2.1 d": ("number",),
    "7.8.2.1 e": ("customer.name", "customer.city"),
    "7.8.2.1 f": ("procedure",),
    "7.8.2.1 g": ("machine.name", "machine.serial"),
    "7.8.2.1 i": ("measured",),
    "7.8.2.1 j": ("issued",),
    "7.8.2.1 o": ("signatures",),
    "7.8.4.1 b": ("conditions.reference_temperature", "conditions.compensation"),
    "7.8.4.1 c": ("traceability", "instruments"),
}
# Those of a statement of conformity (7.8.6), where there is one.
_OF_CONFORMITY = {"7.8.6.1": ("decision_rule.agreed",), "7.8.6.2 b": ("specification",)}


def unstated(own: Certificate, keys: Iterable[str]) -> list[str]:
    """Those of the keys under which nothing is stated."""
    return [key for key in keys if not attrgetter(key)(own)]


def missing(own: Certificate, found: Evaluation) -> str:
    """In one line the points of ISO/IEC 17025:2017 that are not met, each with the keys that would; empty if none."""
    points = sorted(_missing(own, found), key=lambda one: one[0])
    told = ((point, ", ".join(key for _, key in same)) for point, same in groupby(points, lambda one: one[0]))
    return "; ".join(f"{point} ({keys})" for point, keys in told)


def _missing(own: Certificate, found: Evaluation) -> Iterator[tuple[str, str]]:
    for point, keys in (_NEEDED | (_OF_CONFORMITY if found.conformity else {})).items():
        yield from ((point, key) for key in unstated(own, keys))
    if found.budget is None or found.general:
        yield "7.8.4.1 a", "--budget"
    recorded = [name for session in found.measured.recorded for name in session.readings.columns]
    if not own.conditions.temperature and not any(name.startswith(CONDITIONS[0]) for name in recorded):
        yield "7.8.4.1 b", "conditions.temperature"
    for k, one in enumerate(own.instruments):
        lacking = (key for key in ("name", "serial", "certificate") if not getattr(one, key))
        yield from (("7.8.4.1 c", f"instruments[{k}].{key}") for key in lacking)
