# SPDX-License-Identifier: Apache-2.0
"""A foreign table and its mapping to a session in memory."""

from collections import abc
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from machine_tool_calibration.arrays import Array, IntArray
from machine_tool_calibration.errors import SessionError
from machine_tool_calibration.importing.columns import Columns, Rows
from machine_tool_calibration.importing.mapping import ROLES, Mapping
from machine_tool_calibration.importing.points import point_rows, range_rows
from machine_tool_calibration.importing.positioning import circle_rows, positioning_rows
from machine_tool_calibration.importing.text_table import TextTable, read_text_table
from machine_tool_calibration.session.catalogue import require_columns
from machine_tool_calibration.session.checks import check_session
from machine_tool_calibration.session.description import Direct, Place
from machine_tool_calibration.session.parse import describe
from machine_tool_calibration.session.session import Session, assemble, distinct_labels
from machine_tool_calibration.units import quantity

_SHOWN = 12  # columns that a note names
_LABELS = tuple(role for role, kind in ROLES["readings"].items() if kind == "text" and role != "setup")


@dataclass(frozen=True)
class Imported:
    """A session made from a table."""

    session: Session  # the measurement
    columns: dict[str, tuple[str, str]]  # what was read, by quantity: the column's name and its unit
    rows: int  # number of rows in the table
    notes: tuple[str, ...]  # what was done that the user should know


def import_table(path: Path | Sequence[Path], mapping: Mapping, *, name: str | None = None) -> Imported:
    """Read a foreign table, or several of the same form (each with setups of its own), as a session.

    `name` is the id of the setup where no column names it; by default the file's name without its ending. A
    SessionError says what is wrong, with file and line, also what cannot be right or is not enough for the method.
    """
    paths = [path] if isinstance(path, Path) else list(path)
    read = [Columns(read_text_table(file, mapping.file), mapping) for file in paths]
    names = [name] if name else distinct_labels([file.stem.strip() or "table" for file in paths])
    if len(names) < len(paths):
        raise SessionError(f"{name}: a name for one setup, but each of {len(paths)} tables is a setup of its own")
    parts = [_ROWS[mapping.table](columns, setup) for columns, setup in zip(read, names, strict=True)]
    rows, origin = _joined(parts, read)
    source = str(paths[0]) if len(paths) == 1 else f"{paths[0]} and {len(paths) - 1} more"
    description = describe(_described(rows, mapping, source), f"{source}: session")

    def where(row: int) -> str:
        table, line = map(int, origin[row])
        return read[table].table.where(line)

    place = Place(f"{source}: session", source, where)
    require_columns(description, [*rows.numbers, *rows.labels], source)
    readings = assemble(description, rows.numbers, rows.labels, place)
    session = Session(description, readings, source=source)
    check_session(session, place)
    notes = [*(f"{columns.table.source}: {text}" for columns in read for text in columns.table.notes), *rows.notes]
    for columns in read:
        if columns.unread:
            some = ", ".join(map(repr, columns.unread[:_SHOWN])) + (" …" if len(columns.unread) > _SHOWN else "")
            notes.append(f"{columns.table.source}: not read: {some}")
    if missing := int(np.count_nonzero(~np.isfinite(readings.displacement))):
        notes.append(f"{missing} of {len(readings)} readings are empty cells: kept as missing")
    if isinstance(description, Direct) and not description.terms:
        without = "without terms, as in --term EXX, nothing of the machine is identified"
        notes.append(f"no machine errors are named; {without}")
    return Imported(session, read[0].read, sum(len(columns.table) for columns in read), tuple(notes))


def _reading_rows(columns: Columns, name: str) -> Rows:
    """The readings of a table: its columns named as quantities, and others that the mapping names."""
    columns.take_namesakes()
    columns.need(["displacement"], "the reading")
    setups = columns.mapping.session.get("setups")
    ids = [str(entry.get("id")) for entry in setups if isinstance(entry, dict)] if isinstance(setups, list) else []
    if len(ids) > 1 and not columns.has("setup"):
        which = f"which of the setups {', '.join(ids)} a reading is of"
        raise SessionError(f"{columns.table.source}: no column says {which}")
    labels = {role: columns.text(role) for role in _LABELS if columns.has(role)}
    setup = columns.setups(ids[0] if ids else name)
    # Of a setup of deviations there is nothing else to say.
    named = setups is None and columns.mapping.session.get("method") == "direct"
    described = {"setups": [{"id": entry} for entry in dict.fromkeys(setup.tolist())]} if named else {}
    return Rows(columns.others(()), {"setup": setup, **labels}, np.arange(len(columns.table)), described)


_ROWS: dict[str, Callable[[Columns, str], Rows]] = {
    "points": point_rows,
    "ranges": lambda columns, setup: range_rows(columns),
    "iso230-2": positioning_rows,
    "circles": circle_rows,
    "readings": _reading_rows,
}


