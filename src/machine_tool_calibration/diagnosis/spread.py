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
    """Slope and bow of each run, over time and over the path.

    Args:
        observations: the readings; a run is a setup in one repeat.

    Returns:
        Families `time` and, where the instrument has a path that is not the time in disguise, `path`.
    """
    readings = observations.readings
    run = np.unique(np.stack([readings.setup, readings.repeat]), axis=1, return_inverse=True)[1].reshape(-1)
    covariates = {"time": readings.columns.get("time", np.arange(len(readings), dtype=float))}
    if np.ptp(observations.path) > 0:
        covariates["path"] = observations.path
    columns, family = [], []
    for k, values in enumerate(covariates.values()):
        for r in range(int(run.max()) + 1):
            mine = np.flatnonzero(run == r)
            if len(mine) < 4 or np.ptp(values[mine]) == 0:
                continue
            u = (values[mine] - values[mine].mean()) / (np.ptp(values[mine]) / 2)
            for shape in (u, u**2 - np.mean(u**2)):
                column = np.zeros(len(readings))
                norm = np.sqrt(np.mean(shape**2))
                if norm < 1e-9:
                    continue
                column[mine] = shape / norm * observations.session.sigma
                columns.append(column)
                family.append(k)
    stacked = np.array(columns) if columns else np.zeros((0, len(readings)))
    return Spread(stacked, np.array(family, dtype=np.int64), tuple(covariates))
