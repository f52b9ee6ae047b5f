# SPDX-License-Identifier: Apache-2.0
"""A report holds all it needs, is sound HTML and PDF, and is whole in every language.
The catalogues of the report's words.
"""

import copy
import io
import json
import pickle
import re
import string
from collections.abc import Iterator
from dataclasses import replace
from functools import cache
from html.parser import HTMLParser
from importlib import resources
from pathlib import Path

import html5lib
import pypdf
import pytest
import yaml
from matplotlib.figure import Figure
from matplotlib.quiver import QuiverKey
from matplotlib.text import Text

from machine_tool_calibration import words as catalogues
from machine_tool_calibration.budget.contributor import default_budget
from machine_tool_calibration.methods.fitted import FitRequest
from machine_tool_calibration.report import figures
from machine_tool_calibration.report.evaluation import Evaluation, evaluate
from machine_tool_calibration.report.figures import Picture
from machine_tool_calibration.report.page import html, write_report
from machine_tool_calibration.report.sections import Section, Turnable, sections
from machine_tool_calibration.reports.identification import Measured
from machine_tool_calibration.reports.tables import TextTable
from machine_tool_calibration.session.provenance import flattened
from machine_tool_calibration.simulation.simulate import simulate
from machine_tool_calibration.simulation.spec import SimulationSpec
from machine_tool_calibration.words import LANGUAGES, Verbatim, Words, enumeration, named, say, together, words

PLANS = {
    "tracking_2d": {"method": "tracking_interferometer", "dimension": 2},
    "step_diagonal": {"method": "step_diagonal"},
    "rotary_axis": {"method": "rotary_axis"},
    "probing": {"method": "probing"},
    "iso230_2": {"method": "direct", "kind": "iso230_2"},
}
# Besides these, in a further language: a plate, and two sessions together.
MORE = {"grid_plate": {"method": "direct", "kind": "grid_plate"}, "joint": PLANS["iso230_2"]}
# Of these the whole report, which takes longer.
WHOLE = ("tracking_2d", "iso230_2")
ABOUT = {
    "machine": {"name": "VMC <850> & </script>", "serial": "007"},
    "date": "2026-03-01",
    "operator": "Erika Müller\x1b[31m",
}


pytestmark = pytest.mark.usefixtures("few_draws")


@pytest.fixture(scope="module", autouse=True)
def rough_pictures() -> Iterator[None]:
    """Every kind of picture is drawn, once in each format, its panels not laid out: those of tests/plots are."""
    drawn: dict[tuple[str, str], bytes] = {}

    def once(kind: str) -> property:
        draw = getattr(Picture, kind).func

        def made(picture: Picture) -> bytes:
            alike = picture.name.split("_")[0], kind
            if alike not in drawn:
                drawn[alike] = draw(picture)
            return drawn[alike]

        return property(made)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Figure, "get_layout_engine", lambda figure: None)
        patch.setattr(figures, "_DPI", 50)
        for kind in ("svg", "png"):
            patch.setattr(Picture, kind, once(kind))
        yield


@cache
def evaluated(name: str) -> Evaluation:
    """What a report of that plan tells."""
    effects = [{"id": "backlash_y", "size": 2e-6}] if name == "tracking_2d" else []
    plan = (PLANS | MORE)[name]
    session = simulate(SimulationSpec.model_validate({"seed": 1, "plan": plan, "effects": effects})).session
    if name == "tracking_2d":
        values = session.readings.displacement.copy()
        values[90] += 80e-6
        described = session.description.model_copy(update={"about": ABOUT})
        session = replace(session, description=described, readings=replace(session.readings, displacement=values))
    whole = name in WHOLE
    sessions, labels = (session,), None
    if name == "joint":
        other = simulate(SimulationSpec.model_validate({"seed": 2, "plan": PLANS["tracking_2d"]})).session
        sessions, labels = (session, other), ("run", "map")
    return evaluate(
        Measured(sessions, FitRequest(sessions, labels)),
        diagnosis=whole,
        contributors=default_budget([session]) if whole else (),
        tolerances={"EXX": 10e-6} if name == "iso230_2" else None,
    )


@cache
def content(name: str, language: str) -> list[Section]:
    """The sections of a report."""
    return sections(evaluated(name), invented() if language == INVENTED else words(language))


PLACES = re.compile(r"\{\w+\}")
PARTS = re.compile(r"\{\w+\}|[^{]+")
# Words, not the letters of a formula, an id or a unit.
WORD = re.compile(r"(?<![\w.'])[A-Za-zäöüß]{3,}(?![\w.(])")
# A decimal point.
POINT = re.compile(r"(?<![\w.])\d+\.\d+(?![\w.])")
# Names that stay in every language: of error motions, diagonals, units, quantities in formulas, and an effect (scale).
NAMES = re.compile(r"E[XYZABC][XYZABC]|[PN]{3}|hPa|min|tau|lead|sin|cos|exp|dir|scale")
INVENTED = "xx"


