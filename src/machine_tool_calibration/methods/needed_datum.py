"""Only as much datum as the readings need: a condition that cost some fit would be no datum."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from machine_tool_calibration.arrays import Array

__all__ = ["needed_rows", "silent_directions"]

# Smallest eigenvalue of the normal matrix of unit columns that still counts, as in the solver.
_RANK = 1e-12
# Share of a condition along what is still open below which it fixes nothing of it.
_SHARE = 1e-5


def silent_directions(columns: Array) -> tuple[Array, Array]:
    """Changes of the unknowns that no reading notices.

    Args:
        columns: (m, n) change of each reading per unit of each unknown.

    Returns:
        (m, q) orthonormal directions of the scaled unknowns, and (m,) the scales: unknown = scale x scaled unknown.
    """
    norms = np.sqrt(np.einsum("mn,mn->m", columns, columns))
    scale = 1.0 / np.where(norms > 1e-13 * norms.max(initial=1e-300), norms, norms.max(initial=1.0) or 1.0)
    matrix = (columns @ columns.T) * np.outer(scale, scale)
    values, vectors = np.linalg.eigh((matrix + matrix.T) / 2)
    return np.asarray(vectors[:, values <= _RANK * len(norms)]), scale


def needed_rows(open_directions: Array, rows: Sequence[Array]) -> tuple[list[int], Array]:
    """Which conditions each fix a direction that the readings and the conditions before leave open.

    Such a condition can always be met without any reading fitting worse.

    Args:
        open_directions: (m, q) basis of the open directions.
        rows: (m,) weights of each candidate, in the order of preference, in the same scaling of the unknowns.

    Returns:
        Indices of the candidates that are needed, and (m, c) the directions that these fix.
    """
    basis = open_directions
    needed, fixed = [], []
    for index, row in enumerate(rows):
        if not basis.shape[1]:
            break
        seen = row @ basis
        size = float(np.linalg.norm(seen))
        if size <= _SHARE * max(float(np.linalg.norm(row)), 1e-300):
            continue
        needed.append(index)
        # What is still open is orthogonal to what the condition sees.
        full = np.linalg.svd((seen / size)[:, None], full_matrices=True)[0]
        fixed.append(basis @ full[:, 0])
        basis = basis @ full[:, 1:]
    return needed, np.array(fixed).reshape(len(needed), len(open_directions)).T
