"""A session in memory to a session folder."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pandas as pd

from machine_tool_calibration.errors import SessionError
from machine_tool_calibration.session.csv_text import write_csv
from machine_tool_calibration.session.parse import description_yaml
from machine_tool_calibration.session.session import Session
from machine_tool_calibration.session.table import NUMERIC_COLUMNS

__all__ = ["description_yaml", "readings_frame", "write_session"]

_ORDER = ("time", "setup", "repeat", "target", "point", *NUMERIC_COLUMNS[2:])


def readings_frame(session: Session) -> pd.DataFrame:
    """The readings as a table with the columns of `observations.csv`, in the contract's order."""
    readings = session.readings
    columns: dict[str, np.ndarray] = {
        "setup": np.asarray(session.setup_ids, dtype=object)[readings.setup],
        "repeat": readings.repeat,
        "displacement": readings.displacement,
        **readings.columns,
        **readings.labels,
    }
    names = [name for name in _ORDER if name in columns] + [name for name in columns if name not in _ORDER]
    return pd.DataFrame({name: columns[name] for name in names})


def write_session(session: Session, folder: Path, *, overwrite: bool = False) -> None:
    """Write `session.yaml` and `observations.csv`; numbers come back to the last bit.

    Args:
        session: the measurement.
        folder: made where it is missing.
        overwrite: replace a session that is already there.

    Raises:
        SessionError: a session is already there, or the folder cannot be written.
    """
    folder = Path(folder)
    described, observed = folder / "session.yaml", folder / "observations.csv"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        if not overwrite and (described.exists() or observed.exists()):
            raise SessionError(f"{folder}: holds a session already; choose another folder")
        # first beside the target, then renamed: a write that is cut short leaves what was there
        parts = [file.with_name(file.name + ".part") for file in (described, observed)]
        parts[0].write_text(description_yaml(session.description), encoding="utf-8")
        with parts[1].open("w", encoding="utf-8", newline="") as stream:
            write_csv(readings_frame(session), stream)
        for part, file in zip(parts, (described, observed), strict=True):
            os.replace(part, file)
    except OSError as error:
        raise SessionError(f"{folder}: cannot be written: {error.strerror}") from None