def _joined(parts: Sequence[Rows], read: Sequence[Columns]) -> tuple[Rows, IntArray]:
    """The rows of several tables, in the order of time where that was stamped, and (n, 2) table and row of each."""
    lengths = [len(part.row) for part in parts]
    origin = np.column_stack([np.repeat(np.arange(len(parts)), lengths), np.concatenate([part.row for part in parts])])

    def together(each: Sequence[abc.Mapping[str, np.ndarray]], lacking: object) -> dict[str, np.ndarray]:
        names, sized = dict.fromkeys(name for own in each for name in own), list(zip(each, lengths, strict=True))
        return {name: np.concatenate([own.get(name, np.full(n, lacking)) for own, n in sized]) for name in names}

    numbers, labels = together([part.numbers for part in parts], np.nan), together([part.labels for part in parts], "")
    setups: dict[str, tuple[str, object]] = {}
    for part, source in zip(parts, (columns.table.source for columns in read), strict=True):
        for entry in part.description.get("setups", ()):  # type: ignore[attr-defined]
            if entry["id"] in setups:
                first = setups[entry["id"]][0]
                raise SessionError(f"{source}: setup {entry['id']!r} is in {first} too; a setup is in one file")
            setups[entry["id"]] = (source, entry)
    described = dict(parts[0].description)
    if setups:
        described["setups"] = [entry for _, entry in setups.values()]
    if "repeats" in described:
        described["repeats"] = max(part.description["repeats"] for part in parts)  # type: ignore[type-var]
    notes = list(dict.fromkeys(text for part in parts for text in part.notes))
    if "time" in numbers and any(columns.stamped for columns in read):
        time = numbers["time"]
        order = np.argsort(time, kind="stable") if np.isfinite(time).all() else np.arange(len(time))
        notes += _reordered(time, origin, [columns.table for columns in read])
        numbers = {name: values[order] for name, values in numbers.items()} | {"time": time[order] - np.nanmin(time)}
        labels = {name: values[order] for name, values in labels.items()}
        origin = origin[order]
    return Rows(numbers, labels, origin[:, 1], described, tuple(notes)), origin


def _reordered(time: Array, origin: IntArray, tables: Sequence[TextTable]) -> list[str]:
    """Where rows are earlier than those before them, in (n, 2) tables and rows at times (n,), s: they are sorted."""
    place = np.lexsort((origin[:, 1], origin[:, 0]))
    back = np.flatnonzero(np.diff(time[place]) < 0.0) + 1
    if not len(back):
        return []
    table, row = origin[place[back[0]]]
    return [
        f"{tables[table].where(row)}: earlier than the row before ({len(back)} such rows): rows were sorted by their "
        "times; times of day alone do not tell one day, or summer time, from another"
    ]


def _described(rows: Rows, mapping: Mapping, source: str) -> dict[str, Any]:
    given = dict(mapping.session)
    content: dict[str, Any] = {"format": "mtcal-session/1", **rows.description}
    if (wanted := content.get("method", given.get("method"))) is None:
        how = "with --description session.yaml"
        raise SessionError(f"{source}: a table of readings needs the session.yaml that says of what, {how}")
    if given.get("method", wanted) != wanted:
        raise SessionError(f"{source}: this table makes a session of {wanted}; leave out method")
    if "machine" not in given:
        raise SessionError(f"{source}: the machine's chain is not given, as in --chain w-Y-X-b-Z-t")
    if "standard_uncertainty" not in given:
        what = "the standard uncertainty (k = 1) of a reading"
        raise SessionError(f"{source}: {what} is not given, as in --uncertainty 1.5um")
    if isinstance(given["standard_uncertainty"], str):
        value = quantity(given["standard_uncertainty"], "length", "standard uncertainty")
        given["standard_uncertainty"] = {"displacement": value}
    if "repeat" in rows.numbers and "repeats" not in content:
        content["repeats"] = int(np.nanmax(rows.numbers["repeat"], initial=0)) + 1
    if "setups" in content and (own := given.pop("setups", None)) is not None:
        content["setups"] = _merged(content["setups"], own, source)
    return {**content, **given}


def _merged(found: Any, own: Any, source: str) -> list[dict[str, Any]]:
    if not isinstance(own, list) or not all(isinstance(entry, dict) and "id" in entry for entry in own):
        raise SessionError(f"{source}: setups must be a list of entries with an id")
    said = {str(entry["id"]): entry for entry in own}
    if unknown := [name for name in said if name not in {entry["id"] for entry in found}]:
        raise SessionError(f"{source}: setups names {unknown[0]!r}, of which the table has no row")
    return [{**entry, **said.get(entry["id"], {})} for entry in found]
