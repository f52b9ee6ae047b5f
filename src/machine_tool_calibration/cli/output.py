"""What every verb of `mtcal` shares: JSON for programs, text for people, one line for an error.

A verb prints for people through `console()`; with `--json` it writes one document with `write_json` and nothing else to
standard output. Progress and notes go to standard error (`error_console`, `note`). A wrong input raises a
`CalibrationError`, which `mtcal` turns into one line and exit status 1.
"""

from __future__ import annotations

import dataclasses
import json
import math
import os
import sys
from collections.abc import Callable, Mapping, Sequence, Set
from datetime import date, datetime
from enum import Enum
from pathlib import Path, PurePath
from typing import TYPE_CHECKING, Any, TypeVar

import click

if TYPE_CHECKING:
    from rich.console import Console

__all__ = [
    "console",
    "distinct",
    "error_console",
    "json_option",
    "note",
    "one_line",
    "plain",
    "session_labels",
    "to_json",
    "write_json",
]

Command = TypeVar("Command", bound=Callable[..., Any])


def json_option(function: Command) -> Command:
    """Add `--json` to a verb, as the keyword argument `as_json`."""
    return click.option(
        "--json", "as_json", is_flag=True, help="Write one JSON document to standard output, for programs."
    )(function)


def session_labels(paths: Sequence[Path]) -> list[str]:
    """Names of several sessions: those of their folders, numbered where they repeat."""
    return distinct([path.resolve().stem for path in paths])


def distinct(names: Sequence[str]) -> list[str]:
    """The names, numbered where they repeat."""
    return [f"{name}#{k + 1}" if names.count(name) > 1 else name for k, name in enumerate(names)]


def plain(value: Any) -> Any:
    """The value in the types of JSON: records as objects, arrays as lists, NaN and infinities as None.

    Raises:
        TypeError: a type that has no place in JSON.
    """
    if value is None or isinstance(value, bool | str):
        return value
    if isinstance(value, Enum):
        return plain(value.value)
    if isinstance(value, int):
        return int(value)
    if isinstance(value, float):
        return float(value) if math.isfinite(value) else None
    if isinstance(value, Mapping):
        return {str(key): plain(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [plain(entry) for entry in value]
    if isinstance(value, Set):
        return [plain(entry) for entry in sorted(value)]
    if isinstance(value, PurePath):
        return str(value)
    if isinstance(value, datetime | date):
        return value.isoformat()
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return {field.name: plain(getattr(value, field.name)) for field in dataclasses.fields(value)}
    for method in ("model_dump", "tolist"):  # a pydantic record; an array or a scalar of NumPy
        if hasattr(value, method):
            return plain(getattr(value, method)())
    raise TypeError(f"a {type(value).__name__} cannot be written as JSON")


def to_json(document: Any) -> str:
    """The document as JSON text that any parser accepts."""
    return _text(document, "")


def _text(value: Any, margin: str) -> str:
    """Objects and lists of objects over several lines; numbers, of which a map has many, one after the other."""
    inner = margin + " "
    if isinstance(value, Mapping) and value:
        entries = [f"{inner}{_compact(str(key))}: {_text(entry, inner)}" for key, entry in value.items()]
        return "{\n" + ",\n".join(entries) + f"\n{margin}}}"
    if isinstance(value, list | tuple) and value and isinstance(value[0], Mapping):
        return "[\n" + ",\n".join(inner + _text(entry, inner) for entry in value) + f"\n{margin}]"
    if value is None or isinstance(value, bool | int | float | str | list | tuple | Mapping):
        return _compact(value)
    return _text(plain(value), margin)


def _compact(value: Any) -> str:
    try:
        return json.dumps(value, allow_nan=False, ensure_ascii=False)
    except (TypeError, ValueError):
        return json.dumps(plain(value), allow_nan=False, ensure_ascii=False)


def write_json(document: Any) -> None:
    """Write one JSON document to standard output."""
    click.echo(to_json(document))


def console() -> Console:
    """Where text for people goes: standard output; plain text when that is not a terminal."""
    return _console(stderr=False)


def error_console() -> Console:
    """Where progress bars and notes go: standard error."""
    return _console(stderr=True)


def _console(*, stderr: bool) -> Console:
    from rich.console import Console  # here, because the import costs 0.1 s that `--help` does not need

    class Screen(Console):
        def on_broken_pipe(self) -> None:
            # rich would exit with status 1, as for a wrong input; `mtcal` has a status of its own for a closed pipe.
            raise BrokenPipeError

    stream = sys.stderr if stderr else sys.stdout
    # Tables keep their width in a file or a pipe, where rich would assume 80 columns.
    width = None if stream.isatty() or "COLUMNS" in os.environ else 120
    return Screen(file=stream, width=width, highlight=False)


def note(text: str) -> None:
    """A remark for people, on standard error."""
    click.echo(text, err=True)


def one_line(text: object) -> str:
    """The text without line breaks, for a message that must stay one line."""
    return " ".join(str(text).split())
