# SPDX-License-Identifier: Apache-2.0
"""The smallest sizes of effects that a measurement shows, whatever it reads."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from machine_tool_calibration.arrays import Array, BoolArray
from machine_tool_calibration.diagnosis.search.candidates import Candidate, effect_candidates
from machine_tool_calibration.effects.effect import Coefficient, Effect
from machine_tool_calibration.estimation import priors
from machine_tool_calibration.model.effect_sizes import smallest_signal
from machine_tool_calibration.model.fit import JointFit
from machine_tool_calibration.residuals.pool import Pool

__all__ = ["POWER", "Detectable", "Visible", "detectable"]

POWER = 0.8
"""With which an effect of the smallest detectable size is found."""

# Share of a column's squared norm that the model must leave for the effect to be seen.
_SEEN = 1e-4
# Numbers in the columns of effects that are kept in memory at a time.
_HELD = 8_000_000


@dataclass(frozen=True)
class Visible:
    """The smallest size of an effect that a plan finds with a power of 80 %.

    Attributes:
        effect: its id.
        coefficient: the one of its coefficients that is seen best, the others being zero.
        size: smallest detectable size, in the unit; None if the model's own unknowns take the effect up.
        unit: SI.
        reading: largest change of a reading that this makes, m.
        occurs: whether so large a size can be.
    """

    effect: str
    coefficient: str
    size: float | None
    unit: str
    reading: float | None
    occurs: bool = True


@dataclass(frozen=True)
class Detectable:
    """What a measurement shows of effects.

    Attributes:
        visible: effects that it could show, the catalogue's order.
        absorbed: effects that the model takes up.
        excluded: effects that cannot act here, with the reason.
    """

    visible: tuple[Visible, ...]
    absorbed: tuple[str, ...]
    excluded: Mapping[str, str]


def detectable(
    joint: JointFit,
    effects: Sequence[Effect],
    *,
    progress: Callable[[str, float], object] = lambda what, share: None,
) -> Detectable:
    """The smallest sizes of effects that would be found, if the readings of a fit scatter as declared.

    Of the readings only where they are taken matters.
    """
    screened, excluded = _screened(Pool(joint), effects, progress)
    needed = float(np.log(max(len(screened), 1.0 / priors.EFFECT)))
    visible, absorbed = [], []
    for candidate in screened:
        best = candidate.smallest(needed)
        if best is None:
            absorbed.append(candidate.effect)
        else:
            visible.append(best)
    return Detectable(tuple(visible), tuple(absorbed), excluded)


@dataclass(frozen=True)
class _Screened:
    """What a model leaves of a candidate's columns.

    Attributes:
        effect: its id.
        count: sets of nonlinear coefficients over which its prior is spread.
        blocks: for each set of nonlinear coefficients the coefficients, and of each one's column the squared norm
            outside the model, whether that is seen at all, and the largest change of a reading.
    """

    effect: str
    count: int
    blocks: tuple[tuple[Sequence[Coefficient], Array, BoolArray, Array], ...]

    def smallest(self, needed: float) -> Visible | None:
        """The coefficient that is seen best, and its smallest size; None if none is seen."""
        best: Visible | None = None
        for named, inner, seen, largest in self.blocks:
            strength = inner * np.array([max(abs(c.low), abs(c.high)) / 2.0 for c in named]) ** 2
            for k in np.flatnonzero(seen).tolist():
                signal = smallest_signal(strength[seen], float(strength[k]), needed + np.log(self.count), POWER)
                size = float(signal / np.sqrt(inner[k]))
                reading = size * float(largest[k])
                if best is None or best.reading is None or reading < best.reading:
                    occurs = size <= max(abs(named[k].low), abs(named[k].high))
                    best = Visible(self.effect, named[k].name, size, named[k].unit, reading, occurs)
        return best


def _screened(
    pool: Pool, effects: Sequence[Effect], progress: Callable[[str, float], object]
) -> tuple[list[_Screened], dict[str, str]]:
    """Every effect that can act, and why the others cannot; as many in one pass as fit into memory."""
    found: list[_Screened] = []
    excluded: dict[str, str] = {}
    waiting: list[Candidate] = []
    for number, effect in enumerate(effects, 1):
        progress("effects that would show", number / len(effects))
        candidates, without = effect_candidates(pool, [effect])
        excluded |= without
        waiting += candidates
        held = sum(block.columns.size for candidate in waiting for block in candidate.shapes)
        if waiting and (held > _HELD or number == len(effects)):
            found += _outside(pool, waiting)
            waiting = []
    return found, excluded


def _outside(pool: Pool, candidates: Sequence[Candidate]) -> list[_Screened]:
    """The columns outside the model, in one pass: the model is the same for all."""
    stacked = [block.columns for candidate in candidates for block in candidate.shapes]
    projected = pool.screen(np.concatenate(stacked), random=True)
    inner = np.diag(projected.gram)[:-1]
    seen = np.asarray(inner > _SEEN * projected.squares[:-1])
    ends = np.cumsum([len(columns) for columns in stacked])[:-1]
    largest = (np.abs(columns).max(axis=1) for columns in stacked)
    each = zip(np.split(inner, ends), np.split(seen, ends), largest, strict=True)
    return [
        _Screened(found.name, found.count, tuple((block.coefficients, *next(each)) for block in found.shapes))
        for found in candidates
    ]
