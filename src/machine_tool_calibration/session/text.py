# SPDX-License-Identifier: Apache-2.0
"""Text files from strangers, bounded in size, UTF-8, no NUL bytes; and a strict reader of YAML in them.

No tags, no duplicate keys, bounded aliases and depth: PyYAML's parser gives the events; the values are made here, so
that nothing but numbers, text, lists and mappings can come out, an alias cannot multiply without end, and every value
knows its line. Scalars follow YAML 1.2 (`1e-7` is a number, `on` and `Y` are text).
"""

import codecs
import re
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from machine_tool_calibration.errors import SessionError

LARGEST = 16 << 20
"""Bytes of a description that are accepted."""
LARGEST_TABLE = 64 << 20
"""Bytes of a file with many points or records that are accepted."""

_FOREIGN = {
    codecs.BOM_UTF32_LE: "UTF-32",
    codecs.BOM_UTF32_BE: "UTF-32",
    codecs.BOM_UTF16_LE: "UTF-16",
    codecs.BOM_UTF16_BE: "UTF-16",
}


def reject_foreign_encoding(head: bytes, source: str, *, table: bool = False) -> None:
    """Raise a SessionError when a file begins with the mark of UTF-16 or UTF-32; of a table it says what helps."""
    for mark, name in _FOREIGN.items():
        if head.startswith(mark):
            read = "; `mtcal convert FOLDER NEW --encoding utf-16` reads it" if table and name == "UTF-16" else ""
            raise SessionError(f"{source}: the text is {name}; save the file as UTF-8{read}")


@contextmanager
def reading(path: Path, kind: type[SessionError] = SessionError) -> Iterator[None]:
    """Say in one line, by an error of this kind, that there is no such file, or that the system refuses to read it."""
    try:
        if not path.is_file():  # to open a pipe would wait for its writer
            raise kind(f"{path}: {'is not a file' if path.exists() else 'no such file'}")
        yield
    except OSError as error:
        raise kind(f"{path}: cannot be read: {error.strerror}") from None


def read_bytes(path: Path, limit: int) -> bytes:
    """The content of a file of at most so many bytes; a SessionError if it is none, or larger."""
    with reading(path), path.open("rb") as stream:
        data = stream.read(limit + 1)
    if len(data) > limit:
        raise SessionError(f"{path}: larger than the {limit >> 20} MiB that are accepted")
    return data


def begins_with(path: Path, magic: bytes) -> bool:
    """Whether a file can be read and begins with these bytes, as files of a kind do."""
    try:
        with path.open("rb") as stream:
            return stream.read(len(magic)) == magic
    except OSError:
        return False


def read_text(path: Path, limit: int = LARGEST) -> str:
    """The text of a small file, without byte order mark; a SessionError if too large, not UTF-8, or with NUL."""
    source, data = str(path), read_bytes(path, limit)
    reject_foreign_encoding(data, source)
    return decoded(data.removeprefix(codecs.BOM_UTF8), source)


def decoded(data: bytes, source: str, before: int = 0) -> str:
    """UTF-8 text of a file, before which were so many lines; a SessionError names the line of a byte that is none."""
    at, what = data.find(b"\0"), "NUL byte; the file is not text or is damaged"
    if at < 0:
        try:
            return data.decode()
        except UnicodeDecodeError as error:
            at, what = error.start, f"byte 0x{data[error.start]:02x} is not UTF-8; save the file as UTF-8"
    line = before + data.count(b"\n", 0, at) + 1
    raise SessionError(f"{source} line {line}: {what}")


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
_VERBATIM_KEYS = frozenset({"about", "certificate"})
_LOADER: Any = getattr(yaml, "CSafeLoader", yaml.SafeLoader)

Place = tuple[str | int, ...]
"""Keys and indices, from the outermost one on."""


@dataclass
class Document:
    """A YAML text's value and where each part of it stands."""

    value: Any  # numbers, text, lists and mappings
    lines: dict[Place, int]  # line (from 1) of each value by its path of keys and indices

    def line(self, path: Place) -> int | None:
        """The line of the value at a path, or of the nearest one that holds it; None for the whole."""
        while path and path not in self.lines:
            path = path[:-1]
        return self.lines.get(path) if path else None


