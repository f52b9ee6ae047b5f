# SPDX-License-Identifier: Apache-2.0
"""Places whose readings no others check, and that stand out: what is wrong there is in the map and in no residual.

A step diagonal's tables are sums of moves. Where the readings of one place alone tell of a move, a target that was
touched, or a halt that was missed, in every repeat, makes the machine's error jump from one halt to the next.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from machine_tool_calibration.arrays import Array, IntArray
from machine_tool_calibration.methods.build import error_map
from machine_tool_calibration.model.fit import Fit, JointFit
from machine_tool_calibration.model.refits import changed, declared
from machine_tool_calibration.residuals.leverage import prediction_jacobian
from machine_tool_calibration.words import say

__all__ = ["Doubtful", "doubtful_places"]

# Times the usual change from halt to halt (1.4826 median absolute deviations; at least the readings' uncertainty) from
# which one stands out, and how many changes say what is usual.
_STANDS_OUT, _ENOUGH = 8.0, 6
# Share of the mean of a place's readings in its own prediction from which no others check it.
_ALONE = 0.9
_SAME = 1e-6  # m


@dataclass(frozen=True)
class Doubtful:
    """A place whose readings would explain all jumps of the tables if they were off by the same.

    Attributes:
        setup: id.
        place: (3,) m.
        off: of all its readings, m.
        rows: of these.
    """

    setup: str
    place: tuple[float, ...]
    off: float
    rows: tuple[int, ...]

    @property
    def words(self) -> str:
        """A sentence."""
        return say(
            "suspicion.unchecked",
            setup=self.setup,
            place=", ".join(f"{1e3 * v:.6g}" for v in self.place),
            off=f"{1e6 * self.off:.3g}",
            rows=", ".join(map(str, self.rows)),
        )


def doubtful_places(fit: Fit) -> Iterator[Doubtful]:
    """Places of which one that was read wrongly, in every repeat, would explain what jumps in a step diagonal's tables.

    Args:
        fit: of one session by itself.
    """
    observations = fit.model.observations
    readings, sigma = observations.readings, float(np.median(fit.model.sigma))
    found = _Changes.of(_content(declared(fit.joint)), sigma)
    if not found.jumps.any():
        return
    at = readings.position()
    near = [np.abs(at[:, "xyz".index(axis)] - halt) < _SAME for axis, halt in found.ends(found.jumps)]
    for which in _unchecked(fit, np.flatnonzero(np.any(near, axis=0))):
        shift = np.zeros(len(readings))
        shift[which] = sigma
        gain = (_Changes.of(_content(changed(fit.joint, [shift])), sigma).change - found.change) / sigma
        square = float(np.sum(gain[found.jumps] ** 2))
        if square <= 0.0:
            continue
        off = float(gain[found.jumps] @ found.away[found.jumps]) / square
        if not (np.abs(found.away - off * gain) > _STANDS_OUT * found.usual).any():
            setup = observations.session.setup_ids[readings.setup[which[0]]]
            rows = tuple(sorted(readings.row[which].tolist()))
            yield Doubtful(setup, tuple(at[which[0]].tolist()), off, rows)


def _content(joint: JointFit) -> Mapping[str, Any]:
    return error_map(joint.fits[0]).content


@dataclass(frozen=True)
class _Changes:
    """Changes of a machine's errors from halt to halt.

    Attributes:
        change: (k,) m.
        away: (k,) from the median of the same table, m.
        usual: (k,) how far they usually are from it, m.
        axis: (k,) x, y or z, which moves.
        halts: (k, 2) its positions, m.
    """

    change: Array
    away: Array
    usual: Array
    axis: tuple[str, ...]
    halts: Array

    @staticmethod
    def of(content: Mapping[str, Any], sigma: float) -> _Changes:
        """Those of an error map that has `x`, each (n, 3) m, with `x_position`, (n,) m, and so on for y and z."""
        change, away, usual, axes, halts = [], [], [], list[str](), []
        for axis in (axis for axis in "xyz" if axis in content):
            places = np.array(content[f"{axis}_position"], dtype=float)
            for values in np.array(content[axis], dtype=float).T:
                own = np.diff(values)
                known = np.flatnonzero(np.isfinite(own))
                if len(known) < _ENOUGH:
                    continue
                change.append(own[known])
                away.append(own[known] - np.median(own[known]))
                usual.append(np.full(len(known), max(1.4826 * float(np.median(np.abs(away[-1]))), sigma)))
                axes += [axis] * len(known)
                halts.append(np.column_stack([places[known], places[known + 1]]))
        none = np.zeros(0)
        return _Changes(
            change=np.concatenate([none, *change]),
            away=np.concatenate([none, *away]),
            usual=np.concatenate([none, *usual]),
            axis=tuple(axes),
            halts=np.concatenate([np.zeros((0, 2)), *halts]),
        )

    @property
    def jumps(self) -> Array:
        """(k,) which stand out."""
        return np.asarray(np.abs(self.away) > _STANDS_OUT * self.usual)

    def ends(self, which: Array) -> list[tuple[str, float]]:
        """Axes and positions between which they are."""
        return [(self.axis[k], float(halt)) for k in np.flatnonzero(which) for halt in self.halts[k]]


def _unchecked(fit: Fit, which: IntArray) -> Iterator[IntArray]:
    """Those of some readings whose places' means predict themselves, place by place."""
    reached = prediction_jacobian(fit.part, fit.solution, fit.index, np.ones(fit.part.n_readings), which)
    products = reached.products(reached, fit.solution.covariance)
    place = fit.model.observations.place[which]
    for one in np.unique(place):
        mine = np.flatnonzero(place == one)
        if products[np.ix_(mine, mine)].sum() > _ALONE * len(mine):
            yield which[mine]
