# SPDX-License-Identifier: Apache-2.0
"""What a certificate states is what its files and the session say, nothing else, and what is missing is named.
The Digital Calibration Certificate has what its schema asks for, in its order, and the values of the result.
"""

import os
from dataclasses import replace
from datetime import date
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

from machine_tool_calibration.certificate.dcc import SPACES, dcc_text, lacks_for_dcc
from machine_tool_calibration.certificate.particulars import Certificate, Item, read_certificate
from machine_tool_calibration.certificate.texts import missing
from machine_tool_calibration.errors import CalibrationError, SessionError
from machine_tool_calibration.report.evaluation import Evaluation
from machine_tool_calibration.reports.result_tables import tidy
from machine_tool_calibration.session.session import Session
from machine_tool_calibration.words import words

from ..told import Verb
from .conftest import LABORATORY, ORDER, Made, complete, evaluated, session_of, stated

# What each point of ISO/IEC 17025:2017 asks for, by the key that states it.
POINTS = {
    "laboratory": "7.8.2.1 b (laboratory.name, laboratory.city)",
    "place": "7.8.2.1 c (place)",
    "number": "7.8.2.1 d (number)",
    "customer": "7.8.2.1 e (customer.name, customer.city)",
    "procedure": "7.8.2.1 f (procedure)",
    "machine": "7.8.2.1 g (machine.name, machine.serial)",
    "measured": "7.8.2.1 i (measured)",
    "issued": "7.8.2.1 j (issued)",
    "signatures": "7.8.2.1 o (signatures)",
    "conditions": "7.8.4.1 b (conditions.reference_temperature, conditions.compensation)",
    "traceability": "7.8.4.1 c (traceability)",
    "instruments": "7.8.4.1 c (instruments)",
    "decision_rule": "7.8.6.1 (decision_rule.agreed)",
    "specification": "7.8.6.2 b (specification)",
}
ABOUT = {
    "machine": {"name": "VMC", "serial_number": "007", "colour": "green"},
    "date": "2026-03-01 morning",
    "customer": "Beispiel AG",
    "place": "Hall 3",
    "order": ["K-118"],
    "instruments": [{"name": "laser", "serial": "4711", "certificate": "K-1"}, "thermometer", ["x"]],
}


def described(about: dict) -> Session:
    session = session_of("iso230_2")
    return replace(session, description=session.description.model_copy(update={"about": about}))


def test_nothing_is_missing_in_the_example() -> None:
    assert missing(stated(), complete()) == ""


@pytest.mark.parametrize("key", POINTS)
def test_what_is_left_out_is_named_with_its_point(key: str) -> None:
    assert missing(stated().model_copy(update={key: getattr(Certificate(), key)}), complete()) == POINTS[key]


def test_an_instrument_without_certificate_and_results_without_budget_and_temperatures_are_named() -> None:
    own = stated()
    unknown = own.instruments[1].model_copy(update={"certificate": ""})
    told = missing(own.model_copy(update={"instruments": (own.instruments[0], unknown)}), complete())
    assert told == "7.8.4.1 c (instruments[1].certificate)"
    found = evaluated("tracking_2d")
    (session,) = found.measured.recorded
    columns = {name: v for name, v in session.readings.columns.items() if not name.startswith("temperature")}
    cold = replace(session, readings=replace(session.readings, columns=columns))
    bare = replace(found, measured=replace(found.measured, recorded=(cold,)))
    assert missing(own, bare) == "7.8.4.1 a (--budget); 7.8.4.1 b (conditions.temperature)"


def test_what_the_session_says_needs_not_be_stated_again() -> None:
    own = read_certificate([], [described(ABOUT)])
    assert own.machine == own.machine.model_copy(update={"name": "VMC", "serial": "007"})
    assert own.measured == (date(2026, 3, 1),)
    assert (own.customer.name, own.place, own.order) == ("Beispiel AG", "Hall 3", "")
    assert [(one.name, one.certificate) for one in own.instruments] == [("laser", "K-1"), ("thermometer", "")]
    assert read_certificate([], [described({"machine": ["x"], "date": "yesterday"})]) == Certificate()


