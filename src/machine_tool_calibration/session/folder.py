# SPDX-License-Identifier: Apache-2.0
"""A session folder: `session.yaml` and `observations.csv`, read and written."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from machine_tool_calibration.errors import SessionError
from machine_tool_calibration.files import whole
from machine_tool_calibration.session import DESCRIPTION_FILE, OBSERVATIONS_FILE
from machine_tool_calibration.session.catalogue import require_columns
from machine_tool_calibration.session.checks import check_session
from machine_tool_calibration.session.description import Place
from machine_tool_calibration.session.parse import description_yaml, parse_description
from machine_tool_calibration.session.session import Session, assemble
from machine_tool_calibration.session.table import NUMERIC_COLUMNS, read_table
from machine_tool_calibration.session.text import read_text

if TYPE_CHECKING:
    import pandas as pd


def read_session(path: Path, *, check: bool = True) -> Session:
    """Read a session folder: `session.yaml` and `observations.csv`.

    If `check`, also refuse what is readable but cannot be right or is not enough for the method (`check_session`).
    A SessionError says it in one line with file and row, line or key.
    """
    folder = Path(path)
    if not folder.is_dir():
        what = "is not a session folder" if folder.exists() else "no such file or folder"
        raise SessionError(f"{folder}: {what}")
    described, observed = folder / DESCRIPTION_FILE, folder / OBSERVATIONS_FILE
    for file in (described, observed):
        if not file.exists():
            raise SessionError(f"{folder}: no {file.name} in this folder; a session needs it")
    description = parse_description(read_text(described), str(described))
    table = read_table(observed)
    require_columns(description, {*table.numbers, *table.labels}, str(observed))
    place = Place(str(described), str(observed), table.layout.where)
    session = Session(description, assemble(description, table.numbers, table.labels, place), source=str(folder))
    if check:
        check_session(session, place)
    return session


_ORDER = ("time", "setup", "repeat", "target", "point", *NUMERIC_COLUMNS[2:])


def readings_frame(session: Session) -> pd.DataFrame:
    """The readings as a table with the columns of `observations.csv`, in the contract's order."""
    readings = session.readings
    columns: dict[str, np.ndarray] = {
        "setup": np.asarray(session.setup_ids, dtype=object)[readings.setup],
        "repeat": readings.repeat,
        "displacement": readings.displacement,
        **readings.recorded_columns,
        **readings.labels,
    }
    names = [name for name in _ORDER if name in columns] + [name for name in columns if name not in _ORDER]
    import pandas as pd  # here, because a small session is read without it

    return pd.DataFrame({name: columns[name] for name in names})


def write_session(session: Session, folder: Path, *, overwrite: bool = False) -> None:
    """Write a session folder, to the last bit; a SessionError: there is one (unless `overwrite`), or it cannot be."""
    from machine_tool_calibration.session.csv_text import write_csv

    folder = Path(folder)
    described, observed = folder / DESCRIPTION_FILE, folder / OBSERVATIONS_FILE
    if not overwrite and (described.exists() or observed.exists()):
        raise SessionError(f"{folder}: holds a session already; choose another folder")
    with whole(described, SessionError) as yaml, whole(observed, SessionError) as csv:
        yaml.write_text(description_yaml(session.description), encoding="utf-8")
        with csv.open("w", encoding="utf-8", newline="") as stream:
            write_csv(readings_frame(session), stream)
