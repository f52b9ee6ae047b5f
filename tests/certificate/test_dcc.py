# SPDX-License-Identifier: Apache-2.0
"""The Digital Calibration Certificate has what its schema asks for, in its order, and the values of the result.

The schema itself is under the LGPL, for which this package does not hold it; where MTCAL_DCC_SCHEMA names its file
`dcc.xsd` (with those that it imports beside it), and lxml is installed, every document here is validated by it.
"""

import os
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

from machine_tool_calibration.certificate.dcc import SPACES, dcc_text, lacks_for_dcc
from machine_tool_calibration.certificate.particulars import Certificate
from machine_tool_calibration.errors import CalibrationError
from machine_tool_calibration.report.evaluation import Evaluation
from machine_tool_calibration.reports.result_tables import tidy
from machine_tool_calibration.words import words

from ..told import Verb
from .conftest import LABORATORY, ORDER, Made, complete, evaluated, stated

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


@pytest.mark.parametrize("key", ["number", "location", "measured", "signatures", "laboratory", "customer", "machine"])
def test_what_the_schema_needs_is_never_invented(key: str) -> None:
    own = stated().model_copy(update={key: getattr(Certificate(), key)})
    lacking = lacks_for_dcc(own)
    assert lacking and all(name.split(".")[0] == key for name in lacking)
    with pytest.raises(CalibrationError, match=f"a DCC needs what is not stated: {', '.join(lacking)}$"):
        dcc_text(complete(), own, words("en"))


def test_the_command_writes_it_and_says_what_is_missing(made: Made, tmp_path: Path, verb: Verb) -> None:
    file = tmp_path / "out" / "certificate.xml"
    told = verb("report", made.session, "--certificate", LABORATORY, "--certificate", ORDER, "-o", file)
    assert file.read_bytes()[:5] == b"<?xml" and told.err == f"wrote {file}\n"
    told = verb("report", made.session, "--certificate", ORDER, "-o", tmp_path / "draft.html")
    assert "draft: ISO/IEC 17025:2017 asks for what is not stated: 7.8.2.1 b (laboratory.name" in told.err
    refused = verb.refused("report", made.session, "--certificate", ORDER, "-o", file)
    assert "a DCC needs what is not stated: laboratory.name, laboratory.city" in refused
    assert "needs --certificate FILE" in verb.refused("report", made.session, "-o", file)
