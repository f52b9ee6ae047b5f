# SPDX-License-Identifier: Apache-2.0
"""Tables of the readings of any method, with columns and units of their own: what they are of, a session.yaml says."""

from __future__ import annotations

import numpy as np

from machine_tool_calibration.errors import SessionError
from machine_tool_calibration.importing.columns import Columns, Rows
from machine_tool_calibration.importing.mapping import ROLES

__all__ = ["reading_rows"]

_LABELS = tuple(role for role, kind in ROLES["readings"].items() if kind == "text" and role != "setup")


def reading_rows(columns: Columns, name: str) -> Rows:
    """The readings of a table: its columns named as quantities, and others that the mapping names.

    Args:
        columns: the table.
        name: of the one setup, where no column names it and the session has no setups.

    Raises:
        SessionError: no reading, a cell that is no number, a unit that is not given, or no setup.
    """
    columns.take_namesakes()
    columns.need(["displacement"], "the reading")
    setups = columns.mapping.session.get("setups")
    ids = [str(entry.get("id")) for entry in setups if isinstance(entry, dict)] if isinstance(setups, list) else []
    if len(ids) > 1 and not columns.has("setup"):
        which = f"which of the setups {', '.join(ids)} a reading is of"
        raise SessionError(f"{columns.table.source}: no column says {which}")
    labels = {role: columns.text(role) for role in _LABELS if columns.has(role)}
    return Rows(
        numbers=columns.others(()),
        labels={"setup": columns.setups(ids[0] if ids else name), **labels},
        row=np.arange(len(columns.table)),
        description={},
    )
