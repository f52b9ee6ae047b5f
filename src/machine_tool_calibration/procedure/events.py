# SPDX-License-Identifier: Apache-2.0
"""A running procedure: what it hears, what it asks, and where it is; times are whole ns of the graph's clock."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import NamedTuple

from machine_tool_calibration.procedure.steps import Step


class State(StrEnum):
    """What the procedure is doing as a whole."""

    IDLE = "idle"
    RUNNING = "running"
    PAUSED = "paused"
    FINISHED = "finished"
    ABORTED = "aborted"
    ERROR = "error"


class Phase(StrEnum):
    """What the current step waits for."""

    NONE = "none"
    MOVE = "move"
    DATUM = "datum"
    CAPTURE = "capture"


@dataclass(frozen=True)
class Timing:
    """How long to wait, in seconds of the wall clock, and how exactly the beam must point."""

    resend: float = 1.0  # a command without an answer is sent again after this
    # a request to the instrument without an answer is sent again after this; longer than it takes to answer
    answer: float = 5.0
    patience: float = 15.0  # then an error is stated after this
    paced: bool = True  # whether moves take as long as they say; not in simulated time
    pointing_tolerance: float = 1e-4  # greatest deviation of the beam's angles from the commanded ones, rad
    revisits: int = 4  # after a lost beam, so many targets are measured again to find the new datum
    wait_between_setups: bool = False  # pause before each new setup, so that the instrument can be moved
    wait_every: int = 0  # pause in a setup after so many readings too, to decide whether they are enough; 0: never


COUNTERS = ("resent", "stale", "unstable", "recoveries", "restarts")
"""What did not go straight, and is counted."""


@dataclass
class Visit:
    """One stop at a target."""

    step: Step  # the target
    datum: bool  # whether the path is zeroed here
    revisit: float = math.nan  # reading taken here before the datum was lost, m; NaN of one still to come


@dataclass
class Pending:
    """Answers that the current phase waits for.

    A request that was sent again, because its answer was late, has several tokens: `first` to `token`; whichever of
    them is answered counts. `zeroing` is the first token of the datum that was asked for at this place.
    """

    phase: Phase = Phase.NONE
    motion: Motion | None = None
    aim: Aim | None = None
    angles: tuple[float, float] = (0.0, 0.0)
    arrived: Arrived | None = None
    aimed: int | None = None
    token: int = -1
    first: int = -1
    zeroing: int = -1
    reason: str = ""  # why the instrument gives no reading now; empty if it has not said
    stale: int = 0
    since: float = 0.0
    sent: float = 0.0
    expected: float = 0.0

    def is_asked(self, token: int) -> bool:
        """Whether an answer belongs to the present request, as it was first sent or repeated."""
        return self.first <= token <= self.token

    def is_stale(self, event: Captured | DatumSet) -> bool:
        """Whether the reading began before the axes and the beam were at rest, or does not know it yet."""
        assert self.motion is not None and self.arrived is not None
        ready = max(self.arrived.arrived, self.aimed or 0)
        return event.start < ready or any(stamp < self.motion.stamp for stamp in event.inputs.values())


@dataclass
class DatumGroup:
    """Readings that share one datum."""

    datum: str = ""  # identity of the datum in force; empty if there is none
    offset: float = 0.0  # added to the instrument's reading, so that it continues the group's first datum, m
    taken: list[tuple[Step, float]] = field(default_factory=list)  # steps and readings so far
    differences: list[float] = field(default_factory=list)  # old minus new reading of targets measured again


@dataclass(frozen=True)
class Arrived:
    """The axes stand at the end of a commanded motion."""

    command: int  # stamp of the command
    arrived: int  # since when they stand
    held: int  # until when that is known; later than `arrived` where simulated time has been advanced over the dwell
    epoch: str = ""  # identity of the axes' controller since its start; empty where it has none


@dataclass(frozen=True)
class MovedAway:
    """The axes are not where the last command brought them: another one commands them, or they were started anew."""

    stamp: int  # when it is so
    epoch: str = ""  # as of `Arrived`


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
    """A reading."""

    token: int  # of the request
    stamp: int  # middle of the averaged window
    start: int  # its beginning
    end: int  # its end
    displacement: float  # m, from the datum
    datum: str  # identity of that datum
    columns: Mapping[str, float] = field(default_factory=dict)  # the environment at that moment, by column name
    # newest simulated inputs that the reading used, by name; a real instrument has none
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
class Ask:
    """Ask the instrument to make the present path zero (`Phase.DATUM`), or to take a reading (`Phase.CAPTURE`)."""

    token: int
    phase: Phase


@dataclass(frozen=True)
class Emit:
    """A reading of the session: the time, and the numeric columns of `observations.csv` with the setup's number."""

    stamp: int
    columns: Mapping[str, float]


Event = Arrived | MovedAway | Refused | Aimed | Captured | CaptureFailed | DatumSet
Action = Motion | Stop | Aim | Ask | Emit
