"""A session folder to a session in memory."""

from __future__ import annotations

from pathlib import Path

from machine_tool_calibration.errors import SessionError
from machine_tool_calibration.session.assemble import assemble
from machine_tool_calibration.session.checks import check_session
from machine_tool_calibration.session.parse import parse_description
from machine_tool_calibration.session.place import Place
from machine_tool_calibration.session.required import require_columns
from machine_tool_calibration.session.session import Session
from machine_tool_calibration.session.table import read_table
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
    place = Place(str(described), str(observed), table.layout.line)
    session = Session(description, assemble(description, table.numbers, table.labels, place), source=str(folder))
    if check:
        check_session(session, place)
    return session
