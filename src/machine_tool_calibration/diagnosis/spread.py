"""What varies from run to run without being a missing effect: small slopes and bows of every run.

Repeats within a setup show the repeatability, not the reproducibility: against it everything looks missing.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from machine_tool_calibration.arrays import Array, IntArray
from machine_tool_calibration.model.observations import Observations

__all__ = ["Spread", "run_spreads"]


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
        Families `mounting` and, where there are several runs in a mounting, `run`.
    """
    readings = observations.readings
    time = readings.columns.get("time", np.arange(len(readings), dtype=float))
    mounting = np.cumsum(np.r_[0, np.diff(readings.setup) != 0])
    run = np.unique(np.stack([readings.setup, readings.repeat]), axis=1, return_inverse=True)[1].reshape(-1)
    levels = {"mounting": mounting}
    if len(np.unique(run)) > len(np.unique(mounting)):
        levels["run"] = run
    columns, family = [], []
    for k, group in enumerate(levels.values()):
        shapes = _slopes_and_bows(time, group)
        columns += [shape * observations.session.sigma for shape in shapes]
        family += [k] * len(shapes)
    stacked = np.array(columns) if columns else np.zeros((0, len(readings)))
    return Spread(stacked, np.array(family, dtype=np.int64), tuple(levels))


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
