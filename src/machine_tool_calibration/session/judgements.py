# SPDX-License-Identifier: Apache-2.0
"""A measurement judged as a whole, and what was read held against what is stated."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np

from machine_tool_calibration.arrays import Array, BoolArray, IntArray
from machine_tool_calibration.session.session import Session

GROSS = 0.2
"""Share of a setup's readings up to which those that contradict are single gross errors, which are set aside."""


@dataclass(frozen=True)
class Supposition:
    """One mistake that may have been made."""

    what: str  # the mistake in words
    session: Session  # the measurement as it would be without it


@dataclass(frozen=True)
class Judgement:
    """How a measurement is judged, and what may have gone wrong with it."""

    misfit: Callable[[Session], float]  # how badly a measurement fits
    suppositions: Iterable[Supposition]  # mistakes that may have been made, the likeliest first; made on demand
    absurd: float  # misfit beyond which mistakes are looked for
    good: float  # what the misfit must be below without the mistake
    better: float = 1.0  # the same as a share of the misfit as it is


@dataclass(frozen=True)
class Held:
    """What was commanded or read, held against the stated geometry."""

    what: str  # was held, such as `azimuth`
    against: str  # what the geometry says, in words
    off: Array  # (n,) how far each reading is off it, m or rad; NaN where it says nothing
    allowed: Array  # (n,) how far a machine and a survey may be off
    unit: str = "m"  # m, rad, or empty for what only agrees or not
    share: float = GROSS  # of a group's readings up to which the contradicting ones are no contradiction
    group: IntArray | None = None  # (n,) of each reading, such as its run; its setup if absent
    label: str = ""  # column of labels by which the groups are called, such as `point`; by their setup if empty
    hint: Callable[[int], str] = lambda setup: ""  # of a setup, what its readings say instead; may be empty

    @property
    def bad(self) -> BoolArray:
        """(n,) readings that contradict."""
        return np.asarray(self.off > self.allowed)
