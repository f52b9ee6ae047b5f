# SPDX-License-Identifier: Apache-2.0
"""The certificate for programs: a Digital Calibration Certificate (DCC 3.2.1 of PTB, quantities in D-SI 2.1.0)."""

from collections.abc import Iterator, Sequence
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pandas as pd

from machine_tool_calibration.budget.conformity import Verdict
from machine_tool_calibration.certificate.particulars import Certificate
from machine_tool_calibration.certificate.texts import CONDITIONS, declared_conditions, statements, unstated
from machine_tool_calibration.errors import CalibrationError
from machine_tool_calibration.report.evaluation import Evaluation
from machine_tool_calibration.report.page import rendered
from machine_tool_calibration.reports.result_tables import tidy
from machine_tool_calibration.session.session import Session
from machine_tool_calibration.session.summary import summarize
from machine_tool_calibration.words import Words, named

VERSION = "3.2.1"
SPACES = {"dcc": "https://ptb.de/dcc", "si": "https://ptb.de/si"}
_SCHEMA = f"https://ptb.de/dcc https://ptb.de/dcc/v{VERSION}/dcc.xsd"
# Units as D-SI writes them.
_UNITS = {"m": r"\metre", "rad": r"\radian", "°C": r"\degreecelsius", "Pa": r"\pascal", "1": r"\one"}
_CONDITION_UNITS = {"air_pressure": "Pa", "relative_humidity": "1"}
# Coordinates of a value in a result's table, and the unit of each where the table does not say it.
_COORDINATES = {"position": "", "x": "m", "y": "m", "z": "m", "a": "rad", "b": "rad", "c": "rad"}
_NEEDED = (
    "laboratory.name", "laboratory.city", "laboratory.country", "customer.name", "customer.city", "number",
    "measured", "location", "machine.name", "machine.serial", "signatures",
)  # fmt: skip


def lacks_for_dcc(own: Certificate) -> list[str]:
    """Keys under which nothing is stated and without which the schema takes no DCC."""
    return unstated(own, _NEEDED)


def dcc_text(found: Evaluation, own: Certificate, words: Words) -> bytes:
    """The XML text; a CalibrationError that names what the schema needs and nobody has stated."""
    if lacking := lacks_for_dcc(own):
        raise CalibrationError(f"a DCC needs what is not stated: {', '.join(lacking)}")
    name, _, release = found.result.provenance.software.rpartition(" ")
    verdicts = found.conformity.each if found.conformity else ()
    text = rendered(
        "dcc.xml",
        str(__package__),
        own=own,
        words=words,
        version=VERSION,
        software_name=name,
        software_release=release,
        statements=statements(own, found),
        verdicts=[(one.name, named("decision", one.decision), _status(one)) for one in verdicts],
        method=named("method", found.measured.recorded[0].method.replace("_", " ")),
        declared=declared_conditions(own),
        recorded=list(_conditions(found.measured.recorded)),
        quantities=list(_quantities(tidy(found.result))),
        numbers=lambda values: " ".join(f"{float(value):.9g}" for value in values),
    )
    for prefix, space in SPACES.items():
        ElementTree.register_namespace(prefix, space)
    root = ElementTree.fromstring(text)
    _leave_out_empty(root)
    if root.find(".//dcc:result", SPACES) is None:
        raise CalibrationError("the readings determine no value that a DCC could state")
    root.set("{http://www.w3.org/2001/XMLSchema-instance}schemaLocation", _SCHEMA)
    ElementTree.indent(root)
    made: bytes = ElementTree.tostring(root, encoding="utf-8", xml_declaration=True)
    return made


def _leave_out_empty(node: ElementTree.Element) -> None:
    """What is not stated makes no element."""
    node.text = (node.text or "").strip()
    for part in list(node):
        _leave_out_empty(part)
        if not part.text and not len(part):
            node.remove(part)


def _conditions(sessions: Sequence[Session]) -> Iterator[tuple[str, str, list[tuple[str, float]]]]:
    """Name, unit and the known ends of the range of each condition that was recorded."""
    columns = [column for session in sessions for column in summarize(session).columns]
    for column in (one for one in columns if one.name.startswith(CONDITIONS)):
        ends = [(end, value) for end, value in (("from", column.low), ("to", column.high)) if value is not None]
        if ends:
            yield named("column", column.name), _UNITS[_CONDITION_UNITS.get(column.name, "°C")], ends


def _quantities(table: pd.DataFrame) -> Iterator[tuple[str, list[tuple[str, Any, str]], tuple[Any, str, Any]]]:
    """Every value that is determined, by itself or over the places that it depends on.

    Name; name, coordinates and unit of the places along each axis; values, their unit, and their U (95 %).
    """
    known = table[table["determined"].astype(bool)]
    apart = [name for name in ("error", "setup", "axis", "target", "approach", "point") if name in known]
    for key, rows in known.groupby(apart, sort=False, dropna=False):
        where = [name for name in _COORDINATES if name in rows and rows[name].notna().all()]
        units = [_UNITS[_COORDINATES[name] or rows["position_unit"].iloc[0]] for name in where]
        places = [(name, rows[name], unit) for name, unit in zip(where, units, strict=True)]
        title = " ".join(text for text in key if isinstance(text, str))
        yield title, places, (rows["value"], _UNITS[rows["unit"].iloc[0]], rows["U"])


def _status(one: Verdict) -> str:
    """What the schema has for a decision: between pass and fail, on which side of the tolerance the value lies.

    Empty where no probability could be told, or nothing be determined: a condition would claim one.
    """
    if one.decision != "undecided":
        return one.decision if one.decision in ("pass", "fail") else ""
    within = abs(one.value) <= one.tolerance
    return "" if np.isnan(one.probability) else "conditionalPass" if within else "conditionalFail"
