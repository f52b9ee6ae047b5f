# SPDX-License-Identifier: Apache-2.0
"""What a session holds, in figures."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from machine_tool_calibration.errors import SessionError
from machine_tool_calibration.session.catalogue import spec_of
from machine_tool_calibration.session.checks import check_session
from machine_tool_calibration.session.checks.suspicion import suspicions
from machine_tool_calibration.session.session import Session


@dataclass(frozen=True)
class SetupSummary:
    """One setup: how many readings and repetitions it has, and when it was measured (s)."""

    id: str
    readings: int
    missing: int
    repeats: int
    first_time: float | None
    last_time: float | None


@dataclass(frozen=True)
class ColumnSummary:
    """One numeric column: its range, and in how many rows it is missing."""

    name: str
    low: float | None
    high: float | None
    missing: int


@dataclass(frozen=True)
class SessionSummary:
    """A session in figures."""

    method: str  # the measuring method
    readings: int  # rows
    missing: int  # rows without a displacement
    duration: float | None  # from the first to the last reading, s; None without times
    standard_uncertainty: float  # declared, of one reading, m
    targets: int  # positions, or points of the workpiece, that were measured
    setups: tuple[SetupSummary, ...]  # each setup
    columns: tuple[ColumnSummary, ...]  # each numeric column
    labels: tuple[str, ...]  # text columns
    suspicious: tuple[str, ...]  # what can be used and a measurement hardly gives
    problem: str | None  # why the session cannot be identified as it is; None if nothing is wrong


def summarize(session: Session) -> SessionSummary:
    """The session in figures; a session that is not enough for its method is summarized too."""
    readings = session.readings
    missing = ~np.isfinite(readings.displacement)
    time = readings.columns.get("time")
    try:
        check_session(session)
        problem = None
    except SessionError as error:
        problem = str(error)
    first, last = _range(time)
    columns = {**readings.columns, "displacement": readings.displacement}
    return SessionSummary(
        method=session.method,
        readings=len(readings),
        missing=int(np.count_nonzero(missing)),
        duration=None if first is None or last is None else last - first,
        standard_uncertainty=session.sigma,
        targets=_targets(session),
        setups=tuple(_setup(session, index, missing, time) for index in range(len(session.setup_ids))),
        columns=tuple(
            ColumnSummary(name, *_range(values), int(np.count_nonzero(np.isnan(values))))
            for name, values in columns.items()
        ),
        labels=tuple(readings.labels),
        suspicious=tuple(suspicions([session])),
        problem=problem,
    )


def _setup(session: Session, index: int, missing: Any, time: Any) -> SetupSummary:
    mine = session.readings.setup == index
    first, last = _range(None if time is None else time[mine])
    counts = int(np.count_nonzero(mine)), int(np.count_nonzero(mine & missing))
    return SetupSummary(session.setup_ids[index], *counts, len(np.unique(session.readings.repeat[mine])), first, last)


def _range(values: Any) -> tuple[float | None, float | None]:
    if values is None or not np.isfinite(values).any():
        return None, None
    return float(np.nanmin(values)), float(np.nanmax(values))


def _targets(session: Session) -> int:
    readings = session.readings
    for label in ("point", "target"):
        if label in readings.labels and label in spec_of(session).columns(session.description):
            return len(np.unique(readings.labels[label]))
    return len(np.unique(np.round(readings.position(), 9), axis=0))
