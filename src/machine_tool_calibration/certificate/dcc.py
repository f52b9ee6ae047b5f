# SPDX-License-Identifier: Apache-2.0
"""The certificate for programs: a Digital Calibration Certificate (DCC 3.2.1 of PTB, quantities in D-SI 2.1.0)."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from xml.etree import ElementTree

import numpy as np
import pandas as pd

from machine_tool_calibration.budget.conformity import Verdict
from machine_tool_calibration.certificate.particulars import Certificate, Item, Party
from machine_tool_calibration.certificate.texts import declared_conditions, recorded_conditions, statements, unstated
from machine_tool_calibration.errors import CalibrationError
from machine_tool_calibration.report.evaluation import Evaluation
from machine_tool_calibration.report.page import printable
from machine_tool_calibration.reports.result_tables import tidy
from machine_tool_calibration.words import Words, named

Element = ElementTree.Element

VERSION = "3.2.1"
SPACES = {"dcc": "https://ptb.de/dcc", "si": "https://ptb.de/si"}
_SCHEMA = f"https://ptb.de/dcc https://ptb.de/dcc/v{VERSION}/dcc.xsd"
_INSTANCE = "{http://www.w3.org/2001/XMLSchema-instance}"
# Units as D-SI writes them.
_UNITS = {"m": r"\metre", "rad": r"\radian", "°C": r"\degreecelsius", "Pa": r"\pascal", "1": r"\one"}
_CONDITION_UNITS = {"air_pressure": "Pa", "relative_humidity": "1"}
# Coordinates of a value in a result's table, and the unit of each where the table does not say it.
_COORDINATES = {"position": "", "x": "m", "y": "m", "z": "m", "a": "rad", "b": "rad", "c": "rad"}
_COVERAGE_FACTOR, _COVERAGE = "2", "0.95"
_NEEDED = (
    "laboratory.name",
    "laboratory.city",
    "laboratory.country",
    "customer.name",
    "customer.city",
    "number",
    "measured",
    "location",
    "machine.name",
    "machine.serial",
    "signatures",
)


def lacks_for_dcc(own: Certificate) -> list[str]:
    """Keys under which nothing is stated and without which the schema takes no DCC."""
    return unstated(own, _NEEDED)


def dcc_text(found: Evaluation, own: Certificate, words: Words) -> bytes:
    """The XML text; a CalibrationError that names what the schema needs and nobody has stated."""
    if lacking := lacks_for_dcc(own):
        raise CalibrationError(f"a DCC needs what is not stated: {', '.join(lacking)}")
    for prefix, space in SPACES.items():
        ElementTree.register_namespace(prefix, space)
    root = _Writer(found, own, words).certificate()
    if root.find(".//dcc:result", SPACES) is None:
        raise CalibrationError("the readings determine no value that a DCC could state")
    root.set(f"{_INSTANCE}schemaLocation", _SCHEMA)
    ElementTree.indent(root)
    made: bytes = ElementTree.tostring(root, encoding="utf-8", xml_declaration=True)
    return made


def _node(name: str, *content: Element | str, **attributes: str) -> Element:
    """An element `prefix:name`, of `dcc` without a prefix, with text or with those children that hold anything."""
    prefix, _, local = name.rpartition(":")
    node = Element(f"{{{SPACES[prefix or 'dcc']}}}{local}", attributes)
    for part in content:
        if isinstance(part, str):
            node.text = printable(part).strip()
        elif part.text or len(part):
            node.append(part)
    return node


class _Writer:
    """The parts of a certificate in one language; what is not stated makes no element."""

    def __init__(self, found: Evaluation, own: Certificate, words: Words) -> None:
        self.found, self.own, self.words = found, own, words
        name, _, release = found.result.provenance.software.rpartition(" ")
        self.software = _node(
            "software", self.text("name", name), _node("release", release), _node("type", "application")
        )

    def certificate(self) -> Element:
        parts = self.administration(), _node("measurementResults", self.result())
        return _node("digitalCalibrationCertificate", *parts, schemaVersion=VERSION)

    def text(self, name: str, text: str) -> Element:
        return _node(name, _node("content", self.words.told(text), lang=self.words.language))

    def administration(self) -> Element:
        own, text = self.own, self.text
        persons = [
            _node("respPerson", _node("person", text("name", one.name)), _node("role", one.role),
                  _node("mainSigner", "false" if k else "true"))
            for k, one in enumerate(own.signatures)
        ]  # fmt: skip
        code = _node("calibrationLaboratoryCode", own.laboratory.code)
        return _node(
            "administrativeData",
            _node("dccSoftware", self.software),
            self.core(),
            _node("items", _node("item", *self.described(own.machine, owner=("inventory", own.machine.inventory)))),
            _node("calibrationLaboratory", code, self.party("contact", own.laboratory)),
            _node("respPersons", *persons),
            self.party("customer", own.customer),
            _node("statements", *self.statements()),
        )

    def core(self) -> Element:
        own, language = self.own, self.words.language
        return _node(
            "coreData",
            _node("countryCodeISO3166_1", own.laboratory.country),
            _node("usedLangCodeISO639_1", language),
            _node("mandatoryLangCodeISO639_1", language),
            _node("uniqueIdentifier", own.number),
            _node("identifications", *self.identifications(customer=("order", own.order))),
            _node("receiptDate", str(own.received or "")),
            _node("beginPerformanceDate", str(own.measured[0])),
            _node("endPerformanceDate", str(own.measured[-1])),
            _node("performanceLocation", own.location),
            _node("issueDate", str(own.issued or "")),
        )

    def described(self, one: Item, **more: tuple[str, str]) -> Iterator[Element]:
        """What a machine and an instrument have in common; `more` are numbers by who gave them."""
        yield self.text("name", one.name)
        yield self.text("description", getattr(one, "condition", ""))
        yield _node("manufacturer", self.text("name", one.manufacturer))
        yield _node("model", one.model)
        yield _node("identifications", *self.identifications(manufacturer=("serial", one.serial), **more))

    def identifications(self, **numbers: tuple[str, str]) -> Iterator[Element]:
        """Numbers, each with what it is, by who gave them."""
        for issuer, (key, value) in numbers.items():
            if value:
                name = self.text("name", self.words(f"certificate.{key}"))
                yield _node("identification", _node("issuer", issuer), _node("value", value), name)

    def party(self, name: str, one: Party) -> Element:
        where = {"street": one.street, "postCode": one.post_code, "city": one.city, "countryCode": one.country}
        location = _node("location", *(_node(key, text) for key, text in where.items()))
        return _node(name, self.text("name", one.name), _node("eMail", one.email), _node("phone", one.phone), location)

    def statements(self) -> Iterator[Element]:
        for text in statements(self.own, self.found):
            yield _node("statement", self.text("declaration", text))
        for one in self.found.conformity.each if self.found.conformity else ():
            told = self.text("declaration", named("decision", one.decision))
            decided = _node("conformity", _status(one))
            yield _node("statement", self.text("name", one.name), told, decided)

    def result(self) -> Element:
        own, method = self.own, self.found.measured.recorded[0].method.replace("_", " ")
        instruments = [
            _node("measuringEquipment", *self.described(one, calibrationLaboratory=("certificate", one.certificate)))
            for one in own.instruments if one.name
        ]  # fmt: skip
        return _node(
            "measurementResult",
            self.text("name", named("method", method)),
            _node("usedMethods", *(_node("usedMethod", self.text("name", text)) for text in own.procedure)),
            _node("usedSoftware", self.software),
            _node("measuringEquipments", *instruments),
            _node("influenceConditions", *self.conditions()),
            _node("results", *self.quantities(tidy(self.found.result))),
        )

    def conditions(self) -> Iterator[Element]:
        for name, text in declared_conditions(self.own):
            yield _node("influenceCondition", self.text("name", name), _node("data", self.text("text", text)))
        for column in (one for session in self.found.measured.recorded for one in recorded_conditions(session)):
            unit = _UNITS[_CONDITION_UNITS.get(column.name, "°C")]
            ends = [
                _node("quantity", self.text("name", self.words(f"head.{end}")), _real([value], unit))
                for end, value in (("from", column.low), ("to", column.high)) if value is not None
            ]  # fmt: skip
            if ends:
                yield _node("influenceCondition", self.text("name", named("column", column.name)), _node("data", *ends))

    def quantities(self, table: pd.DataFrame) -> Iterator[Element]:
        """Every value that is determined: a quantity by itself, or a list over the places that it depends on."""
        known = table[table["determined"].astype(bool)]
        apart = [name for name in ("error", "setup", "axis", "target", "approach", "point") if name in known]
        for key, rows in known.groupby(apart, sort=False, dropna=False):
            title = " ".join(text for text in key if isinstance(text, str))
            where = [name for name in _COORDINATES if name in rows and rows[name].notna().all()]
            yield _node("result", self.text("name", title), _node("data", self.measured(rows, where)))

    def measured(self, rows: pd.DataFrame, where: Sequence[str]) -> Element:
        values = _real(rows["value"], _UNITS[rows["unit"].iloc[0]], rows["U"])
        if not where:
            return _node("quantity", values)
        units = [_UNITS[_COORDINATES[name] or rows["position_unit"].iloc[0]] for name in where]
        places = [
            _node("quantity", self.text("name", name), _real(rows[name], unit), refType="basic_nominalValue")
            for name, unit in zip(where, units, strict=True)
        ]
        return _node("list", *places, _node("quantity", values, refType="basic_measurementError"))


def _status(one: Verdict) -> str:
    """What the schema has for a decision: between pass and fail, on which side of the tolerance the value lies.

    Empty where no probability could be told, or nothing be determined: a condition would claim one.
    """
    if one.decision != "undecided":
        return one.decision if one.decision in ("pass", "fail") else ""
    within = abs(one.value) <= one.tolerance
    return "" if np.isnan(one.probability) else "conditionalPass" if within else "conditionalFail"


def _real(
    values: Sequence[float] | pd.Series[float], unit: str, expanded: Sequence[float] | pd.Series[float] = ()
) -> Element:
    """One number in D-SI, or several in one list, with expanded uncertainties if there are any."""
    many = "XMLList" if len(values) > 1 else ""
    numbers, sizes = (" ".join(f"{float(value):.9g}" for value in some) for some in (values, expanded))
    parts = {"uncertainty": sizes, "coverageFactor": _COVERAGE_FACTOR, "coverageProbability": _COVERAGE}
    u = _node(f"si:expandedUnc{many}", *(_node(f"si:{key}{many}", text) for key, text in parts.items() if sizes))
    kind = "si:realListXMLList" if many else "si:real"
    return _node(kind, _node(f"si:value{many}", numbers), _node(f"si:unit{many}", unit), u)
