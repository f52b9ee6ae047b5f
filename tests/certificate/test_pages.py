# SPDX-License-Identifier: Apache-2.0
"""The certificate is whole, says what it lacks, and is PDF/A-3 that a program reads as well."""

import hashlib
import io
import json
import re
from pathlib import Path
from xml.etree import ElementTree

import html5lib
import pypdf
import pytest
from pypdf.generic import DictionaryObject

from machine_tool_calibration.certificate.pages import write_certificate
from machine_tool_calibration.certificate.particulars import Certificate, Signature
from machine_tool_calibration.errors import CalibrationError
from machine_tool_calibration.words import words

from ..told import Verb
from .conftest import Made, complete, evaluated, stated

HOSTILE = "A & B </style><script>alert(1)</script> {{ 7 * 7 }} ]]> \x1b[31m\uffff \" content: 'x'"


@pytest.fixture(scope="module")
def paper(made: Made) -> pypdf.PdfReader:
    return pypdf.PdfReader(io.BytesIO(made["pdf"].read_bytes()))


def text_of(page: pypdf.PageObject) -> str:
    return " ".join(page.extract_text().split())


def written(own: Certificate, folder: Path, language: str = "en") -> str:
    file = folder / "certificate.html"
    write_certificate(complete(), own, words(language), [file])
    return file.read_text(encoding="utf-8")


def test_every_page_says_which_it_is_and_of_which_certificate(paper: pypdf.PdfReader) -> None:
    pages = [text_of(page) for page in paper.pages]
    assert len(pages) >= 4
    for k, text in enumerate(pages, start=1):
        assert f"page {k} of {len(pages)}" in text and "Number MM-2026-0117" in text
    assert "End of certificate MM-2026-0117" in pages[-1]
    assert not any("End of certificate" in text for text in pages[:-1])


def test_the_statements_stand_above_the_signatures_and_all_that_was_stated_somewhere(paper: pypdf.PdfReader) -> None:
    first, whole = text_of(paper.pages[0]), " ".join(map(text_of, paper.pages))
    statements = ("accredited to ISO/IEC 17025:2017 · D-K-00000-01-00", "All together: pass.", "AP-850", "2026-01-10",
                  "each, else undecided (ISO 14253-1)", "iodine-stabilised", "coverage probability of about 95 %",
                  "relate only to the item named above", "reproduced only in full", "Dr. E. Muster")  # fmt: skip
    assert [text for text in statements if text not in first] == []
    assert "raft" not in first
    stated_elsewhere = ("ISO 230-2:2014", "AA-17", "none", "20 °C", "table of 2024-05-02", "K-2025-113", "T-77", "0815",
                        "temperature of the air", "Fabrikweg 7", "007123", "2026-03-01 – 2026-03-02")  # fmt: skip
    assert [text for text in stated_elsewhere if text not in whole] == []
    assert complete().result.provenance.sha256 in whole.replace(" ", "")


@pytest.mark.long
def test_a_program_reads_the_result_and_the_data_from_the_paper(paper: pypdf.PdfReader, made: Made, verb: Verb) -> None:
    held = {name: content for name, (content,) in paper.attachments.items()}
    assert json.loads(held["result.json"]) == verb("identify", made.session, "--json").document
    data = hashlib.sha256(held["session.yaml"] + held["observations.csv"]).hexdigest()
    assert data == complete().result.provenance.sha256
    assert held["observations.csv"] == (made.session / "observations.csv").read_bytes()
    assert ElementTree.fromstring(held["dcc.xml"]).tag.endswith("digitalCalibrationCertificate")


def test_the_paper_keeps_the_rules_of_pdf_a_3(paper: pypdf.PdfReader) -> None:
    """What of ISO 19005-3 can be seen without its validator: no page needs anything that is not in the file."""
    root = paper.trailer["/Root"]
    metadata = root["/Metadata"].get_data().decode()
    assert re.search(r'pdfaid:part="3"', metadata) and re.search(r'pdfaid:conformance="U"', metadata)
    (intent,) = root["/OutputIntents"]
    assert intent.get_object()["/S"] == "/GTS_PDFA1" and "/DestOutputProfile" in intent.get_object()
    assert "/ID" in paper.trailer and not paper.is_encrypted
    assert not {"/JavaScript", "/AA", "/OpenAction", "/AcroForm"} & {*root, *root.get("/Names", {})}
    files = [one.get_object() for one in root["/AF"]]
    assert {one["/UF"]: one["/AFRelationship"] for one in files} == {
        "result.json": "/Data", "dcc.xml": "/Alternative", "session.yaml": "/Source", "observations.csv": "/Source",
    }  # fmt: skip
    assert all("/Subtype" in one["/EF"]["/F"] for one in files)
    fonts = images = 0
    for page in paper.pages:
        resources = page["/Resources"]
        for font in resources["/Font"].values():
            (inner,) = font["/DescendantFonts"]
            descriptor = inner.get_object()["/FontDescriptor"]
            assert "/ToUnicode" in font and {"/FontFile2", "/FontFile3"} & {*descriptor}
            fonts += 1
        for drawn in (one.get_object() for one in resources.get("/XObject", DictionaryObject()).values()):
            if drawn["/Subtype"] == "/Image":
                assert drawn.get("/Interpolate") in (None, False) and drawn["/Filter"] != "/LZWDecode"
                images += 1
    assert fonts > 3 and images >= 2


