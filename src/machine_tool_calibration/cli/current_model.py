"""What `--from-history` means: the model, the effects and the readings of a session's current model."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from machine_tool_calibration.cli.output import note
from machine_tool_calibration.errors import CalibrationError

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from machine_tool_calibration.model.history import Entry
    from machine_tool_calibration.session.session import Session

__all__ = ["current_model"]


def current_model(session: Session, path: Path) -> tuple[Entry, Session, NDArray[np.bool_]]:
    """The model in use of a session, its readings without those that were set aside, and which those are.

    Args:
        session: as it was read.
        path: where it was read; the history is in it or beside it.

    Returns:
        The entry of the history, the session to fit, and for each reading whether it is left out.

    Raises:
        CalibrationError: no model was tried yet.
    """
    from machine_tool_calibration.session.history_file import fingerprint, history_path, read_history

    entry = read_history(history_path(path)).in_use
    if entry is None:
        raise CalibrationError(f"{path}: no model was tried yet; `mtcal improve {path}` begins")
    if entry.data != fingerprint(session):
        note(f"the readings have changed since model {entry.number} was made of them")
    aside = np.isin(session.readings.row, entry.set_aside)
    kept = session.with_readings(session.readings.select(~aside)) if aside.any() else session
    return entry, kept, aside
