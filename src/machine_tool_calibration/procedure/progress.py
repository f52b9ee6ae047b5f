# SPDX-License-Identifier: Apache-2.0
"""Where a running procedure is: its state, its deadlines, what it waits for, and the readings that share a datum."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from enum import StrEnum

from machine_tool_calibration.procedure.events import Aim, Arrived, Captured, DatumSet, Motion
from machine_tool_calibration.procedure.steps import Step

__all__ = ["Counters", "DatumGroup", "Pending", "Phase", "State", "Timing", "Visit"]


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
    """How long to wait, in seconds of the wall clock, and how exactly the beam must point.

    Attributes:
        resend: a command without an answer is sent again after this.
        answer: a request to the instrument without an answer is sent again after this; longer than it takes to answer.
        patience: then an error is stated after this.
        paced: whether moves take as long as they say; not in simulated time.
        pointing_tolerance: greatest deviation of the beam's angles from the commanded ones, rad.
        revisits: after a lost beam, so many targets are measured again to find the new datum.
        wait_between_setups: pause before each new setup, so that the instrument can be moved.
    """

    resend: float = 1.0
    answer: float = 5.0
    patience: float = 15.0
    paced: bool = True
    pointing_tolerance: float = 1e-4
    revisits: int = 4
    wait_between_setups: bool = False


@dataclass
class Counters:
    """What did not go straight, for the status and the tests."""

    resent: int = 0
    stale: int = 0
    unstable: int = 0
    recoveries: int = 0
    restarts: int = 0


@dataclass
class Visit:
    """One stop at a target.

    Attributes:
        step: the target.
        datum: whether the path is zeroed here.
        revisit: reading that was taken here before the datum was lost, m; NaN for a reading that is still to come.
    """

    step: Step
    datum: bool
    revisit: float = math.nan


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
    reason: str = ""
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
    """Readings that share one datum.

    Attributes:
        datum: identity of the datum in force; empty if there is none.
        offset: added to the instrument's reading, so that it continues the group's first datum, m.
        taken: steps and readings so far.
        differences: old minus new reading of the targets that were measured again.
    """

    datum: str = ""
    offset: float = 0.0
    taken: list[tuple[Step, float]] = field(default_factory=list)
    differences: list[float] = field(default_factory=list)
