# SPDX-License-Identifier: Apache-2.0
"""What ISO/IEC 17025:2017 asks of a certificate, 7.8.2 to 7.8.6, and what of it nobody has stated."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import groupby

from machine_tool_calibration.certificate.particulars import Certificate, Party
from machine_tool_calibration.report.evaluation import Evaluation

# Columns of the readings that tell the conditions.
CONDITIONS = ("temperature_", "air_pressure", "relative_humidity")


def missing(own: Certificate, found: Evaluation) -> str:
    """In one line the points of ISO/IEC 17025:2017 that are not met, each with the keys that would; empty if none."""
    points = (point for part in (_common(own), _calibration(own, found), _conformity(own, found)) for point in part)
    told = ((point, ", ".join(key for _, key in same)) for point, same in groupby(points, lambda one: one[0]))
    return "; ".join(f"{point} ({keys})" for point, keys in told)


def _common(own: Certificate) -> Iterator[tuple[str, str]]:
    """7.8.2.1: what every report has."""
    yield from (("7.8.2.1 b", key) for key in _unreachable("laboratory", own.laboratory))
    needed = (("c", "place"), ("d", "number"))
    yield from ((f"7.8.2.1 {point}", key) for point, key in needed if not getattr(own, key))
    yield from (("7.8.2.1 e", key) for key in _unreachable("customer", own.customer))
    if not any(own.procedure):
        yield "7.8.2.1 f", "procedure"
    yield from (("7.8.2.1 g", f"machine.{key}") for key in ("name", "serial") if not getattr(own.machine, key))
    needed = (("i", "measured"), ("j", "issued"))
    yield from ((f"7.8.2.1 {point}", key) for point, key in needed if not getattr(own, key))
    if not any(one.name for one in own.signatures):
        yield "7.8.2.1 o", "signatures"


def _unreachable(key: str, party: Party) -> Iterator[str]:
    yield from (f"{key}.{name}" for name in ("name", "city") if not getattr(party, name))


def _calibration(own: Certificate, found: Evaluation) -> Iterator[tuple[str, str]]:
    """7.8.4.1: uncertainty, conditions, traceability."""
    if found.budget is None or found.general:
        yield "7.8.4.1 a", "--budget"
    recorded = [name for session in found.measured.recorded for name in session.readings.columns]
    if not own.conditions.temperature and not any(name.startswith(CONDITIONS[0]) for name in recorded):
        yield "7.8.4.1 b", "conditions.temperature"
    for key in ("reference_temperature", "compensation"):
        if not getattr(own.conditions, key):
            yield "7.8.4.1 b", f"conditions.{key}"
    if not own.traceability:
        yield "7.8.4.1 c", "traceability"
    if not own.instruments:
        yield "7.8.4.1 c", "instruments"
    for k, one in enumerate(own.instruments):
        lacking = (key for key in ("serial", "certificate") if not getattr(one, key))
        yield from (("7.8.4.1 c", f"instruments[{k}].{key}") for key in lacking)


def _conformity(own: Certificate, found: Evaluation) -> Iterator[tuple[str, str]]:
    """7.8.6: the decision rule, and what was to be met; only where something is said to conform."""
    if found.conformity is not None:
        if own.decision_rule is None or not own.decision_rule.agreed:
            yield "7.8.6.1", "decision_rule.agreed"
        if not own.specification:
            yield "7.8.6.2 b", "specification"
