# SPDX-License-Identifier: Apache-2.0
"""The catalogues of the report's words."""

from importlib import resources

import pytest
import yaml

from machine_tool_calibration import words as catalogues
from machine_tool_calibration.words import LANGUAGES, words


@pytest.mark.parametrize("language", LANGUAGES)
def test_no_word_of_a_catalogue_takes_the_place_of_another(language: str) -> None:
    text = (resources.files(catalogues) / f"{language}.yaml").read_text(encoding="utf-8")
    for _, group in yaml.compose(text).value:
        keys = [key.value for key, _ in group.value]
        assert [key for key in keys if keys.count(key) > 1] == []


def test_what_stands_between_semicolons_is_translated_by_itself() -> None:
    said = words("de").phrase(
        "sessions 'a' and 'b' contradict each other in EYY (or EXX, EYX) by 4.91 ± 0.65 µm (k = 2); "
        "sessions 'b' and 'a' contradict each other in EXY by 2 ± 1 µm (k = 2) "
        "(two sessions alone do not determine which of them is wrong)"
    )
    assert said == (
        "die Messungen 'a' und 'b' widersprechen einander in EYY (oder EXX, EYX) um 4.91 ± 0.65 µm (k = 2); "
        "die Messungen 'b' und 'a' widersprechen einander in EXY um 2 ± 1 µm (k = 2) "
        "(zwei Messungen allein bestimmen nicht, welche von ihnen falsch ist)"
    )
    datum = words("de").phrase("conditions that all readings together need; EYX(0) = 0; EYX without slope")
    assert datum == "Bedingungen, die alle Ablesungen zusammen brauchen; EYX(0) = 0; EYX ohne Steigung"
    assert words("de").phrase("temperature, work, °C") == "Temperatur Werkstück, °C"


def test_what_differs_between_passes_is_no_verdict() -> None:
    assert words("de")("spread_pass") == "Überfahrten" and words("de").phrase("pass") == "erfüllt"
    assert words("en").phrase("temperature_air") == "temperature of the air"
