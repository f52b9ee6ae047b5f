"""Products of the mirror's tilt and the machine's errors, from a first solution.

The first-order reading is l.d + l.e + t.d. What it leaves out is the product of tilt and error: nanometres for 1 mrad
and 5 um, but a good part of a micrometre for 5 mrad and 100 um. The beam lies on the actual diagonal D + e_D, and
g = n / (n.l) has g.l = 1; so the reading is exactly g.(d + e) with g = (1 + s) l_0 + t, where l_0 is the nominal
direction, t lies across it and s makes g.(D + e_D) the length of the actual diagonal.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from machine_tool_calibration.arrays import Array, IntArray
from machine_tool_calibration.methods.step_diagonal.geometry import Run

__all__ = ["second_order"]


def second_order(
    runs: Sequence[Run], setup: IntArray, displacement: Array, error: Array, end_error: Array, tilt: Array
) -> Array:
    """What the first-order reading leaves out, at a first solution.

    Args:
        runs: the setups.
        setup: (n,) of each reading.
        displacement: (n, 3) nominal, since the start of the run, m.
        error: (n, 3) position error since the start of the run, m.
        end_error: (runs, 3) the same at the end of the run, m.
        tilt: (runs, 3) t, across the beam; for a linear run, whose beam lies on the actual motion, it does not matter.

    Returns:
        (n,) exact minus first-order reading, m.
    """
    beam = np.array([run.beam for run in runs])
    actual = np.array([run.motion for run in runs]) + end_error
    length = np.linalg.norm(actual, axis=1)
    linear = np.array([not run.diagonal for run in runs])[:, None]
    off = end_error - np.einsum("rj,rj->r", end_error, beam)[:, None] * beam
    t = np.where(linear, off / length[:, None], tilt)
    stretch = (length - np.einsum("rj,rj->r", beam + t, actual)) / np.einsum("rj,rj->r", beam, actual)
    reached = displacement + error
    # For a diagonal t.d is of first order; in a linear run d lies along the beam and t.d is zero.
    return np.asarray(
        stretch[setup] * np.einsum("nj,nj->n", beam[setup], reached) + np.einsum("nj,nj->n", t[setup], error)
    )
