# SPDX-License-Identifier: Apache-2.0
"""A measurement judged as a whole, and what was read held against what is stated."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np

from machine_tool_calibration.arrays import Array, BoolArray, IntArray
from machine_tool_calibration.session.session import Session

__all__ = ["GROSS", "Held", "Judgement", "Supposition"]

GROSS = 0.2
"""Share of a setup's readings up to which those that contradict are single gross errors, which are set aside."""


@dataclass(frozen=True)
class Supposition:
    """One mistake that may have been made.

    Attributes:
        what: the mistake in words.
        session: the measurement as it would be without it.
    """

    what: str
    session: Session


@dataclass(frozen=True)
class Judgement:
    """How a measurement is judged, and what may have gone wrong with it.

    Attributes:
        misfit: how badly a measurement fits.
        suppositions: mistakes that may have been made, the likeliest first; made on demand.
        absurd: misfit beyond which mistakes are looked for.
        good: what the misfit must be below without the mistake.
        better: the same as a share of the misfit as it is.
    """

    misfit: Callable[[Session], float]
    suppositions: Iterable[Supposition]
    absurd: float
    good: float
    better: float = 1.0


@dataclass(frozen=True)
class Held:
    """What was commanded or read, held against the stated geometry.

    Attributes:
        what: was held, such as `azimuth`.
        against: what the geometry says, in words.
        off: (n,) how far each reading is off it, m or rad; NaN where it says nothing.
        allowed: (n,) how far a machine and a survey may be off.
        unit: m, rad, or empty for what only agrees or not.
        share: of a group's readings up to which the contradicting ones are no contradiction.
        group: (n,) of each reading, such as its run; its setup if absent.
        label: column of labels by which the groups are called, such as `point`; by their setup if empty.
        hint: of a setup, what its readings say instead; may be empty.
    """

    what: str
    against: str
    off: Array
    allowed: Array
    unit: str = "m"
    share: float = GROSS
    group: IntArray | None = None
    label: str = ""
    hint: Callable[[int], str] = lambda setup: ""

    @property
    def bad(self) -> BoolArray:
        """(n,) readings that contradict."""
        return np.asarray(self.off > self.allowed)
