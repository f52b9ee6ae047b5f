# SPDX-License-Identifier: Apache-2.0
"""What ISO/IEC 17025:2017 asks of a certificate, 7.8.2 to 7.8.6, and what of it nobody has stated."""

from collections.abc import Iterable, Iterator
from itertools import groupby
from operator import attrgetter

from machine_tool_calibration.certificate.particulars import Certificate
from machine_tool_calibration.report.evaluation import Evaluation

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
