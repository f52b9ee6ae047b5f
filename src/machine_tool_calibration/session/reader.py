"""A session folder to a session in memory."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from machine_tool_calibration.arrays import IntArray
from machine_tool_calibration.errors import SessionError
from machine_tool_calibration.session.checks import Place, check_session
from machine_tool_calibration.session.description import Description
from machine_tool_calibration.session.parse import parse_description
from machine_tool_calibration.session.required import require_columns
from machine_tool_calibration.session.session import Readings, Session
from machine_tool_calibration.session.table import Table, read_table
from machine_tool_calibration.session.text import read_text

__all__ = ["DESCRIPTION_FILE", "OBSERVATIONS_FILE", "parse_description", "read_session"]

DESCRIPTION_FILE = "session.yaml"
OBSERVATIONS_FILE = "observations.csv"
_LARGEST_DESCRIPTION = 16 << 20


def read_session(path: Path, *, check: bool = True) -> Session:
    """Read a session folder: `session.yaml` and `observations.csv`.

    Args:
        path: the folder.
        check: also refuse what is readable but cannot be right or is not enough for the method (`check_session`).

    Raises:
        SessionError: one line with file and row, line or key.
    """
    folder = Path(path)
    if not folder.is_dir():
        what = "is not a session folder" if folder.exists() else "no such file or folder"
        raise SessionError(f"{folder}: {what}")
    described, observed = folder / DESCRIPTION_FILE, folder / OBSERVATIONS_FILE
    for file in (described, observed):
        if not file.exists():
            raise SessionError(f"{folder}: no {file.name} in this folder; a session needs it")
    description = parse_description(read_text(described, _LARGEST_DESCRIPTION), str(described))
    table = read_table(observed)
    require_columns(description, table.layout.columns, str(observed))
    session = Session(description, _readings(description, table, str(described)), source=str(folder))
    if check:
        check_session(session, Place(str(described), str(observed), table.layout.line))
    return session


def _readings(description: Description, table: Table, described: str) -> Readings:
    numbers, labels = dict(table.numbers), dict(table.labels)
    setup = _index(table, "setup", [entry.id for entry in description.setups], described)
    for column, key in (("target", "targets"), ("point", "workpiece")):
        entries = getattr(description, key, None)
        if entries is not None and column in labels:
            _index(table, column, [entry.id for entry in entries], described)
    labels.pop("setup")
    repeat = numbers.pop("repeat", np.zeros(table.layout.rows))
    bad = np.flatnonzero(~((repeat >= 0) & (repeat == np.floor(repeat)) & (repeat < 1e9)))
    if len(bad):
        row = int(bad[0])
        raise SessionError(f"{table.layout.where(row)}: repeat is {repeat[row]:g}, not 0, 1, 2 …")
    return Readings(
        setup=setup,
        repeat=repeat.astype(np.int64),
        displacement=numbers.pop("displacement"),
        columns=numbers,
        labels=labels,
        row=np.arange(table.layout.rows, dtype=np.int64),
    )


def _index(table: Table, column: str, ids: list[str], described: str) -> IntArray:
    """Place of each label in the description's list."""
    places = {name: index for index, name in enumerate(ids)}
    unique, inverse = np.unique(table.labels[column], return_inverse=True)
    known = np.array([places.get(str(name), -1) for name in unique], dtype=np.int64)
    index = known[inverse]
    bad = np.flatnonzero(index < 0)
    if len(bad):
        row = int(bad[0])
        name = str(table.labels[column][row])
        what = f"unknown {column} {name!r}" if name else f"{column} is empty"
        raise SessionError(f"{table.layout.where(row)}: {what}; {Path(described).name} has {_listed(ids)}")
    return index


def _listed(ids: list[str]) -> str:
    numbers = [i for i in ids if re.fullmatch(r"\d+", i)]
    if len(ids) > 8 and len(numbers) == len(ids):
        return f"{ids[0]} to {ids[-1]}"
    return ", ".join(ids[:8]) + (f" … ({len(ids)} in all)" if len(ids) > 8 else "")