def invented() -> Words:
    """English in Cyrillic letters, with a comma in numbers: what is left in Latin letters was told by no key."""
    letters = str.maketrans({letter: chr(0x430 + k % 32) for k, letter in enumerate(string.ascii_letters)})

    def written(text: str) -> str:
        return "".join(part if part.startswith("{") else part.translate(letters) for part in PARTS.findall(text))

    texts = {
        key: [written(one) for one in text] if isinstance(text, list) else written(text)
        for key, text in words("en").texts.items()
    }
    return Words(INVENTED, texts | {"report.decimal": ","})


class Seen(HTMLParser):
    """What a browser would load, and what it would show."""

    def __init__(self) -> None:
        super().__init__()
        self.loaded: list[str] = []
        self.shown: list[str] = []
        self.inside: list[str] = []

    def handle_starttag(self, tag, attrs):
        self.loaded += [value for name, value in attrs if name in ("src", "href", "data", "action", "srcset", "poster")]
        if tag in ("style", "script"):
            self.inside.append(tag)

    def handle_endtag(self, tag):
        if self.inside and self.inside[-1] == tag:
            self.inside.pop()

    def handle_data(self, data):
        if not self.inside:
            self.shown.append(data)


def page(name: str, language: str, **options: bool) -> str:
    return html(evaluated(name), content(name, language), words(language), **options)


def blocks(name: str, kind: type) -> list:
    return [block for section in content(name, "en") for block in section.blocks if isinstance(block, kind)]


@pytest.mark.long(but=("tracking_2d",))
@pytest.mark.parametrize("name", PLANS)
def test_every_method_has_a_page_that_is_sound_and_loads_nothing(name):
    text = page(name, "en")
    html5lib.HTMLParser(strict=True).parse(re.sub(r"[A-Za-z0-9+/]{200,}=*", "", text))  # without what takes its time
    found = Seen()
    found.feed(text)
    assert [address for address in found.loaded if not address.startswith(("#", "data:image/svg+xml;base64,"))] == []
    style = "".join(re.findall(r"<style>(.*?)</style>", text, re.DOTALL))
    assert "@page" not in style and "url(" not in style and "@import" not in style
    shown = " ".join(found.shown)
    of_result = "Positioning by ISO 230-2" if name == "iso230_2" else "Map of the errors"
    for section in ("Result", "What was measured", of_result, "Residuals"):
        assert section in shown
    assert evaluated(name).result.provenance.sha256 in shown
    assert "Signatures" in shown and "approved by" in shown
    assert len(blocks(name, Picture)) >= 3
    assert len({picture.name for picture in blocks(name, Picture)}) == len(blocks(name, Picture))


def test_what_people_wrote_cannot_become_part_of_the_page():
    text = page("tracking_2d", "en")
    assert "VMC &lt;850&gt; &amp; &lt;/script&gt;" in text
    assert "VMC <850>" not in text
    assert "\x1b" not in text and "Erika Müller\ufffd[31m" in text


@pytest.mark.long
@pytest.mark.parametrize("name", ["tracking_2d", "rotary_axis"])
def test_the_map_can_be_turned_and_its_library_is_in_the_page(name):
    (drawing,) = (block.drawing for block in blocks(name, Turnable))
    marks = next(one for one in drawing["data"] if one["mode"] == "markers")
    assert len(marks["x"]) == len(evaluated(name).result.error_map.points)
    text = page(name, "en")
    held = json.loads(re.search(r'id="drawings">(.*?)</script>', text, re.DOTALL)[1])
    assert held == json.loads(json.dumps([drawing]))
    assert 1e6 < len(re.search(r'id="plotly">(.*?)</script>', text)[1]) < 2.5e6
    assert "plotly" not in page(name, "en", for_paper=True)


@pytest.mark.long
def test_each_error_motion_has_a_picture_and_each_standard_a_page():
    names = [picture.name for picture in blocks("rotary_axis", Picture)]
    assert [name for name in names if name.startswith("motion_")] == [f"motion_E{c}C" for c in "XYZABC"]
    for name, standard, pictures in (
        ("iso230_2", "iso230_2", ["iso230_2_X"]),
        ("step_diagonal", "iso230_6", ["iso230_6"]),
        ("rotary_axis", "iso230_7", []),
    ):
        (own,) = (section for section in content(name, "en") if section.id == standard)
        assert [block.name for block in own.blocks if isinstance(block, Picture)] == pictures
        assert any(isinstance(block, TextTable) and block.rows for block in own.blocks)


