"""What varies from run to run without being a missing effect: small slopes and bows of every run.

Repeats within a setup show the repeatability, not the reproducibility: against it everything looks missing.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from machine_tool_calibration.arrays import Array, IntArray
from machine_tool_calibration.model.observations import Observations

__all__ = ["Spread", "run_spreads"]

# Groups that tell of a spread between them.
_SEVERAL = 4
# A grid: so many rows at most, with so many readings each.
_MOST_ROWS, _IN_A_ROW = 60, 6
_STILL = 1e-6  # m
# Share of a displacement that a reading senses, below which it says nothing of it.
_FAINT = 1e-3


@dataclass(frozen=True)
class Spread:
    """Columns with random coefficients.

    Attributes:
        columns: (k, n), each with the root mean square of one standard uncertainty over the readings that it touches.
        family: (k,) which variance each column's coefficient is drawn with.
        names: of the families.
    """

    columns: Array
    family: IntArray
    names: tuple[str, ...]


def run_spreads(observations: Observations) -> Spread:
    """Slope and bow over time of each mounting, or of each run in it.

    Args:
        observations: the readings. A mounting is a stretch of consecutive readings of one setup; a run is a setup in
            one repeat.

    Returns:
        Families `mounting` and, where there are several runs in a mounting, `run`; for direct deviations only where
        there are several, and `rows …` where the places lie in rows.
    """
    readings = observations.readings
    time = readings.columns.get("time", np.arange(len(readings), dtype=float))
    mounting = np.cumsum(np.r_[0, np.diff(readings.setup) != 0])
    run = np.unique(np.stack([readings.setup, readings.repeat]), axis=1, return_inverse=True)[1].reshape(-1)
    levels = {"mounting": mounting}
    if len(np.unique(run)) > len(np.unique(mounting)):
        levels["run"] = run
    if observations.session.method == "direct":
        # One or two of them tell nothing of a spread: their slopes and bows are the part's or the machine's own.
        levels = {name: group for name, group in levels.items() if len(np.unique(group)) >= _SEVERAL}
    families = {name: _slopes_and_bows(time, group) for name, group in levels.items()}
    families |= _rows(observations) | _legs(observations)
    columns = [shape * observations.session.sigma for shapes in families.values() for shape in shapes]
    family = [k for k, shapes in enumerate(families.values()) for _ in shapes]
    stacked = np.array(columns) if columns else np.zeros((0, len(readings)))
    return Spread(stacked, np.array(family, dtype=np.int64), tuple(families))


def _rows(observations: Observations) -> dict[str, list[Array]]:
    """Offsets of whole rows and columns of a grid, along and across them: holes drilled one after the other.

    Only where the places of direct deviations lie in rows, and differ along at least two axes.
    """
    if observations.session.method != "direct":
        return {}
    position = observations.position
    moved = [j for j in range(3) if np.ptp(position[:, j]) > _STILL]
    out: dict[str, list[Array]] = {}
    if len(moved) < 2:
        return out
    for j in moved:
        row = np.unique(np.round(position[:, j] / _STILL), return_inverse=True)[1].reshape(-1)
        count = np.bincount(row)
        if not _SEVERAL <= len(count) <= _MOST_ROWS or np.median(count) < _IN_A_ROW:
            continue
        shapes = []
        for i in moved:
            along = observations.direction[:, i]
            for k in range(len(count)):
                column = (row == k) * along
                norm = float(np.sqrt(np.mean(column[row == k] ** 2)))
                if norm > _FAINT:
                    shapes.append(column / norm)
        out[f"rows of equal {'xyz'[j]}"] = shapes
    return out


def _legs(observations: Observations) -> dict[str, list[Array]]:
    """Offsets of the single passes over an axis: it comes back to a place a little beside where it was."""
    if observations.session.method != "direct":
        return {}
    position, readings = observations.position, observations.readings
    moved = [j for j in range(3) if np.ptp(position[:, j]) > _STILL]
    if len(moved) != 1:
        return {}
    step = np.diff(position[:, moved[0]])
    sign = np.where(np.abs(step) > _STILL, np.sign(step), 0.0)
    turned = np.zeros(len(readings), dtype=bool)
    last = 0.0
    for k, s in enumerate(sign):
        # The second of two readings at a turning point begins the way back.
        ahead = s if s != 0.0 else (sign[k + 1] if k + 1 < len(sign) else last)
        turned[k + 1] = last != 0.0 and ahead == -last
        last = ahead or last
    again = np.r_[False, (np.diff(readings.setup) != 0) | (np.diff(readings.repeat) != 0)]
    leg = np.cumsum(turned | again)
    count = np.bincount(leg)
    if len(count) < _SEVERAL or np.median(count) < 3:
        return {}
    return {"passes": [(leg == k).astype(float) for k in range(len(count))]}


def _slopes_and_bows(values: Array, group: IntArray) -> list[Array]:
    """Columns with a root mean square of 1 over the readings of each group."""
    out = []
    for g in np.unique(group):
        mine = np.flatnonzero(group == g)
        if len(mine) < 4 or np.ptp(values[mine]) == 0:
            continue
        u = (values[mine] - values[mine].mean()) / (np.ptp(values[mine]) / 2)
        for shape in (u, u**2 - np.mean(u**2)):
            norm = np.sqrt(np.mean(shape**2))
            if norm > 1e-9:
                column = np.zeros(len(values))
                column[mine] = shape / norm
                out.append(column)
    return out
