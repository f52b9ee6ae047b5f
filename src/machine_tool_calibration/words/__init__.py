# SPDX-License-Identifier: Apache-2.0
"""What people read, in their language: a sentence is made from its key, and each language is a file of this folder."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from importlib import resources
from typing import Any

import yaml

from machine_tool_calibration.errors import CalibrationError

_FILES = {file.name.removesuffix(".yaml"): file for file in resources.files(__package__).iterdir() if ".y" in file.name}
LANGUAGES = tuple(sorted(_FILES, key=lambda name: (name != "en", name)))
"""Codes of the languages that have a file, English first."""
TIMES = ((172800.0, 86400.0, "d"), (7200.0, 3600.0, "h"), (120.0, 60.0, "min"))
"""From how many seconds, of how many each, a unit of time is readable; the largest first."""
_LOADER: Any = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
_NO_LETTERS = re.compile("[^a-z0-9]+")
# A number with decimals: not a part of a version.
_DECIMAL = re.compile(r"(?<![\w.])(\d+)\.(\d+)(?=e[-+]?\d|(?!\w|\.\d))")
_DATE = re.compile(r"(?<![\w-])(\d{4})-(\d\d)-(\d\d)(?![\w-])")
_LISTED = re.compile(r"(?<=\d), (?=[-+−]?\d)")


class Verbatim(str):
    """What a user wrote, such as a name, which is the same in every language."""


class Said(str):
    """A text in English that can be said in other languages too."""

    key: str  # of the text; of several texts together what stands between them
    values: Mapping[str, Any] | tuple[str, ...]  # what is put in, by name; the texts that stand together

    def __str__(self) -> str:
        """Itself, so that a picture, which takes the text of whatever it is given, keeps what it can be told from."""
        return self

    def of(self, **values: Any) -> Said:
        """The same text with other values put in."""
        return say(self.key, **{**dict(self.values), **values})  # type: ignore[arg-type]

    def told(self, words: Words) -> str:
        """The same in another language."""
        if isinstance(self.values, tuple):
            return words.told(self.key).join(map(words.told, self.values))
        return words(self.key, **{n: words.told(v) if isinstance(v, str) else v for n, v in self.values.items()})


def figures(value: float, count: int = 3) -> str:
    """A number with so many figures, and no exponent where it is large."""
    return f"{float(f'{value:.{count}g}'):.12g}"


def lasting(seconds: float) -> str:
    """A time with three figures, in the unit that it is readable in."""
    of, unit = next(((of, unit) for least, of, unit in TIMES if abs(seconds) >= least), (1.0, "s"))
    return f"{seconds / of:.3g} {unit}"


def say(key: str, /, **values: Any) -> Said:
    """The text of a key (`room.name`) in English, with values put in; of two forms that for one where `n` is 1.

    Texts among the values are said in the language of the whole.
    """
    return _said(words("en")(key, **values), key, values)


def named(room: str, name: str) -> str:
    """A name that the files of a measurement have too, such as that of a column; one of the user's own stays.

    In English text it is the name itself; in the language of a report what the catalogue has for `room.name`, small
    letters, digits and `_`.
    """
    key = f"{room}.{_NO_LETTERS.sub('_', name.lower()).strip('_')}"
    return _said(name, key, {}) if key in words("en").texts else Verbatim(name)


def together(texts: Iterable[str], between: str = " ") -> Said:
    """Several texts as one, each of which is said in another language by itself."""
    parts = tuple(texts)
    return _said(between.join(parts), between, parts)


def enumeration(texts: Sequence[str]) -> Said:
    """Several texts with commas between them, and `and` before the last."""
    if len(texts) < 2:
        return together(texts)
    return together((together(texts[:-1], ", "), texts[-1]), say("text.and"))


def _said(text: str, key: str, values: Mapping[str, Any] | tuple[str, ...]) -> Said:
    made = Said(text)
    made.key, made.values = key, values
    return made


@dataclass(frozen=True)
class Words:
    """The words of a language."""

    language: str  # its code, ISO 639-1
    texts: Mapping[str, str | list[str]]  # by key; of two forms the first is for one

    def __call__(self, key: str, /, **values: Any) -> str:
        """The text of a key, with values put in."""
        text = self.texts[key]
        if isinstance(text, list):
            text = text[values["n"] != 1]
        return text.format(**values) if values else text

    def told(self, text: str) -> str:
        """A text of another room in this language; as it stands where it is a name, or has no words."""
        return text.told(self) if isinstance(text, Said) else text

    def numbers(self, text: str) -> str:
        """A text told, with the language's dates and decimal sign, semicolons between numbers where that is a comma."""
        text, sign = self.told(text), self("report.decimal")
        if sign == "." or isinstance(text, Verbatim):
            return text
        if _DECIMAL.search(text):
            text = _DECIMAL.sub(rf"\1{sign}\2", _LISTED.sub("; ", text))
        return _DATE.sub(self("report.date_form"), text)


@cache
def words(language: str) -> Words:
    """The words of a language; a CalibrationError if there is no catalogue of it."""
    if language not in LANGUAGES:
        raise CalibrationError(f"there is no language {language!r}; there are {', '.join(LANGUAGES)}")
    content = yaml.load(_FILES[language].read_text(encoding="utf-8"), Loader=_LOADER)
    rooms = {f"{room}.{key}": text for room, texts in content.items() for key, text in texts.items()}
    return Words(language, rooms)
