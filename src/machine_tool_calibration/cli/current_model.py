"""What `--from-history` means: the model, the effects and the readings of a session's current model."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from machine_tool_calibration.cli.output import note, session_labels
from machine_tool_calibration.errors import CalibrationError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from machine_tool_calibration.model.history import Entry
    from machine_tool_calibration.session.session import Session

__all__ = ["current_model", "current_models", "no_model"]


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
    entry, (kept,), (aside,) = current_models([session], [path])
    return entry, kept, aside


def current_models(
    sessions: Sequence[Session], paths: Sequence[Path]
) -> tuple[Entry, list[Session], list[NDArray[np.bool_]]]:
    """The same of one session or of several that are fitted together, in the order in which they are given.

    Raises:
        CalibrationError: no model was tried yet.
    """
    from machine_tool_calibration.session.history_file import fingerprint, history_path, read_history

    entry = read_history(history_path(*paths)).in_use
    if entry is None:
        raise no_model(paths)
    if entry.data != fingerprint(*sessions):
        note(f"the readings have changed since model {entry.number} was made of them")
    rows = [entry.set_aside]
    if len(sessions) > 1:
        by_data = {part.data: part.set_aside for part in entry.sessions}
        by_label = {part.label: part.set_aside for part in entry.sessions}
        labels = session_labels(paths)
        rows = [
            by_data.get(fingerprint(session), by_label.get(label, ()))
            for session, label in zip(sessions, labels, strict=True)
        ]
    asides = [np.isin(session.readings.row, own) for session, own in zip(sessions, rows, strict=True)]
    kept = [
        session.with_readings(session.readings.select(~aside)) if aside.any() else session
        for session, aside in zip(sessions, asides, strict=True)
    ]
    return entry, kept, asides


def no_model(paths: Sequence[Path]) -> CalibrationError:
    """That no model was tried yet, and what begins."""
    named = " ".join(str(path) for path in paths)
    return CalibrationError(f"{named}: no model was tried yet; `mtcal improve {named}` begins")
