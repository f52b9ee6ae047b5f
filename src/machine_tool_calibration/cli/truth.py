"""How far an identified map is from the simulated machine's true errors: for judging a result, never an input to it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from machine_tool_calibration.arrays import Array

__all__ = ["MapError", "map_error"]


@dataclass(frozen=True)
class MapError:
    """Difference of an identified map from the truth, after the datum has been taken out.

    Attributes:
        difference: (n, d) identified minus true position error, m.
        rms: root mean square length of the difference, m.
        largest: greatest length of the difference, m.
        before: the same RMS for a map that says that the machine has no errors, m.
    """

    difference: Array
    rms: float
    largest: float
    before: float


def map_error(points: Array, identified: Array, true: Array, free: Array | None = None) -> MapError:
    """Compare a map with the truth.

    Self-calibration fixes neither where the origin of the coordinates is nor how they are turned: the rigid motion that
    fits best is taken out of both.

    Args:
        points: (n, d) commanded positions, m; d is 2 or 3.
        identified: (n, d) identified position error, m; a point with NaN is left out.
        true: (n, d) true position error, m.
        free: (k, n, d) further displacements that the measurement leaves open; they are taken out as well.
    """
    known = np.all(np.isfinite(identified), axis=1)
    points, identified, true = points[known], identified[known], true[known]
    more = np.zeros((0, *points.shape)) if free is None else free[:, known]
    difference = _without(points, identified - true, more)
    before = _without(points, true, more)
    length = np.linalg.norm(difference, axis=1)
    return MapError(
        difference=difference,
        rms=float(np.sqrt(np.mean(length**2))),
        largest=float(length.max()),
        before=float(np.sqrt(np.mean(np.sum(before**2, axis=1)))),
    )


def _without(points: Array, field: Array, more: Array) -> Array:
    """A field of small displacements without its best-fitting shift and turn, and what else is free."""
    n, d = points.shape
    turns = [(0, 1)] if d == 2 else [(0, 1), (0, 2), (1, 2)]
    columns = np.zeros((n, d, d + len(turns)))
    columns[:, range(d), range(d)] = 1.0
    for index, (i, j) in enumerate(turns):
        columns[:, i, d + index] = -points[:, j]
        columns[:, j, d + index] = points[:, i]
    flat = np.hstack([columns.reshape(n * d, -1), more.reshape(len(more), n * d).T])
    motion, *_ = np.linalg.lstsq(flat, field.ravel(), rcond=None)
    return np.asarray(field - (flat @ motion).reshape(n, d))