@pytest.mark.long
def test_an_error_motion_is_drawn_once():
    found = evaluated("iso230_2")
    drawn = [*figures.map_pictures(found), *figures.motion_pictures(found)]
    assert [picture.name for picture in drawn] == ["motion_EXX"]


@pytest.mark.long
def test_diagnosis_budget_conformity_and_readings_set_aside_are_there():
    tables = {table.title: table for table in blocks("tracking_2d", TextTable)}
    assert tables["Effects looked for, the most probable first"].rows[0][0] == "✓ backlash of Y"
    assert [row[0] for row in tables["Step by step"].rows] == ["first model", "1 reading set aside", "+ backlash_y"]
    assert [row[0] for row in tables["Readings set aside"].rows] == ["90"]
    found = evaluated("tracking_2d")
    assert any(title.startswith("contributors") for title in tables) and found.budget is not None
    ids = [section.id for section in content("iso230_2", "en")]
    assert "conformity" in ids and "conformity" not in [section.id for section in content("tracking_2d", "en")]


def test_a_diagnosis_of_other_readings_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    """A reading that only the lack of an effect made stand out is set aside in the result and not in the diagnosis."""
    found = evaluated("tracking_2d")
    (own,) = (section for section in content("tracking_2d", "en") if section.id == "diagnosis")
    assert own.blocks[0].startswith("The model lacks")
    monkeypatch.setitem(found.document, "used", found.document["used"] - 1)
    (own,) = (section for section in sections(found, words("de")) if section.id == "diagnosis")
    assert own.blocks[0].startswith("Aus 287 Ablesungen") and own.blocks[0].endswith("das Ergebnis oben ist aus 286.")


@pytest.mark.long
def test_effects_in_the_model_stand_there_with_their_sizes() -> None:
    measured = evaluated("iso230_2").measured
    chosen = replace(measured.chosen, effects=("backlash_x",))
    found = evaluate(replace(measured, chosen=chosen), diagnosis=False)
    tables = [block for section in sections(found, words("en")) for block in section.blocks]
    (table,) = (one for one in tables if isinstance(one, TextTable) and one.title == "Effects in the model")
    ((title, name, size),) = table.rows
    assert (title, name) == ("backlash of X", "backlash_x")
    assert re.fullmatch(r"b = \d\.\d+ ± 0\.\d+ µm", size)


@pytest.mark.long
def test_paper_has_its_pages_and_texts(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, language: str = "de"):
    file = tmp_path / "folder" / "report.pdf"
    monkeypatch.setattr("machine_tool_calibration.report.page.sections", lambda *_: content("tracking_2d", language))
    written = write_report(evaluated("tracking_2d"), words(language), [file], tmp_path / "figures")
    assert written[0] == file and {path.suffix for path in written[1:]} == {".svg"}
    assert all(b"<svg" in path.read_bytes() for path in written[1:])
    paper = pypdf.PdfReader(io.BytesIO(file.read_bytes()))
    text = "\n".join(one.extract_text() for one in paper.pages)
    assert len(paper.pages) >= 3 and f"{len(paper.pages)} / {len(paper.pages)}" in text
    told = words(language)
    for section in content("tracking_2d", language):
        assert section.title in " ".join(text.split())
    assert told("report.signature") in text and "Erika Müller" in text
    assert evaluated("tracking_2d").result.provenance.sha256 in "".join(text.split())


def test_all_languages_have_all_texts():
    english = words("en")
    for language in LANGUAGES:
        own = words(language)
        assert set(own.texts) == set(english.texts)
        for key, text in own.texts.items():
            assert text and isinstance(text, list) == isinstance(english.texts[key], list), key
            assert set(PLACES.findall(str(text))) == set(PLACES.findall(str(english.texts[key]))), key


def shown_in(name: str, language: str) -> tuple[list[str], list[str]]:
    """All texts of a report's sections, and all of its pictures."""
    shown: list[str] = []
    drawn: list[str] = []
    for block in (block for section in content(name, language) for block in section.blocks):
        if isinstance(block, str):
            shown.append(block)
        elif isinstance(block, TextTable):
            shown += [block.title, *block.columns, block.note, *(cell for row in block.rows for cell in row)]
        elif isinstance(block, Picture):
            shown.append(block.caption)
            block.figure.draw_without_rendering()
            texts = [*block.figure.findobj(Text), *(key.text for key in block.figure.findobj(QuiverKey))]
            drawn += [text.get_text() for text in texts]
    return shown, drawn