class _Reader:
    """The values of a text from PyYAML's events."""

    def __init__(self, text: str, source: str, truth: bool) -> None:
        self.source, self.truth = source, truth
        self.lines: dict[Place, int] = {}
        self.anchors: dict[str, tuple[Any, int]] = {}
        self.values, self.aliased = 0, 0
        self.events = self._accepted(text)

    def _accepted(self, text: str) -> Iterator[Any]:
        documents = 0
        for event in yaml.parse(text, Loader=_LOADER):
            if tag := getattr(event, "tag", None):
                raise self.fail(event, f"tag {tag!r} is not accepted")
            documents += isinstance(event, yaml.DocumentStartEvent)
            if documents > 1:
                raise self.fail(event, "a second document; one is expected")
            yield event

    def root(self) -> Any:
        value = None
        for event in self.events:
            if isinstance(event, yaml.NodeEvent):
                value = self._value(event, (), verbatim=False)
        return value

    def fail(self, event: Any, what: str) -> SessionError:
        return SessionError(f"{self.source} line {event.start_mark.line + 1}: {what}")

    def _count(self, event: Any, number: int = 1) -> None:
        self.values += number
        if self.values > _MAX_VALUES:
            raise self.fail(event, f"more than {_MAX_VALUES} values")

    def _value(self, event: Any, path: Place, *, verbatim: bool) -> Any:
        """What begins with an event, at its place; `verbatim` where all is text as it stands."""
        if isinstance(event, yaml.AliasEvent):
            return self._alias(event)
        self._count(event)
        self.lines.setdefault(path, event.start_mark.line + 1)
        before, key = self.values, path[-1] if path else None
        value: Any
        if isinstance(event, yaml.ScalarEvent):
            is_id = key in _TEXT_KEYS and event.value not in _SPECIAL
            is_text = verbatim or is_id or not event.implicit[0]
            value = event.value if is_text else _resolve(event.value, self.truth)
        elif len(path) >= _MAX_DEPTH:
            raise self.fail(event, f"nested deeper than {_MAX_DEPTH} levels")
        else:
            collect = self._list if isinstance(event, yaml.SequenceStartEvent) else self._mapping
            value = collect(path, verbatim or key in _VERBATIM_KEYS)
        if event.anchor:
            self.anchors[event.anchor] = (value, 1 + self.values - before)
        return value

    def _list(self, path: Place, verbatim: bool) -> list[Any]:
        out: list[Any] = []
        while not isinstance(event := next(self.events), yaml.SequenceEndEvent):
            out.append(self._value(event, (*path, len(out)), verbatim=verbatim))
        return out

    def _mapping(self, path: Place, verbatim: bool) -> dict[str, Any]:
        out: dict[str, Any] = {}
        while not isinstance(event := next(self.events), yaml.MappingEndEvent):
            key = self._key(event)
            if key in out:
                raise self.fail(event, f"key {key!r} stands twice")
            self.lines[(*path, key)] = event.start_mark.line + 1
            out[key] = self._value(next(self.events), (*path, key), verbatim=verbatim)
        return out

    def _key(self, event: Any) -> str:
        if isinstance(event, yaml.AliasEvent):
            key = self._alias(event)
        else:
            self._count(event)
            key = getattr(event, "value", None)
            if event.anchor:
                self.anchors[event.anchor] = (key, 1)
        if not isinstance(key, str):
            raise self.fail(event, "a key must be text")
        return key

    def _alias(self, event: Any) -> Any:
        if event.anchor not in self.anchors:
            raise self.fail(event, f"alias *{event.anchor} of nothing that stands before it")
        value, size = self.anchors[event.anchor]
        self.aliased += size
        if self.aliased > _MAX_ALIASED:
            raise self.fail(event, f"aliases repeat more than {_MAX_ALIASED} values")
        self._count(event, size)
        return value


def _resolve(text: str, truth: bool) -> Any:
    if text in _SPECIAL and (truth or not isinstance(_SPECIAL[text], bool)):
        return _SPECIAL[text]
    if _INT.fullmatch(text):
        return int(text)
    if _FLOAT.fullmatch(text) and not re.fullmatch(r"[-+]?0[0-9]+", text):
        return float(text)
    return text


def load_yaml(text: str, source: str, *, truth: bool = True) -> Document:
    """The value of a YAML text of one document; without `truth`, `true` and `false` are text.

    A SessionError says in one line, with the line in the file: not YAML, more than one document, a tag, a key that
    stands twice or is not text, nested or repeated (by aliases) without measure.
    """
    reader = _Reader(text, source, truth)
    try:
        return Document(reader.root(), reader.lines)
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        where = f" line {mark.line + 1}" if mark is not None else ""
        problem = getattr(error, "problem", None) or getattr(error, "reason", None) or type(error).__name__
        raise SessionError(f"{source}{where}: not valid YAML: {problem}") from None


def read_yaml(path: Path, limit: int = LARGEST) -> Document:
    """The value of a YAML file of at most so many bytes; a SessionError as of `read_text` and `load_yaml`."""
    return load_yaml(read_text(path, limit), str(path))


class PlainDumper(yaml.SafeDumper):
    """Writes what is there twice in full, not as an alias, and in quotes the text that would be read as a number."""

    def ignore_aliases(self, data: Any) -> bool:
        """Whatever it is."""
        return True


PlainDumper.add_implicit_resolver("tag:yaml.org,2002:float", re.compile(f"{_FLOAT.pattern}$"), list("-+.0123456789"))


def yaml_text(content: Any, dumper: type[PlainDumper] = PlainDumper, width: int = 120) -> str:
    """The YAML text of what a file holds, in the order of its keys, with lists of numbers in one line."""
    return yaml.dump(content, Dumper=dumper, sort_keys=False, default_flow_style=None, width=width, allow_unicode=True)
