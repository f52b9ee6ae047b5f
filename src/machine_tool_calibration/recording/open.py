# SPDX-License-Identifier: Apache-2.0
"""A measurement, whatever form it has: a session folder or a recording."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from machine_tool_calibration.errors import SessionError
from machine_tool_calibration.session import DESCRIPTION_FILE, OBSERVATIONS_FILE

if TYPE_CHECKING:
    from machine_tool_calibration.session.session import Session


def open_measurement(path: Path, topics: Mapping[str, str] | None = None, *, check: bool = True) -> Session:
    """The session in a session folder, a rosbag2 folder or `.mcap` file; a SessionError says what is wrong and where.

    Of a recording, `topics` has the names of topics by role (`session`, `reading`) where they are others. With `check`
    also what is readable but not enough for the method is refused.
    """
    # here, because the history of a session is read without the libraries that tables of readings need
    from machine_tool_calibration.session.folder import read_session

    path = Path(path)
    try:
        path.stat()
    except (FileNotFoundError, NotADirectoryError, ValueError):  # the last one of a name that cannot be
        raise SessionError(f"{path}: no such file or folder") from None
    except OSError as error:
        raise SessionError(f"{path}: {error.strerror}") from None
    if is_session_folder(path):
        return read_session(path, check=check)
    if path.is_file() and path.name in (DESCRIPTION_FILE, OBSERVATIONS_FILE):
        return read_session(path.parent, check=check)
    # here, because a session folder needs none of the recording's libraries
    from machine_tool_calibration.recording.reader import is_bag
    from machine_tool_calibration.recording.session_bag import session_from_bag

    if is_bag(path):
        return session_from_bag(path, topics, check=check)
    if path.is_dir():
        within = next((one for one in sorted(path.iterdir()) if is_session_folder(one)), None)
        raise SessionError(
            f"{path}: neither a session ({DESCRIPTION_FILE}, {OBSERVATIONS_FILE}) nor a recording "
            f"(metadata.yaml, .mcap) is in this folder{f', but a session in {within}' if within else ''}"
        )
    raise SessionError(f"{path}: is neither a session folder nor a recording (.mcap)")


def is_session_folder(path: Path) -> bool:
    """Whether a folder holds a session, or half of one."""
    return path.is_dir() and ((path / DESCRIPTION_FILE).exists() or (path / OBSERVATIONS_FILE).exists())