@pytest.mark.long
@pytest.mark.parametrize("name", PLANS | MORE)
def test_a_further_language_is_one_file(name):
    """Nothing but names is left in Latin letters where the catalogue has none: sentences, tables, pictures."""
    shown, drawn = shown_in(name, INVENTED)
    assert len(shown) + len(drawn) > 100
    found = evaluated(name)
    own = [*(one for session in found.measured.recorded for one in session.setup_ids), found.result.provenance.software]
    own += found.measured.chosen.labels or ()
    own += [value for session in found.measured.recorded for _, value in flattened(session.description.about)]
    names = {word for text in own for word in WORD.findall(text)}
    left = {word: text for text in (*shown, *drawn) for word in WORD.findall(text) if word not in names}
    assert {word: text for word, text in left.items() if not NAMES.fullmatch(word)} == {}
    software = found.result.provenance.software
    assert [text for text in (*shown, *drawn) if POINT.search(text) and software not in text] == []


@pytest.mark.long
def test_a_german_report_is_german():
    shown, drawn = shown_in("tracking_2d", "de")
    assert {"Einflüsse, nach denen gesucht wurde, die wahrscheinlichsten zuerst", "Zeile"} <= {*shown}
    assert "Unsicherheitsbudget" in drawn and "gemessen − vorhergesagt, µm" in drawn


def test_numbers_have_the_decimal_sign_of_the_language():
    german = words("de")
    assert german.numbers("0.18 ± 0.02 µm at (1.5, -2) mm") == "0,18 ± 0,02 µm at (1,5; -2) mm"
    assert german.numbers("1.2.3 EXX(0.4), EXX(-0.4) p = 1.5e-05.") == "1.2.3 EXX(0,4), EXX(-0,4) p = 1,5e-05."
    assert german.numbers("on 2026-03-01") == "on 01.03.2026" and words("en").numbers("2026-03-01") == "2026-03-01"
    assert german.numbers(Verbatim("plate 1.5")) == "plate 1.5" and words("en").numbers("0.18") == "0.18"
    figure = Figure()
    figure.subplots().plot([0.0, 0.2, 0.4])
    picture = figures.told(Picture("one", "", figure), german)
    picture.figure.draw_without_rendering()
    assert "0,25" in [text.get_text() for text in picture.figure.findobj(Text)]


@pytest.mark.parametrize("language", LANGUAGES)
def test_no_word_of_a_catalogue_takes_the_place_of_another(language: str) -> None:
    text = (resources.files(catalogues) / f"{language}.yaml").read_text(encoding="utf-8")
    for _, group in yaml.compose(text).value:
        keys = [key.value for key, _ in group.value]
        assert [key for key in keys if keys.count(key) > 1] == []


def test_texts_that_stand_together_are_each_said_in_the_language() -> None:
    datum = together((say("datum.together"), "EYX(0) = 0", say("datum.without_slope", name="EYX")), "; ")
    assert datum == "conditions that all readings together need; EYX(0) = 0; EYX without slope"
    assert (
        words("de").told(datum) == "Bedingungen, die alle Ablesungen zusammen brauchen; EYX(0) = 0; EYX ohne Steigung"
    )
    listed = enumeration(["EXX", "EYX", say("unknown.squareness", owner="C0Y")])
    assert listed == "EXX, EYX and squareness C0Y"
    assert words("de").told(listed) == "EXX, EYX und Rechtwinkligkeit C0Y"
    assert enumeration(["EXX"]) == "EXX" and enumeration([]) == ""


def test_a_name_of_the_users_own_stays_and_one_that_is_known_is_said() -> None:
    known, own = named("column", "temperature_air"), named("column", "spindle_load")
    assert (known, own) == ("temperature_air", "spindle_load")
    assert words("en").told(known) == "temperature of the air" and words("de").told(known) == "Lufttemperatur"
    assert words("de").told(own) == "spindle_load" and isinstance(own, Verbatim)


def test_what_differs_between_passes_is_no_verdict() -> None:
    assert words("de")("fit.family_pass") == words("de").told(say("fit.family_pass")) != "erfüllt"
    assert words("de").told(named("decision", "pass")) == "erfüllt"


def test_a_text_keeps_what_it_is_told_from_on_its_way() -> None:
    """Through a picture, which takes the text of what it is given, a copy and another process."""
    text = say("report.readings_of", count=3, missing=1)
    figure = Figure()
    panel = figure.subplots()
    panel.set_title(text)
    panel.plot([0.0], label=text)
    drawn = [panel.title, *panel.legend().get_texts()]
    for one in (*(text.get_text() for text in drawn), copy.deepcopy(text), pickle.loads(pickle.dumps(text))):
        assert words("de").told(one) == "3, davon 1 fehlend"
