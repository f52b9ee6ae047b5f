# SPDX-License-Identifier: Apache-2.0
"""A paper's figures beside ours, and the papers that are done anew, by the method that each describes."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from importlib import import_module
from pkgutil import iter_modules
from typing import Any

from machine_tool_calibration import validation
from machine_tool_calibration.errors import CalibrationError, did_you_mean

__all__ = ["Printed", "Study", "study", "study_names"]


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

    def document(self) -> dict[str, Any]:
        """For programs."""
        return {
            "what": self.what,
            "where": self.where,
            "paper": self.paper,
            "at_most": self.at_most,
            "ours": self.ours,
            "unit": self.unit,
            "within": self.within,
            "agrees": self.agrees,
            "why": self.why,
        }


@dataclass(frozen=True)
class Study:
    """What was done anew of one paper.

    Attributes:
        id: short name.
        paper: authors, title, journal, year.
        assumptions: what the paper does not print and was assumed here; each a sentence.
        printed: its figures beside ours, in the paper's order.
        pictures: what its pictures show, by file name: records that `plots.validation` draws.
    """

    id: str
    paper: str
    assumptions: tuple[str, ...]
    printed: tuple[Printed, ...]
    pictures: Mapping[str, Any] = field(default_factory=dict)

    def document(self) -> dict[str, Any]:
        """For programs."""
        return {
            "id": self.id,
            "paper": self.paper,
            "assumptions": list(self.assumptions),
            "figures": [entry.document() for entry in self.printed],
        }


_FIRST = "study_"


def study_names() -> list[str]:
    """Names of all studies: those of the modules `study_NAME`."""
    return sorted(m.name.removeprefix(_FIRST) for m in iter_modules(validation.__path__) if m.name.startswith(_FIRST))


def study(name: str, progress: Callable[[str, float], None] = lambda what, share: None) -> Study:
    """Do a paper's calculations and simulations anew.

    Args:
        name: of the study.
        progress: called with what is being done and the share that is finished.

    Raises:
        CalibrationError: there is no such study.
    """
    names = study_names()
    if name not in names:
        raise CalibrationError(f"no study {name!r}{did_you_mean(name, names)}; there are {', '.join(names)}")
    made: Study = import_module(f"{validation.__name__}.{_FIRST}{name}").study(progress)
    return made
