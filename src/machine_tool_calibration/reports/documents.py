# SPDX-License-Identifier: Apache-2.0
"""Documents for programs: any record in the types of JSON and its text, and tables as CSV files."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from machine_tool_calibration.files import whole
from machine_tool_calibration.json_types import plain

if TYPE_CHECKING:
    import pandas as pd

    from machine_tool_calibration.session.provenance import Provenance


def picked(record: Any, *names: str) -> dict[str, Any]:
    """Attributes of a record by their names."""
    return {name: getattr(record, name) for name in names}


def to_json(value: Any, margin: str = "") -> str:
    """A document as JSON text that any parser accepts, with a margin before its lines but for the first.

    Objects and lists of objects are over several lines; numbers, of which a map has many, one after the other.
    """
    inner = margin + " "
    if isinstance(value, Mapping) and value:
        entries = [f"{inner}{_compact(str(key))}: {to_json(entry, inner)}" for key, entry in value.items()]
        return "{\n" + ",\n".join(entries) + f"\n{margin}}}"
    if isinstance(value, list | tuple) and value and isinstance(value[0], Mapping):
        return "[\n" + ",\n".join(inner + to_json(entry, inner) for entry in value) + f"\n{margin}]"
    if value is None or isinstance(value, bool | int | float | str | list | tuple | Mapping):
        return _compact(value)
    return to_json(plain(value), margin)


def _compact(value: Any) -> str:
    try:
        return json.dumps(value, allow_nan=False, ensure_ascii=False)
    except (TypeError, ValueError):
        return json.dumps(plain(value), allow_nan=False, ensure_ascii=False)


def write_table(table: pd.DataFrame, file: Path, origin: Provenance) -> Path:
    """Write a table as CSV, after lines with `#` that say what it was made from (`pd.read_csv(file, comment="#")`)."""
    with whole(file) as part, part.open("w", encoding="utf-8", newline="") as stream:
        stream.writelines(f"# {name}: {' '.join(value.split())}\n" for name, value in origin.lines())
        table.to_csv(stream, index=False, lineterminator="\n")
    return file
