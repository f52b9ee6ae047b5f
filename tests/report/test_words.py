# SPDX-License-Identifier: Apache-2.0
"""The catalogues of the report's words."""

import copy
import pickle
from importlib import resources

import pytest
import yaml
from matplotlib.figure import Figure

from machine_tool_calibration import words as catalogues
from machine_tool_calibration.words import LANGUAGES, Verbatim, enumeration, named, say, together, words


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
