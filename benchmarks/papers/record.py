# SPDX-License-Identifier: Apache-2.0
"""A paper's figures beside ours."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

__all__ = ["Printed", "Study"]


@dataclass(frozen=True)
class Printed:
    """One figure that a paper prints.

    Attributes:
        what: the quantity, in words.
        where: in the paper: Table 1, Fig. 14, Eq. (7), …
        paper: as printed, in the unit; None where the paper shows it in a picture only or says it in words.
        ours: in the unit; None where it cannot be had.
        unit: SI.
        within: how far apart they may be to count as equal, in the unit: what the paper rounds, and our own chance.
        why: where they differ, the reason; where they agree, what is worth knowing.
        at_most: whether the paper gives an upper limit.
    """

    what: str
    where: str
    paper: float | None
    ours: float | None
    unit: str
    within: float = 0.0
    why: str = ""
    at_most: bool = False

    @property
    def agrees(self) -> bool | None:
        """Whether they are the same; None where there is nothing to hold against each other."""
        if self.paper is None or self.ours is None:
            return None
        off = self.ours - self.paper
        return (off if self.at_most else abs(off)) <= self.within


@dataclass(frozen=True)
class Study:
    """What was reproduced of one paper.

    Attributes:
        id: short name.
        paper: authors, title, journal, year.
        assumptions: what the paper does not print and was assumed here; each a sentence.
        printed: its figures beside ours, in the paper's order.
        pictures: what its pictures show, by file name: records that `papers.pictures` draws.
    """

    id: str
    paper: str
    assumptions: tuple[str, ...]
    printed: tuple[Printed, ...]
    pictures: Mapping[str, Any] = field(default_factory=dict)
