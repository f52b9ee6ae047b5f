# SPDX-License-Identifier: Apache-2.0
"""What people read, in their language: a sentence is made from its key, and each language is a file of this folder."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from functools import cache
from importlib import resources
from typing import Any

import yaml

from machine_tool_calibration.errors import CalibrationError

__all__ = ["LANGUAGES", "Said", "Verbatim", "Words", "say", "together", "words"]

_FILES = {file.name.removesuffix(".yaml"): file for file in resources.files(__package__).iterdir() if ".y" in file.name}
LANGUAGES = tuple(sorted(_FILES, key=lambda name: (name != "en", name)))
"""Codes of the languages that have a file, English first."""
_LOADER: Any = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
_LETTERS = re.compile("[a-z]{2}")
_BRACES = re.compile(r"\{\w+\}")
# A number with decimals: not a part of a version or of an unknown's name, such as EXX(0.4).
_DECIMAL = re.compile(r"(?<![\w.])(?<!\w\()(\d+)\.(\d+)(?=e[-+]?\d|(?!\w|\.\d))")
_LISTED = re.compile(r"(?<=\d), (?=[-+−]?\d)")
_PLACE = re.compile(r"\\\{(\w+)\\\}")


class Verbatim(str):
    """What a user wrote, such as a name, which is the same in every language."""


class Said(str):
    """A text in English that can be said in other languages too.

    Attributes:
        key: of the text; of several texts together what stands between them.
        values: what is put in, by name; the texts that stand together.
    """

    key: str
    values: Mapping[str, Any] | tuple[str, ...]

    def told(self, words: Words) -> str:
        """The same in another language."""
        if isinstance(self.values, tuple):
            return words.phrase(self.key).join(map(words.phrase, self.values))
        values = {name: words.phrase(value) if isinstance(value, str) else value for name, value in self.values.items()}
        return words(self.key, **values)


def say(key: str, /, **values: Any) -> Said:
    """The text of a key in English, with values put in; of two forms that for one where `n` is 1.

    Args:
        key: `room.name`, as in the catalogues.
        values: numbers and names; texts among them are said in the language of the whole.
    """
    return _said(words("en")(key, **values), key, values)


def together(texts: Iterable[str], between: str = " ") -> Said:
    """Several texts as one, each of which is said in another language by itself."""
    parts = tuple(texts)
    return _said(between.join(parts), between, parts)


def _said(text: str, key: str, values: Mapping[str, Any] | tuple[str, ...]) -> Said:
    made = Said(text)
    made.key, made.values = key, values
    return made


@dataclass(frozen=True)
class Words:
    """The words of a language.

    Attributes:
        language: its code, ISO 639-1.
        texts: by key; of two forms the first is for one.
        phrases: what has no key yet, by the English text; `{a}` stands for what differs, `{n}` for a number.
    """

    language: str
    texts: Mapping[str, str | list[str]]
    phrases: Mapping[str, str]
    _patterns: list[tuple[re.Pattern[str], str]] = field(init=False, repr=False, default_factory=list)

    def __post_init__(self) -> None:
        # those that say most come first
        for english in sorted(self.phrases, key=lambda text: -len(_BRACES.sub("", text))):
            if "{" in english:
                pattern = _PLACE.sub(_group, re.escape(english))
                self._patterns.append((re.compile(pattern, re.DOTALL), self.phrases[english]))

    def __call__(self, key: str, /, **values: Any) -> str:
        """The text of a key, with values put in."""
        text = self.texts[key]
        if isinstance(text, list):
            text = text[values["n"] != 1]
        return text.format(**values) if values else text

    def phrase(self, text: str) -> str:
        """A text of another room in this language; as it stands where it has no key and the catalogue not the phrase.

        Of several, with semicolons between them, each by itself where all of them are known.
        """
        if isinstance(text, Verbatim):
            return text
        if isinstance(text, Said):
            return text.told(self)
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

    def numbers(self, text: str) -> str:
        """A text with the language's decimal sign, and semicolons between listed numbers where that is a comma."""
        sign = self("decimal")
        if sign == "." or isinstance(text, Verbatim) or not _DECIMAL.search(text):
            return text
        return _DECIMAL.sub(rf"\1{sign}\2", _LISTED.sub("; ", text))


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
    content = yaml.load(_FILES[language].read_text(encoding="utf-8"), Loader=_LOADER)
    phrases = content.pop("phrases", {})
    rooms = {f"{room}.{key}": text for room, texts in content.items() for key, text in texts.items()}
    return Words(language, {key.removeprefix("report."): text for key, text in rooms.items()}, phrases)