def test_a_file_counts_before_the_session_and_a_later_before_an_earlier(tmp_path: Path) -> None:
    later = tmp_path / "later.yaml"
    later.write_text("format: mtcal-certificate/1\ncertificate: {machine: {serial: 1e5}, issued: , place: 3.10}\n")
    own = read_certificate([LABORATORY, ORDER, later], [described(ABOUT)])
    assert own.machine.model_dump() == {**stated().machine.model_dump(), "serial": "1e5"}
    assert (own.issued, own.place, own.number) == (None, "3.10", "MM-2026-0117")
    text = "{measured: [2026-03-02, 2026-03-01], signatures: [{name: , role: x}], procedure: [''], issued: 2026-03-05}"
    later.write_text(f"format: mtcal-certificate/1\ncertificate: {text}\n")
    own = read_certificate([later], [])
    assert own.measured == (date(2026, 3, 1), date(2026, 3, 2)) and own.issued == date(2026, 3, 5)
    assert (own.signatures, own.procedure) == ((), ())
    assert Item(name="VMC", model="850").title == "VMC, 850" and Item(model="850").title == "850"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("{numbre: 1}", "unknown key 'certificate.numbre' (did you mean 'number'?)"),
        ("{issued: 1 March}", "line 2: certificate.issued must be a date, such as 2026-05-04, not '1 March'"),
        ("{measured: [2026-03-01, soon]}", "certificate.measured[1] must be a date, such as 2026-05-04, not 'soon'"),
        ("{customer: {country: Germany}}", "certificate.customer.country: "),
        ("{location: moon}", "certificate.location is 'moon'"),
        ("{decision_rule: {rule: garded}}", "no decision rule 'garded' (did you mean 'guarded'?)"),
        ("{decision_rule: {probability: 2}}", "must be less than 1"),
        ("{signatures: Dr. Muster}", "certificate.signatures must be a list"),
        ("text", "certificate must be a mapping"),
    ],
)
def test_a_mistake_is_said_with_file_line_and_key(
    text: str, message: str, made: Made, tmp_path: Path, verb: Verb
) -> None:
    file = tmp_path / "mine.yaml"
    file.write_text(f"format: mtcal-certificate/1\ncertificate: {text}\n")
    told = verb.refused("report", made.session, "--certificate", file)
    assert told.startswith(f"mtcal: {file} line 2: ") and message in told


def test_it_is_not_issued_before_the_measurement(tmp_path: Path) -> None:
    file = tmp_path / "mine.yaml"
    file.write_text(
        "format: mtcal-certificate/1\ncertificate: {measured: [2026-03-01, 2026-03-04], issued: 2026-03-02}\n"
    )
    with pytest.raises(SessionError, match="issued on 2026-03-02, before it was measured on 2026-03-04"):
        read_certificate([file], [])


# Children that the schema 3.2.1 asks for, in its order.
REQUIRED = {
    ".": ["administrativeData", "measurementResults"],
    "administrativeData": ["dccSoftware", "coreData", "items", "calibrationLaboratory", "respPersons", "customer"],
    "administrativeData/dccSoftware/software": ["name", "release"],
    "administrativeData/coreData": [
        "countryCodeISO3166_1", "usedLangCodeISO639_1", "mandatoryLangCodeISO639_1", "uniqueIdentifier",
        "beginPerformanceDate", "endPerformanceDate", "performanceLocation",
    ],
    "administrativeData/items/item": ["name", "identifications"],
    "administrativeData/items/item/identifications/identification": ["issuer", "value"],
    "administrativeData/calibrationLaboratory": ["contact"],
    "administrativeData/calibrationLaboratory/contact": ["name", "location"],
    "administrativeData/respPersons/respPerson": ["person"],
    "administrativeData/customer": ["name", "location"],
    "measurementResults/measurementResult": ["name", "results"],
    "measurementResults/measurementResult/results/result": ["name", "data"],
    "measurementResults/measurementResult/influenceConditions/influenceCondition": ["name", "data"],
}  # fmt: skip
KINDS = {
    "iso230_2": complete,
    "tracking_2d": lambda: evaluated("tracking_2d"),
    "ball_bar": lambda: evaluated("ball_bar"),
}


def local(element: ElementTree.Element) -> str:
    return element.tag.partition("}")[2]


def document(found: Evaluation, own: Certificate | None = None, language: str = "en") -> ElementTree.Element:
    """A DCC that its schema takes, as far as it is there to say so."""
    text = dcc_text(found, own or stated(), words(language))
    if schema := os.environ.get("MTCAL_DCC_SCHEMA"):
        etree = pytest.importorskip("lxml.etree")
        etree.XMLSchema(etree.parse(schema)).assertValid(etree.fromstring(text))
    return ElementTree.fromstring(text)


def numbers(element: ElementTree.Element, name: str) -> list[float]:
    return [float(text) for one in element.iter(f"{{{SPACES['si']}}}{name}") for text in (one.text or "").split()]


