# SPDX-License-Identifier: Apache-2.0
"""What a certificate states is what its files and the session say, nothing else, and what is missing is named."""

from dataclasses import replace
from datetime import date
from pathlib import Path

import pytest

from machine_tool_calibration.certificate.particulars import Certificate, Item, read_certificate
from machine_tool_calibration.certificate.points import missing
from machine_tool_calibration.session.session import Session

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
        ("{issued: 1 March}", "line 2: certificate.issued: "),
        ("{measured: [2026-03-01, soon]}", "certificate.measured[1]: "),
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
