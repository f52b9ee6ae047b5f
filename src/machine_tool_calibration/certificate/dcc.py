# SPDX-License-Identifier: Apache-2.0
"""The certificate for programs: a Digital Calibration Certificate (DCC 3.2.1 of PTB, quantities in D-SI 2.1.0)."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from xml.etree import ElementTree

import pandas as pd

from machine_tool_calibration.certificate.particulars import Certificate, Instrument, Party
from machine_tool_calibration.certificate.texts import recorded_conditions, stated_conditions, statements
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


def lacks_for_dcc(own: Certificate) -> list[str]:
    """Keys without which the schema takes no DCC."""
    needed = {
        "laboratory.name": own.laboratory.name,
        "laboratory.city": own.laboratory.city,
        "laboratory.country": own.laboratory.country,
        "customer.name": own.customer.name,
        "customer.city": own.customer.city,
        "number": own.number,
        "measured": own.measured,
        "location": own.location,
        "machine.name": own.machine.name,
        "machine.serial": own.machine.serial,
        "signatures": any(one.name for one in own.signatures),
    }
    return [key for key, value in needed.items() if not value]


def dcc_text(found: Evaluation, own: Certificate, words: Words) -> bytes:
    """The XML text; a CalibrationError that names what the schema needs and nobody has stated."""
    if lacking := lacks_for_dcc(own):
        raise CalibrationError(f"a DCC needs what is not stated: {', '.join(lacking)}")
    for prefix, space in SPACES.items():
        ElementTree.register_namespace(prefix, space)
    root = _Writer(found, own, words).certificate()
    root.set(f"{_INSTANCE}schemaLocation", _SCHEMA)
    ElementTree.indent(root)
    made: bytes = ElementTree.tostring(root, encoding="utf-8", xml_declaration=True)
    return made


def _node(name: str, *content: Element | str | None, **attributes: str) -> Element:
    """An element `prefix:name` with children and text; of `dcc` where there is no prefix."""
    prefix, _, local = name.rpartition(":")
    node = Element(f"{{{SPACES[prefix or 'dcc']}}}{local}", attributes)
    for part in content:
        if isinstance(part, str):
            node.text = printable(part).strip()
        elif part is not None:
            node.append(part)
    return node


def _optional(name: str, text: str) -> Element | None:
    return _node(name, text) if text.strip() else None


class _Writer:
    """The parts of a certificate in one language."""

    def __init__(self, found: Evaluation, own: Certificate, words: Words) -> None:
        self.found, self.own, self.words = found, own, words

    def certificate(self) -> Element:
        return _node(
            "digitalCalibrationCertificate", self.administration(),
            _node("measurementResults", self.result()), schemaVersion=VERSION,
        )  # fmt: skip

    def text(self, name: str, text: str) -> Element:
        return _node(name, _node("content", self.words.told(text), lang=self.words.language))

    def administration(self) -> Element:
        own = self.own
        signed = [one for one in own.signatures if one.name]
        persons = [
            _node("respPerson", _node("person", self.text("name", one.name)), _optional("role", one.role),
                  _node("mainSigner", "false" if k else "true"))
            for k, one in enumerate(signed)
        ]  # fmt: skip
        return _node(
            "administrativeData",
            _node("dccSoftware", self.software()),
            self.core(),
            _node("items", self.item()),
            _node("calibrationLaboratory", _optional("calibrationLaboratoryCode", own.laboratory.code),
                  self.party("contact", own.laboratory)),
            _node("respPersons", *persons),
            self.party("customer", own.customer),
            _node("statements", *self.statements()),
        )  # fmt: skip

    def software(self) -> Element:
        name, _, release = self.found.result.provenance.software.rpartition(" ")
        return _node("software", self.text("name", name), _node("release", release), _node("type", "application"))

    def core(self) -> Element:
        own = self.own
        days = {
            "receiptDate": own.received,
            "beginPerformanceDate": own.measured[0],
            "endPerformanceDate": own.measured[-1],
        }
        return _node(
            "coreData",
            _node("countryCodeISO3166_1", own.laboratory.country),
            _node("usedLangCodeISO639_1", self.words.language),
            _node("mandatoryLangCodeISO639_1", self.words.language),
            _node("uniqueIdentifier", own.number),
            _node("identifications", self.identification("customer", own.order, "order")) if own.order else None,
            *(_node(name, day.isoformat()) for name, day in days.items() if day),
            _node("performanceLocation", own.location),
            _node("issueDate", own.issued.isoformat()) if own.issued else None,
        )

    def item(self) -> Element:
        one = self.own.machine
        stated = (("manufacturer", one.serial, "serial"), ("owner", one.inventory, "inventory"))
        known = [self.identification(issuer, value, key) for issuer, value, key in stated if value]
        return _node(
            "item", self.text("name", one.name), self.text("description", one.condition) if one.condition else None,
            self.maker(one.manufacturer), _optional("model", one.model), _node("identifications", *known),
        )  # fmt: skip

    def maker(self, name: str) -> Element | None:
        return _node("manufacturer", self.text("name", name)) if name else None

    def identification(self, issuer: str, value: str, key: str) -> Element:
        name = self.text("name", self.words(f"certificate.{key}"))
        return _node("identification", _node("issuer", issuer), _node("value", value), name)

    def party(self, name: str, party: Party) -> Element:
        places = (("street", party.street), ("postCode", party.post_code), ("city", party.city))
        where = [*(_optional(key, text) for key, text in places), _optional("countryCode", party.country)]
        return _node(
            name, self.text("name", party.name), _optional("eMail", party.email), _optional("phone", party.phone),
            _node("location", *where),
        )  # fmt: skip

    def statements(self) -> Iterator[Element]:
        for text in statements(self.own, self.found):
            if text:
                yield _node("statement", self.text("declaration", text))
        for one in self.found.conformity.each if self.found.conformity else ():
            decided = _node("conformity", one.decision) if one.decision in ("pass", "fail") else None
            told = self.text("declaration", named("decision", one.decision))
            yield _node("statement", self.text("name", one.name), told, decided)

    def result(self) -> Element:
        own, (session, *_) = self.own, self.found.measured.recorded
        methods = [_node("usedMethod", self.text("name", text)) for text in own.procedure if text]
        conditions = list(self.conditions())
        instruments = [self.instrument(one) for one in own.instruments if one.name]
        return _node(
            "measurementResult",
            self.text("name", named("method", session.method.replace("_", " "))),
            _node("usedMethods", *methods) if methods else None,
            _node("usedSoftware", self.software()),
            _node("measuringEquipments", *instruments) if instruments else None,
            _node("influenceConditions", *conditions) if conditions else None,
            _node("results", *self.quantities(tidy(self.found.result))),
        )

    def instrument(self, one: Instrument) -> Element:
        stated = (("manufacturer", one.serial, "serial"), ("calibrationLaboratory", one.certificate, "certificate"))
        known = [self.identification(issuer, value, key) for issuer, value, key in stated if value]
        return _node(
            "measuringEquipment", self.text("name", one.name), self.maker(one.manufacturer),
            _optional("model", one.model), _node("identifications", *known) if known else None,
        )  # fmt: skip

    def conditions(self) -> Iterator[Element]:
        for name, text in stated_conditions(self.own):
            yield _node("influenceCondition", self.text("name", name), _node("data", self.text("text", text)))
        for session in self.found.measured.recorded:
            for column in recorded_conditions(session):
                unit = _UNITS[_CONDITION_UNITS.get(column.name, "°C")]
                ends = [
                    _node("quantity", self.text("name", self.words(f"head.{end}")), _real([value], unit))
                    for end, value in (("from", column.low), ("to", column.high)) if value is not None
                ]  # fmt: skip
                if ends:
                    called = self.text("name", named("column", column.name))
                    yield _node("influenceCondition", called, _node("data", *ends))

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


def _real(values: Sequence[float] | pd.Series[float], unit: str, expanded: pd.Series[float] | None = None) -> Element:
    """One number in D-SI, or several in one list, with expanded uncertainties if there are any."""
    many = "XMLList" if len(values) > 1 else ""
    unc = None
    if expanded is not None:
        unc = _node(
            f"si:expandedUnc{many}", _node(f"si:uncertainty{many}", _numbers(expanded)),
            _node(f"si:coverageFactor{many}", _COVERAGE_FACTOR), _node(f"si:coverageProbability{many}", _COVERAGE),
        )  # fmt: skip
    kind = "si:realListXMLList" if many else "si:real"
    return _node(kind, _node(f"si:value{many}", _numbers(values)), _node(f"si:unit{many}", unit), unc)


def _numbers(values: Sequence[float] | pd.Series[float]) -> str:
    return " ".join(f"{float(value):.9g}" for value in values)
