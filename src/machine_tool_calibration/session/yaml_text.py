# SPDX-License-Identifier: Apache-2.0
"""A strict reader of YAML: no tags, no duplicate keys, bounded aliases and depth.

PyYAML's parser gives the events; the values are made here, so that nothing but numbers, text, lists and
mappings can come out, an alias cannot multiply without end, and every value knows its line.
Scalars follow YAML 1.2 (`1e-7` is a number, `on` and `Y` are text).
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from typing import Any

import yaml

from machine_tool_calibration.errors import SessionError

__all__ = ["Document", "PlainDumper", "load_yaml"]

_MAX_DEPTH = 32
_MAX_VALUES = 4_000_000
_MAX_ALIASED = 100_000
_INT = re.compile(r"[-+]?(0|[1-9][0-9]{0,17})")
_FLOAT = re.compile(r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?")
_SPECIAL = {
    **dict.fromkeys(("", "~", "null", "Null", "NULL"), None),
    **dict.fromkeys(("true", "True", "TRUE"), True),
    **dict.fromkeys(("false", "False", "FALSE"), False),
    **dict.fromkeys((".nan", ".NaN", ".NAN"), float("nan")),
    **dict.fromkeys((".inf", ".Inf", ".INF", "+.inf"), float("inf")),
    **dict.fromkeys(("-.inf", "-.Inf", "-.INF"), float("-inf")),
}
_TEXT_KEYS = frozenset({"id"})
# Keys below which everything is text as it stands: a serial number 007 or 1e5, a version 3.10, a date.
_VERBATIM_KEYS = frozenset({"about"})
_LOADER: Any = getattr(yaml, "CSafeLoader", yaml.SafeLoader)

Path = tuple[str | int, ...]


@dataclass
class Document:
    """A YAML text's value and where each part of it stands.

    Attributes:
        value: numbers, text, lists and mappings.
        lines: line (from 1) of each value by its path of keys and indices.
    """

    value: Any
    lines: dict[Path, int]

    def line(self, path: Path) -> int | None:
        """The line of the value at a path, or of the nearest one that holds it; None for the whole."""
        while path and path not in self.lines:
            path = path[:-1]
        return self.lines.get(path) if path else None


@dataclass
class _Open:
    """A list or mapping whose end has not come yet."""

    value: list[Any] | dict[str, Any]
    path: Path
    anchor: str | None
    size_before: int
    key: str | None = None
    verbatim: bool = False


@dataclass
class _Builder:
    source: str
    truth: bool = True
    stack: list[_Open] = field(default_factory=list)
    lines: dict[Path, int] = field(default_factory=dict)
    anchors: dict[str, tuple[Any, int]] = field(default_factory=dict)
    values: int = 0
    aliased: int = 0
    root: Any = None
    documents: int = 0

    def fail(self, event: Any, what: str) -> SessionError:
        return SessionError(f"{self.source} line {event.start_mark.line + 1}: {what}")

    def count(self, event: Any, number: int = 1) -> None:
        self.values += number
        if self.values > _MAX_VALUES:
            raise self.fail(event, f"more than {_MAX_VALUES} values")

    def here(self) -> Path:
        if not self.stack:
            return ()
        top = self.stack[-1]
        if isinstance(top.value, list):
            return (*top.path, len(top.value))
        return (*top.path, top.key or "")

    def add(self, event: Any, value: Any) -> None:
        if not self.stack:
            self.root = value
            return
        top = self.stack[-1]
        if isinstance(top.value, list):
            top.value.append(value)
        elif top.key is None:
            if not isinstance(value, str):
                raise self.fail(event, "a key must be text")
            if value in top.value:
                raise self.fail(event, f"key {value!r} stands twice")
            top.key = value
            self.lines[(*top.path, value)] = event.start_mark.line + 1
        else:
            top.value[top.key] = value
            top.key = None

    def expects_key(self) -> bool:
        return bool(self.stack) and isinstance(self.stack[-1].value, dict) and self.stack[-1].key is None

    def scalar(self, event: Any) -> None:
        self.count(event)
        is_text = self.expects_key() or not event.implicit[0]
        if not is_text and self.stack:
            top = self.stack[-1]
            is_text = top.verbatim or (top.key in _TEXT_KEYS and event.value not in _SPECIAL)
        if not self.expects_key():
            self.lines.setdefault(self.here(), event.start_mark.line + 1)
        value = event.value if is_text else _resolve(event.value, self.truth)
        if event.anchor:
            self.anchors[event.anchor] = (value, 1)
        self.add(event, value)

    def open(self, event: Any, value: list[Any] | dict[str, Any]) -> None:
        self.count(event)
        if self.expects_key():
            raise self.fail(event, "a key must be text")
        if len(self.stack) >= _MAX_DEPTH:
            raise self.fail(event, f"nested deeper than {_MAX_DEPTH} levels")
        path = self.here()
        self.lines.setdefault(path, event.start_mark.line + 1)
        top = self.stack[-1] if self.stack else None
        verbatim = top is not None and (top.verbatim or top.key in _VERBATIM_KEYS)
        self.stack.append(_Open(value, path, event.anchor, self.values, verbatim=verbatim))

    def close(self, event: Any) -> None:
        top = self.stack.pop()
        if top.anchor:
            self.anchors[top.anchor] = (top.value, 1 + self.values - top.size_before)
        self.add(event, top.value)

    def alias(self, event: Any) -> None:
        if event.anchor not in self.anchors:
            raise self.fail(event, f"alias *{event.anchor} of nothing that stands before it")
        value, size = self.anchors[event.anchor]
        self.aliased += size
        if self.aliased > _MAX_ALIASED:
            raise self.fail(event, f"aliases repeat more than {_MAX_ALIASED} values")
        self.count(event, size)
        self.add(event, value)


def _resolve(text: str, truth: bool) -> Any:
    if text in _SPECIAL and (truth or not isinstance(_SPECIAL[text], bool)):
        return _SPECIAL[text]
    if _INT.fullmatch(text):
        return int(text)
    if _FLOAT.fullmatch(text) and not re.fullmatch(r"[-+]?0[0-9]+", text):
        return float(text)
    return text


def load_yaml(text: str, source: str, *, truth: bool = True) -> Document:
    """The value of a YAML text.

    Args:
        text: one YAML document.
        source: name of the file, for messages.
        truth: whether `true` and `false` are truth values; else they are text.

    Raises:
        SessionError: not YAML, more than one document, a tag, a key that stands twice or is not text, nested or
            repeated (by aliases) without measure. One line, with the line in the file.
    """
    builder = _Builder(source, truth)
    try:
        for event in yaml.parse(text, Loader=_LOADER):
            if tag := getattr(event, "tag", None):
                raise builder.fail(event, f"tag {tag!r} is not accepted")
            if isinstance(event, yaml.ScalarEvent):
                builder.scalar(event)
            elif isinstance(event, yaml.AliasEvent):
                builder.alias(event)
            elif isinstance(event, yaml.SequenceStartEvent):
                builder.open(event, [])
            elif isinstance(event, yaml.MappingStartEvent):
                builder.open(event, {})
            elif isinstance(event, yaml.SequenceEndEvent | yaml.MappingEndEvent):
                builder.close(event)
            elif isinstance(event, yaml.DocumentStartEvent):
                builder.documents += 1
                if builder.documents > 1:
                    raise builder.fail(event, "a second document; one is expected")
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        where = f" line {mark.line + 1}" if mark is not None else ""
        problem = getattr(error, "problem", None) or getattr(error, "reason", None) or type(error).__name__
        raise SessionError(f"{source}{where}: not valid YAML: {problem}") from None
    return Document(builder.root, builder.lines)


class PlainDumper(yaml.SafeDumper):
    """Writes what is there twice in full, not as an alias."""

    def ignore_aliases(self, data: Any) -> bool:
        """Whatever it is."""
        return True
