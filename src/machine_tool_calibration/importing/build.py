"""A foreign table and its mapping to a session in memory."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from machine_tool_calibration.arrays import IntArray
from machine_tool_calibration.errors import SessionError
from machine_tool_calibration.importing.columns import Columns, Rows
from machine_tool_calibration.importing.mapping import Mapping
from machine_tool_calibration.importing.points import point_rows
from machine_tool_calibration.importing.positioning import positioning_rows
from machine_tool_calibration.importing.ranges import range_rows
from machine_tool_calibration.importing.text_table import TextTable, read_text_table
from machine_tool_calibration.importing.units import quantity
from machine_tool_calibration.methods.direct.model import asked_tables
from machine_tool_calibration.session.checks import check_session
from machine_tool_calibration.session.columns import require_columns
from machine_tool_calibration.session.description import Direct, Place
from machine_tool_calibration.session.parse import describe
from machine_tool_calibration.session.session import Session, assemble

__all__ = ["Imported", "import_table"]


@dataclass(frozen=True)
class Imported:
    """A session made from a table.

    Attributes:
        session: the measurement.
        columns: what was read, by quantity: the column's name and its unit.
        rows: number of rows in the table.
        notes: what was done that the user should know.
    """

    session: Session
    columns: dict[str, tuple[str, str]]
    rows: int
    notes: tuple[str, ...]


@dataclass(frozen=True)
class _TablePlace(Place):
    """Messages name the line of the foreign file."""

    table: TextTable | None = None
    origin: IntArray | None = None

    def row(self, row: int) -> str:
        assert self.table is not None and self.origin is not None
        return self.table.where(int(self.origin[row]))


def import_table(path: Path, mapping: Mapping, *, name: str | None = None) -> Imported:
    """Read a foreign table as a session.

    Args:
        path: a text file of rows and columns.
        mapping: what its columns mean, and what the session says beside them.
        name: id of the setup, where no column names it; by default the file's name without its ending.

    Raises:
        SessionError: one line that says what is wrong, with file and line; also what cannot be right or is not enough
            for the method.
        ModelError: a machine error that is none of the machine's.
    """
    table = read_text_table(path, mapping.file)
    columns = Columns(table, mapping)
    setup = name or path.stem.strip() or "table"
    rows = {
        "points": lambda: point_rows(columns, setup),
        "ranges": lambda: range_rows(columns),
        "iso230-2": lambda: positioning_rows(columns, setup),
    }[mapping.table]()
    described = _described(rows, mapping, table.source)
    description = describe(described, f"{table.source}: session")
    place = _TablePlace(f"{table.source}: session", table.source, None, table, rows.row)
    require_columns(description, [*rows.numbers, *rows.labels], table.source)
    readings = assemble(description, rows.numbers, rows.labels, place)
    session = Session(description, readings, source=str(path))
    check_session(session, place)
    if isinstance(description, Direct):  # a misspelt error would be met at the identification only
        asked_tables(description.machine.kinematics, description.terms, readings.position())
    notes = list(rows.notes)
    missing = int(np.count_nonzero(~np.isfinite(readings.displacement)))
    if missing:
        notes.append(f"{missing} of {len(readings)} readings are empty cells: kept as missing")
    if isinstance(description, Direct) and not description.terms:
        notes.append(
            "no machine errors are named; without terms, as in --term EXX, nothing of the machine is identified"
        )
    return Imported(session, columns.read, len(table), tuple(notes))


def _described(rows: Rows, mapping: Mapping, source: str) -> dict[str, Any]:
    """The content of session.yaml: what the table gives, and over it what the user says."""
    given = dict(mapping.session)
    content: dict[str, Any] = {"format": "mtcal-session/1", **rows.description}
    wanted = str(content["method"])
    if given.pop("method", wanted) != wanted:
        raise SessionError(f"{source}: this table makes a session of {wanted}; leave out method")
    if "machine" not in given:
        raise SessionError(f"{source}: the machine's chain is not given, as in --chain w-Y-X-b-Z-t")
    if "standard_uncertainty" not in given:
        raise SessionError(
            f"{source}: the standard uncertainty (k = 1) of a reading is not given, as in --uncertainty 1.5um"
        )
    if isinstance(given["standard_uncertainty"], str):
        value = quantity(given["standard_uncertainty"], "length", "standard uncertainty")
        given["standard_uncertainty"] = {"displacement": value}
    if "repeat" in rows.numbers and "repeats" not in content:
        content["repeats"] = int(np.nanmax(rows.numbers["repeat"], initial=0)) + 1
    own = given.pop("setups", None)
    if own is not None:
        content["setups"] = _merged(content["setups"], own, source)
    return {**content, **given}


def _merged(found: Any, own: Any, source: str) -> list[dict[str, Any]]:
    """Setups of the table with what the user says of them, by id."""
    if not isinstance(own, list) or not all(isinstance(entry, dict) and "id" in entry for entry in own):
        raise SessionError(f"{source}: setups must be a list of entries with an id")
    said = {str(entry["id"]): entry for entry in own}
    unknown = [name for name in said if name not in {entry["id"] for entry in found}]
    if unknown:
        raise SessionError(f"{source}: setups names {unknown[0]!r}, of which the table has no row")
    return [{**entry, **said.get(entry["id"], {})} for entry in found]
