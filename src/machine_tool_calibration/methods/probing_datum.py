"""Datum of the probing self-calibration: the paper's eleven conditions, put where the touches can carry them.

Eqs. (16)(17) fix what no touch can tell: the origin and direction of the tables, of C and of the workpiece, and the
absolute length. They are necessary, not sufficient: a table node that no touch reaches stays undetermined, and a
condition that sits on such a node fixes only that node, so that the direction or the length that it was meant to fix
would be lost for everything. Each condition therefore has a list of places, the paper's first, and is put where most
of the unknowns become determined.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from machine_tool_calibration.arrays import Array, BoolArray
from machine_tool_calibration.methods.probing_null import SHARE, NullSpace

__all__ = ["Condition", "Place", "choose_places"]

_SWEEPS = 4
# A direction is counted from the outermost place at which what it fixes is at most so much less certain than at the
# best place: a node that is hardly reached would pass its uncertainty on to everything.
_WORSE = 3.0


@dataclass(frozen=True)
class Place:
    """Where a condition may be put: the weighted sum of unknowns that gets a value.

    Attributes:
        weights: by the unknown's name.
        value: of the sum, m or rad.
        words: for the datum's description, such as `EYX(0.11) = 0`.
        is_measured: whether the value is a measurement, so that it is not to be moved for convenience.
    """

    weights: Mapping[str, float]
    value: float
    words: str
    is_measured: bool = False


@dataclass(frozen=True)
class Condition:
    """One condition of the datum.

    Attributes:
        places: where it may be put, in the order of preference.
        is_far: whether it belongs far from the axis's zero, as those for a direction or the length.
    """

    places: tuple[Place, ...]
    is_far: bool = False


def choose_places(null: NullSpace, conditions: Sequence[Condition]) -> list[Place | None]:
    """Where each condition is put: as in the paper, unless another place leaves fewer unknowns undetermined.

    A condition that fixes nothing but the unknown on which it sits says nothing of the machine and is left out (None):
    with a disc on the table ECC has no effect at all, and zero at the first index would be no knowledge.
    """
    search = _Search(null, conditions)
    choice = search.best()
    choice = search.steadier(choice)
    return [None if search.is_idle(choice, i) else c.places[choice[i]] for i, c in enumerate(conditions)]


class _Search:
    """Places of the conditions by their numbers."""

    def __init__(self, null: NullSpace, conditions: Sequence[Condition]) -> None:
        self.null = null
        self.conditions = conditions
        self.rows = [[null.weights(place.weights) for place in condition.places] for condition in conditions]

    def stack(self, choice: Sequence[int], without: int = -1) -> Array:
        """(c, K) the chosen rows."""
        picked = [rows[k] for i, (rows, k) in enumerate(zip(self.rows, choice, strict=True)) if i != without]
        return np.array(picked).reshape(-1, len(self.null.names))

    def score(self, choice: Sequence[int]) -> tuple[int, float]:
        """Number of unknowns that are determined; and how little the others are tied to each other.

        The second counts where two conditions must move before anything more is determined.
        """
        free = self.null.free(self.stack(choice))
        share = np.linalg.norm(free, axis=1)
        return int((share < SHARE).sum()), round(-float(share.sum()), 6)

    def best(self) -> list[int]:
        """The choice that determines most unknowns; the paper's if none is better."""
        paper = [0] * len(self.rows)
        return paper if self.score(paper)[0] == len(self.null.basis) else self._climb(paper)

    def _climb(self, choice: list[int]) -> list[int]:
        """Move one condition at a time while that helps; from random starts this never found better on real plans."""
        best = self.score(choice)
        for _ in range(_SWEEPS):
            before = best
            for index in range(len(self.rows)):
                for trial in self._moves(choice, index):
                    if (value := self.score(trial)) > best:
                        best, choice = value, trial
            if best == before:
                break
        return choice

    def _moves(self, choice: list[int], index: int) -> Iterator[list[int]]:
        for k in range(len(self.rows[index])):
            if k != choice[index]:
                yield [*choice[:index], k, *choice[index + 1 :]]

    def steadier(self, choice: list[int]) -> list[int]:
        """Move directions and a length that was not measured off nodes that are hardly reached."""
        score = self.score(choice)[0]
        for index, condition in enumerate(self.conditions):
            if not condition.is_far or condition.places[choice[index]].is_measured:
                continue
            fixed = self._fixed_by(choice, index)
            if not fixed.any():
                continue
            places = [k for k, place in enumerate(condition.places) if not place.is_measured]
            trials = [[*choice[:index], k, *choice[index + 1 :]] for k in places]
            trials = [trial for trial in trials if self.score(trial)[0] == score]
            spread = [float(np.median(self.null.uncertainty(self.stack(trial))[fixed])) for trial in trials]
            choice = next(t for t, s in zip(trials, spread, strict=True) if s <= _WORSE * min(spread))
        return choice

    def _fixed_by(self, choice: list[int], index: int) -> BoolArray:
        """(K + N,) which unknowns one condition determines."""
        return self.null.determined(self.stack(choice)) & ~self.null.determined(self.stack(choice, without=index))

    def is_idle(self, choice: list[int], index: int) -> bool:
        """Whether a condition determines nothing but the unknowns on which it sits."""
        fixed = np.flatnonzero(self._fixed_by(choice, index))
        sits = np.flatnonzero(self.rows[index][choice[index]])
        return set(fixed.tolist()) <= set(sits.tolist())
