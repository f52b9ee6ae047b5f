# SPDX-License-Identifier: Apache-2.0
"""The same measurement as if it had been made once more."""

from dataclasses import replace
from pathlib import Path

from machine_tool_calibration.session.folder import read_session, write_session


def measured_again(first: Path | str, folder: Path) -> Path:
    """A session with the readings of another, each a hundredth of a nanometre longer, in a new folder."""
    session = read_session(Path(first))
    readings = replace(session.readings, displacement=session.readings.displacement + 1e-11)
    write_session(session.with_readings(readings), folder)
    return folder
