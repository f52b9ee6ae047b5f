# SPDX-License-Identifier: Apache-2.0
"""The words of the report: a catalogue for each language, with phrases that other rooms write in English."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cache
from importlib import resources
from typing import Any

import yaml

from machine_tool_calibration.errors import CalibrationError

__all__ = ["LANGUAGES", "Words", "words"]

LANGUAGES = ("en", "de")
_LETTERS = re.compile("[a-z]{2}")
_BRACES = re.compile(r"\{\w+\}")
_PLACE = re.compile(r"\\\{(\w+)\\\}")


@dataclass(frozen=True)
class Words:
    """The words of a language.

    Attributes:
        language: its code, ISO 639-1.
        texts: what the report itself says, by key.
        phrases: what other rooms say, by the English text; `{a}` stands for what differs, `{n}` for a number.
    """

    language: str
    texts: Mapping[str, str]
    phrases: Mapping[str, str]
    _patterns: list[tuple[re.Pattern[str], str]] = field(init=False, repr=False, default_factory=list)

    def __post_init__(self) -> None:
        # those that say most come first
        for english in sorted(self.phrases, key=lambda text: -len(_BRACES.sub("", text))):
            if "{" in english:
                pattern = _PLACE.sub(_group, re.escape(english))
                self._patterns.append((re.compile(pattern, re.DOTALL), self.phrases[english]))

    def __call__(self, key: str, **values: Any) -> str:
        """The text of a key, with values put in."""
        return self.texts[key].format(**values) if values else self.texts[key]

    def phrase(self, text: str) -> str:
        """An English phrase of another room in this language; as it stands where the catalogue does not have it.

        Of several, with semicolons between them, each by itself where all of them are known.
        """
        if text in self.phrases:
            return self.phrases[text]
        if not self.phrases or not _LETTERS.search(text):
            return text
        if "\n" in text:
            return "\n".join(map(self.phrase, text.split("\n")))
        parts = text.split("; ")
        if len(parts) > 1:
            # What is said of one of several must not reach into the next.
            own = [self.phrase(part) for part in parts]
            if not any(part == said and _LETTERS.search(part) for part, said in zip(parts, own, strict=True)):
                return "; ".join(own)
        for pattern, own_text in self._patterns:
            if found := pattern.fullmatch(text):
                return own_text.format(**{name: self.phrase(value) for name, value in found.groupdict().items()})
        return text


def _group(place: re.Match[str]) -> str:
    """`{n}` is a number, every other name any text."""
    return f"(?P<{place[1]}>{'[0-9]+' if place[1].startswith('n') else '.+?'})"


@cache
def words(language: str) -> Words:
    """The words of a language.

    Raises:
        CalibrationError: there is no catalogue of it.
    """
    if language not in LANGUAGES:
        raise CalibrationError(f"there is no language {language!r}; there are {', '.join(LANGUAGES)}")
    file = resources.files(__package__) / f"words_{language}.yaml"
    content = yaml.safe_load(file.read_text(encoding="utf-8"))
    return Words(language, content["texts"], content.get("phrases", {}))
