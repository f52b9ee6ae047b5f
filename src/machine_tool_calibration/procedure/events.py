# SPDX-License-Identifier: Apache-2.0
"""What a running procedure hears from the instrument and the axes, and what it asks of them.

Times are whole nanoseconds of the graph's clock.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

__all__ = [
    "Action",
    "Aim",
    "Aimed",
    "Arrived",
    "Capture",
    "CaptureFailed",
    "Captured",
    "DatumSet",
    "Emit",
    "Event",
    "Motion",
    "MovedAway",
    "Refused",
    "SetDatum",
    "Stop",
    "Waypoint",
]


@dataclass(frozen=True)
class Arrived:
    """The axes stand at the end of a commanded motion.

    Attributes:
        command: stamp of the command.
        arrived: since when they stand.
        held: until when that is known; later than `arrived` where simulated time has been advanced over the dwell.
        epoch: identity of the axes' controller since its start; empty where it has none.
    """

    command: int
    arrived: int
    held: int
    epoch: str = ""


@dataclass(frozen=True)
class MovedAway:
    """The axes are not where the last command brought them: another one commands them, or they were started anew.

    Attributes:
        stamp: when it is so.
        epoch: as of `Arrived`.
    """

    stamp: int
    epoch: str = ""


@dataclass(frozen=True)
class Refused:
    """The axes refuse a command."""

    command: int
    reason: str


@dataclass(frozen=True)
class Aimed:
    """Where the pointer points: the setup, the angles in rad, and the time."""

    setup: str
    azimuth: float
    elevation: float
    stamp: int


@dataclass(frozen=True)
class Captured:
    """A reading.

    Attributes:
        token: of the request.
        stamp: middle of the averaged window.
        start: its beginning.
        end: its end.
        displacement: m, from the datum.
        datum: identity of that datum.
        columns: the environment at that moment, by column name.
        inputs: newest simulated inputs that the reading used, by name; a real instrument has none.
    """

    token: int
    stamp: int
    start: int
    end: int
    displacement: float
    datum: str
    columns: Mapping[str, float] = field(default_factory=dict)
    inputs: Mapping[str, int] = field(default_factory=dict)


@dataclass(frozen=True)
class CaptureFailed:
    """No reading, or no datum: `kind` is `unstable`, `beam`, `datum` or `other`."""

    token: int
    kind: str
    reason: str


@dataclass(frozen=True)
class DatumSet:
    """The present path is zero from now on; `datum` is its identity, the rest as for `Captured`."""

    token: int
    datum: str
    start: int
    inputs: Mapping[str, int] = field(default_factory=dict)


class Waypoint(NamedTuple):
    """Positions of the axes, m or rad, and the time from the start of the motion, s."""

    position: Mapping[str, float]
    time: float


@dataclass(frozen=True)
class Motion:
    """Move the axes along these points."""

    stamp: int
    points: tuple[Waypoint, ...]


@dataclass(frozen=True)
class Stop:
    """Stop the axes."""

    stamp: int


@dataclass(frozen=True)
class Aim:
    """Point from a setup's station at a point, m, machine frame."""

    stamp: int
    setup: str
    point: tuple[float, float, float]


@dataclass(frozen=True)
class SetDatum:
    """Make the present path zero."""

    token: int


@dataclass(frozen=True)
class Capture:
    """Take a reading."""

    token: int


@dataclass(frozen=True)
class Emit:
    """A reading of the session: the time, and the numeric columns of `observations.csv` with the setup's number."""

    stamp: int
    columns: Mapping[str, float]


Event = Arrived | MovedAway | Refused | Aimed | Captured | CaptureFailed | DatumSet
Action = Motion | Stop | Aim | SetDatum | Capture | Emit
