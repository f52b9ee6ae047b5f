"""Motions of the table that the readings at an angle do not sense, as a turn about the line through two targets.

They follow the fitted places of stations and targets, so that while the fit moves these, what is unseen would move
about. Each is therefore held at zero within a limit that no error motion reaches, and an error motion in which it takes
part by more than the readings' own uncertainty is not published.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.model.model import Prior

__all__ = ["unseen_motions", "unseen_names"]

# Standard uncertainty with which an unseen motion is held at zero, m: wide against any error motion.
_HELD = 1e-4
# Part of a reading's standard uncertainty that what is unseen may add to an error motion.
_ADDED = 0.3


def unseen_motions(loose: Array, labels: Sequence[Sequence[str]], size: float) -> tuple[Prior, ...]:
    """Hold what is unseen at each angle.

    Args:
        loose: (K, 6, 6) from `rotary_datum.loose_motions`.
        labels: (6, K) names of the error motions' values.
        size: length by which rotations were compared with translations there, m.
    """
    scale = np.repeat([1.0, size], 3)
    out = []
    for k, projector in enumerate(loose):
        values, vectors = np.linalg.eigh(projector)
        for vector in vectors[:, values > 0.5].T:
            weights = {labels[j][k]: float(w) for j, w in enumerate(vector * scale) if w}
            out.append(Prior(weights, 0.0, _HELD))
    return tuple(out)


def unseen_names(loose: Array, labels: Sequence[Sequence[str]], sigma: float) -> frozenset[str]:
    """Names of the values that what is unseen could change by more than the readings' uncertainty.

    Two targets at the same height leave open how the table tilts about the line through them, and hardly, because
    they are not quite at the same height, how it turns. An error motion counts as seen only if it is so wherever
    something is unseen: single values of one that comes and goes with the angle would mean nothing.

    Args:
        loose: (K, 6, 6) from `rotary_datum.loose_motions`.
        labels: (6, K) names of the error motions' values.
        sigma: standard uncertainty of a reading, m.
    """
    share = np.sqrt(np.einsum("kii->ik", loose).clip(0.0))
    open_ = share.max(axis=0, initial=0.0) > 0
    hidden = share.max(axis=1, initial=0.0) > _ADDED * sigma / _HELD
    return frozenset(labels[j][k] for j in np.flatnonzero(hidden).tolist() for k in np.flatnonzero(open_).tolist())