@pytest.mark.long
def test_what_people_wrote_cannot_become_part_of_a_page_or_of_xml(tmp_path: Path) -> None:
    own = stated()
    own = own.model_copy(
        update={
            "number": HOSTILE,
            "place": HOSTILE,
            "procedure": (HOSTILE,),
            "machine": own.machine.model_copy(update={"name": HOSTILE}),
            "customer": own.customer.model_copy(update={"name": HOSTILE}),
            "signatures": (Signature(name=HOSTILE),),
        }
    )
    write_certificate(complete(), own, words("en"), [tmp_path / "c.html", tmp_path / "c.pdf", tmp_path / "c.xml"])
    page = (tmp_path / "c.html").read_text(encoding="utf-8")
    assert "<script>alert" not in page and "&lt;/style&gt;&lt;script&gt;alert(1)" in page and "{{ 7 * 7 }}" in page
    html5lib.HTMLParser(strict=True).parse(re.sub(r"[A-Za-z0-9+/]{200,}=*", "", page))
    paper = pypdf.PdfReader(tmp_path / "c.pdf")
    assert "page 1 of" in text_of(paper.pages[0]) and "<script>alert(1)</script>" in text_of(paper.pages[1])
    (number,) = ElementTree.parse(tmp_path / "c.xml").iter("{https://ptb.de/dcc}uniqueIdentifier")
    assert number.text == HOSTILE.replace("\x1b", "\ufffd").replace("\uffff", "\ufffd")


@pytest.mark.long
def test_a_german_certificate_is_german(tmp_path: Path) -> None:
    page = written(stated(), tmp_path, "de")
    for text in ("Kalibrierschein", "Seriennummer", "01.03.2026", "Insgesamt: erfüllt.", "Ende des Kalibrierscheins",
                 "Verfahren und Bedingungen", "beziehen sich nur auf den oben genannten Gegenstand"):  # fmt: skip
        assert text in page
    assert "Calibration certificate" not in page


@pytest.mark.long
def test_a_laboratory_has_a_template_and_a_logo_of_its_own(tmp_path: Path) -> None:
    layout = tmp_path / "layout.html"
    layout.write_text('{% extends "certificate.html" %}{% block signatures %}<p>Our own end</p>{% endblock %}')
    logo = tmp_path / "logo.svg"
    logo.write_text('<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 1 1"><rect width="1" height="1"/></svg>')
    own = stated()
    laboratory = own.laboratory.model_copy(update={"logo": str(logo)})
    own = own.model_copy(update={"template": str(layout), "laboratory": laboratory})
    page = written(own, tmp_path)
    assert "Our own end" in page and "End of certificate" not in page and 'src="data:image/svg+xml;base64,' in page
    layout.write_text("{% extends 'certificate.html' %}{% block header %}{{ nobody }}{% endblock %}")
    with pytest.raises(CalibrationError, match=r"layout.html: UndefinedError: 'nobody' is undefined"):
        written(own, tmp_path)
    for content, message in ((b"no picture", "a logo is an SVG, PNG or JPEG file"), (b"\x89PNG cut", "cannot be read")):
        logo.write_bytes(content)
        with pytest.raises(CalibrationError, match=message):
            written(own, tmp_path)
    with pytest.raises(CalibrationError, match="needs another name"):
        written(own.model_copy(update={"template": str(tmp_path / "certificate.html")}), tmp_path)


def test_without_a_budget_the_certificate_says_what_its_uncertainty_lacks(tmp_path: Path) -> None:
    file = tmp_path / "certificate.html"
    write_certificate(evaluated("tracking_2d"), Certificate(), words("en"), [file])
    page = file.read_text(encoding="utf-8")
    assert "without instrument and temperature" in page and "coverage probability" not in page
    assert "Draft, not a certificate" in page and "7.8.4.1 a (--budget)" in page
