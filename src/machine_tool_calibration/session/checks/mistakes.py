# SPDX-License-Identifier: Apache-2.0
"""Readings against nominal geometry: whether a common mistake is the better explanation.

The nominal geometry predicts every reading to about the uncertainty of the stations. Where it does not, and one
mistake (another unit, the other sense of rotation, two setups exchanged) explains the readings far better, that
mistake is named. Nothing is refused merely because it fits badly: that is for the model and its diagnosis.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from machine_tool_calibration.arrays import Array, IntArray, group_ranges
from machine_tool_calibration.errors import SessionError
from machine_tool_calibration.session.description import Place
from machine_tool_calibration.session.session import Readings, Session

__all__ = [
    "Comparison",
    "Mistake",
    "check_consistency",
    "exchanged",
    "exchanged_axes",
    "extent",
    "per_setup",
    "same",
    "scaled",
    "spread",
]


_MOST_TRIED = 12
_LIMIT = 0.1


@dataclass(frozen=True)
class Mistake:
    """One mistake that may have been made.

    Attributes:
        what: the suspicion, for the message.
        misfit: (setups,) what would remain if it was made, NaN for a setup without readings.
        scale: size of what is predicted, in the misfit's unit.
    """

    what: str
    misfit: Array
    scale: float


@dataclass(frozen=True)
class Comparison:
    """Readings against nominal geometry, as they are and under each mistake (made on demand)."""

    misfit: Array
    scale: float
    mistakes: Iterable[Mistake]


_SCALES = (
    (1e-3, "displacement looks like millimetres; lengths are in metres"),
    (1e-6, "displacement looks like micrometres; lengths are in metres"),
    (-1.0, "displacement has the opposite sign; it grows with the path from the instrument"),
    (0.5, "displacement looks like twice the change of path"),
)


def scaled(measured: Array, predicted: Array, scale: float, judge: Callable[[Array], Array]) -> Iterator[Mistake]:
    """Displacements in another unit, of the other sign, or of the path there and back."""
    for factor, what in _SCALES:
        yield Mistake(what, judge(measured * factor - predicted), scale)


def exchanged(
    kind: str, ids: Sequence[str], misfit: Array, scale: float, judge: Callable[[IntArray], Array]
) -> Iterator[Mistake]:
    """Two setups or targets exchanged, tried among those that do not fit.

    Args:
        kind: what they are, for the message.
        ids: their ids.
        misfit: how each fits as it is; one that fits is left alone.
        scale: size of what is predicted.
        judge: misfit when entry i is taken for entry `order[i]`.
    """
    bad = [i for i in range(len(ids)) if misfit[i] > _LIMIT * scale][:_MOST_TRIED]
    for position, first in enumerate(bad):
        for second in bad[position + 1 :]:
            order = same(len(ids))
            order[[first, second]] = second, first
            yield Mistake(f"the {kind}s {ids[first]!r} and {ids[second]!r} look exchanged", judge(order), scale)


def exchanged_axes(dimension: int) -> Iterator[tuple[str, tuple[int, int, int]]]:
    """Two of the columns x, y and z exchanged: the suspicion, and which column stands for each axis."""
    for a, b in ((0, 1), (0, 2), (1, 2)):
        if b < dimension:
            order = [0, 1, 2]
            order[a], order[b] = b, a
            yield f"the columns {'xyz'[a]} and {'xyz'[b]} look exchanged", (order[0], order[1], order[2])


def same(count: int) -> IntArray:
    """(count,) every entry is itself."""
    return np.arange(count, dtype=np.int64)


def per_setup(setup: IntArray, values: Array, count: int) -> Array:
    """(count,) median of the absolute values of each setup, NaN where it has none."""
    return group_ranges(np.abs(values), setup, count)[1]


def spread(difference: Array, group: IntArray, setup: IntArray, count: int) -> Array:
    """(count,) measured minus predicted by setup, after each group's own zero."""
    zero = group_ranges(difference, group, int(group.max(initial=-1)) + 1)[1]
    return per_setup(setup, difference - zero[group], count)


def extent(predicted: Array, group: IntArray) -> float:
    """Typical half range of the prediction within a group; NaN where nothing is predicted."""
    low, _, high = group_ranges(predicted, group, int(group.max(initial=-1)) + 1)
    known = np.isfinite(low)
    return float(np.median((high - low)[known])) / 2 if known.any() else np.nan


_ROWS = 20_000  # enough to judge by
_FITS = 0.1  # of the readings' extent
_BETTER = 0.2  # of the misfit as it is


def check_consistency(session: Session, place: Place) -> None:
    """Refuse a session whose readings a common mistake explains and its geometry does not.

    Raises:
        SessionError: the mistake that is suspected.
    """
    readings = _sample(session.readings)
    if len(readings) < 4:
        return
    with np.errstate(all="ignore"):
        for comparison in session.spec.nominal(session, readings, place):
            _decide(place.readings, comparison)


def _decide(source: str, comparison: Comparison) -> None:
    """Raise for the first mistake that fits where the data as they are do not."""
    worst = float(np.nanmax(comparison.misfit, initial=0.0))
    if not worst > _FITS * comparison.scale:
        return
    for mistake in comparison.mistakes:
        misfit = float(np.nanmax(mistake.misfit, initial=0.0))
        if misfit < _FITS * mistake.scale and misfit * comparison.scale < _BETTER * worst * mistake.scale:
            raise SessionError(f"{source}: {mistake.what}")


def _sample(readings: Readings) -> Readings:
    rows = np.flatnonzero(np.isfinite(readings.displacement))
    step = max(1, -(-len(rows) // _ROWS))
    return readings.select(rows[::step])