@pytest.mark.parametrize("kind", KINDS)
def test_it_has_what_the_schema_asks_for(kind: str) -> None:
    root = document(KINDS[kind]())
    assert root.get("schemaVersion") == "3.2.1"
    for path, needed in REQUIRED.items():
        where = "/".join(part if part == "." else f"dcc:{part}" for part in path.split("/"))
        found = root.findall(where, SPACES)
        assert found, path
        for one in found:
            names = [local(child) for child in one]
            assert [name for name in names if name in needed] == needed * (names.count(needed[0]) or 1), path
    assert [one.tag for one in root.iter() if not len(one) and not (one.text or "").strip()] == []


@pytest.mark.parametrize("kind", KINDS)
def test_its_values_are_those_of_the_result(kind: str) -> None:
    found = KINDS[kind]()
    table = tidy(found.result)
    known = table[table["determined"].astype(bool)]
    results = document(found).find("dcc:measurementResults/dcc:measurementResult/dcc:results", SPACES)
    assert results is not None
    measured = [
        quantity for quantity in results.iter(f"{{{SPACES['dcc']}}}quantity")
        if quantity.get("refType") != "basic_nominalValue"
    ]  # fmt: skip
    values = [v for one in measured for v in (*numbers(one, "value"), *numbers(one, "valueXMLList"))]
    expanded = [v for one in measured for v in (*numbers(one, "uncertainty"), *numbers(one, "uncertaintyXMLList"))]
    assert len(values) == len(known)
    np.testing.assert_allclose(np.sort(values), np.sort(known["value"]), rtol=1e-8, atol=1e-20)
    np.testing.assert_allclose(np.sort(expanded), np.sort(known["U"]), rtol=1e-8, atol=1e-20)
    assert {one.text for one in results.iter(f"{{{SPACES['si']}}}coverageFactor")} <= {"2"}


def test_who_what_where_and_the_verdict_stand_in_it() -> None:
    root = document(complete(), language="de")
    told = [one.text for one in root.iter(f"{{{SPACES['dcc']}}}content")]
    for text in ("Muster Messtechnik GmbH", "Beispiel Maschinenbau AG", "machining centre", "ISO 230-2:2014", "20 °C",
                 "weather station", "Seriennummer", "Lufttemperatur"):  # fmt: skip
        assert text in told
    assert [one.text for one in root.iter(f"{{{SPACES['dcc']}}}conformity")] == ["pass"]
    assert {one.get("lang") for one in root.iter(f"{{{SPACES['dcc']}}}content")} == {"de"}
    assert root.findtext(".//dcc:beginPerformanceDate", None, SPACES) == "2026-03-01"


@pytest.mark.parametrize(
    ("tolerance", "decision", "probability", "status"),
    [
        (25e-6, "fail", 0.0, ["fail"]),
        (25e-6, "undecided", 0.7, ["conditionalPass"]),
        (1e-6, "undecided", 0.2, ["conditionalFail"]),
        (25e-6, "undecided", np.nan, []),
    ],
)
def test_an_open_verdict_has_the_status_of_its_side_of_the_tolerance(
    tolerance: float, decision: str, probability: float, status: list[str]
) -> None:
    found = complete()
    assert found.conformity is not None
    one = replace(found.conformity.each[0], tolerance=tolerance, decision=decision, probability=probability)
    root = document(replace(found, conformity=replace(found.conformity, each=(one,))))
    assert [one.text for one in root.iter(f"{{{SPACES['dcc']}}}conformity")] == status


@pytest.mark.parametrize("key", ["number", "location", "measured", "signatures", "laboratory", "customer", "machine"])
def test_what_the_schema_needs_is_never_invented(key: str) -> None:
    own = stated().model_copy(update={key: getattr(Certificate(), key)})
    lacking = lacks_for_dcc(own)
    assert lacking and all(name.split(".")[0] == key for name in lacking)
    with pytest.raises(CalibrationError, match=f"a DCC needs what is not stated: {', '.join(lacking)}$"):
        dcc_text(complete(), own, words("en"))


@pytest.mark.long
def test_the_command_writes_it_and_says_what_is_missing(made: Made, tmp_path: Path, verb: Verb) -> None:
    file = tmp_path / "out" / "certificate.xml"
    told = verb("report", made.session, "--certificate", LABORATORY, "--certificate", ORDER, "-o", file)
    assert file.read_bytes()[:5] == b"<?xml" and told.err == f"wrote {file}\n"
    told = verb("report", made.session, "--certificate", ORDER, "-o", tmp_path / "draft.html")
    assert "draft: ISO/IEC 17025:2017 asks for what is not stated: 7.8.2.1 b (laboratory.name" in told.err
    refused = verb.refused("report", made.session, "--certificate", ORDER, "-o", file)
    assert "a DCC needs what is not stated: laboratory.name, laboratory.city" in refused
    assert "needs --certificate FILE" in verb.refused("report", made.session, "-o", file)
