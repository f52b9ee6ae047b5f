"""What `mtcal improve` keeps: models in the history, pictures and numbers in a folder; and what it says of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING

from machine_tool_calibration.errors import SessionError

if TYPE_CHECKING:
    from machine_tool_calibration.methods.improve import Improvement
    from machine_tool_calibration.model.history import History
    from machine_tool_calibration.session.session import Session

__all__ = ["Kept", "draw", "keep"]


@dataclass(frozen=True)
class Kept:
    """What became of the history.

    Attributes:
        written: the file, if it was changed.
        words: a remark.
        failure: why it could not be written.
    """

    written: tuple[Path, ...] = ()
    words: str = ""
    failure: str = ""


def keep(done: Improvement, sessions: Sequence[Session], path: Path) -> Kept:
    """Put the models into the history; a failure is told, and loses nothing else.

    Args:
        done: what was done.
        sessions: of which readings.
        path: the history's file.
    """
    from machine_tool_calibration.methods.improve import entries
    from machine_tool_calibration.session.history_file import fingerprint, update_history

    prints = [fingerprint(session) for session in sessions]
    made = entries(done, fingerprint(*sessions), prints, datetime.now(UTC).isoformat(timespec="seconds"), "improve")
    before: list[History] = []

    def grown(old: History) -> History:
        before.append(old)
        return old.grown(made)

    try:
        new = update_history(path, grown)
    except SessionError as error:
        return Kept(failure=f"{error}; the models are not kept (--no-history does without)")
    old = before[-1]
    if new == old:
        return Kept(words=f"{path} holds these models already: unchanged, model {new.current} is the current one")
    if len(new.models) == len(old.models):
        return Kept((path,), f"no new model in the history; model {new.current} is the current one now")
    return Kept((path,))


def draw(done: Improvement, folder: Path) -> tuple[list[Path], str]:
    """Write pictures and numbers.

    Returns:
        The files, or why they could not be written.
    """
    from machine_tool_calibration.plots.improve import save_improvement

    try:
        return save_improvement(done, folder), ""
    except OSError as error:
        return [], f"{error.filename or folder}: cannot be written: {error.strerror}; -o names another folder"
