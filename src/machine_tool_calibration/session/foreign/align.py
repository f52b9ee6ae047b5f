"""Measured points onto nominal ones: the best shift and turn."""

from __future__ import annotations

import numpy as np

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.errors import SessionError

__all__ = ["best_motion", "check_deviations", "check_size"]

_FACTORS = (
    (1e3, "is their unit a thousand times smaller, such as um, not mm"),
    (1e-3, "is their unit a thousand times larger, such as mm, not um"),
    (25.4, "are they in mm, not in inches"),
    (1 / 25.4, "are they in inches, not in mm"),
)
_POOR = 2e-3  # of the extent: no machine tool is that far off


def best_motion(measured: Array, nominal: Array) -> tuple[Array, Array]:
    """The rigid motion that brings measured points nearest to nominal ones (least squares).

    Args:
        measured: (n, 3) m, in any frame.
        nominal: (n, 3) m.

    Returns:
        Rotation (3, 3) and shift (3,): rotation @ measured + shift.
    """
    first, second = measured.mean(axis=0), nominal.mean(axis=0)
    left, _, right = np.linalg.svd((nominal - second).T @ (measured - first))
    sense = np.diag([1.0, 1.0, np.sign(np.linalg.det(left @ right))])
    rotation = np.asarray(left @ sense @ right)
    return rotation, second - rotation @ first


def check_size(measured: Array, nominal: Array, where: str, *, aligned: bool) -> None:
    """Refuse measured points that are not those that were asked for.

    Args:
        measured: (n, 3) m, after alignment if there was one; NaN where missing.
        nominal: (n, 3) m.
        where: for messages.
        aligned: whether the measured points were shifted and turned onto the nominal ones.

    Raises:
        SessionError: another unit, points in another frame or order, or a left-handed frame.
    """
    good = np.isfinite(measured) & np.isfinite(nominal)
    off = np.where(good, measured - nominal, 0.0)
    count = np.maximum(good.sum(axis=0), 1)
    extent = max(float(np.ptp(nominal[good[:, j], j])) if good[:, j].any() else 0.0 for j in range(3))
    spread = float(np.sqrt(np.max(np.sum(off**2, axis=0) / count - (np.sum(off, axis=0) / count) ** 2)))
    if extent == 0.0 or spread <= _POOR * extent:
        return
    # one by one where axes are what they say, all together where they were turned
    parts = [(list(range(3)), "")] if aligned else [([j], f" along {'xyz'[j]}") for j in range(3)]
    for axes, along in parts:
        size = [float(np.sqrt(np.sum(_centred(part, good)[:, axes] ** 2))) for part in (measured, nominal)]
        ratio = size[0] / size[1] if size[1] else 0.0
        for factor, what in _FACTORS:
            if abs(ratio / factor - 1.0) < 0.02:
                raise SessionError(
                    f"{where}: measured points spread {ratio:.4g} times as far as nominal ones{along}; {what}?"
                )
    whole = good.all(axis=1)
    hint = "are the columns and the order of the points right?"
    if not aligned:
        hint = "points measured in another frame need --align"
    elif whole.sum() > 3:
        mirrored = measured[whole] * [1.0, 1.0, -1.0]
        rotation, shift = best_motion(mirrored, nominal[whole])
        rest = mirrored @ rotation.T + shift - nominal[whole]
        if np.sqrt(np.mean(rest**2)) < _POOR * extent:
            hint = "they fit once mirrored: one of the two frames is left-handed"
    raise SessionError(f"{where}: measured points are {spread * 1e3:.4g} mm (RMS) from nominal ones; {hint}")


def check_deviations(deviation: Array, position: Array, where: str) -> None:
    """Refuse deviations that no machine tool has over its travel.

    Args:
        deviation: (n,) m, NaN where missing.
        position: (n,) along the axis that was moved, or (n, 3), m.
        where: for messages.

    Raises:
        SessionError: they spread too far; most often their unit is another.
    """
    good = np.isfinite(deviation)
    extent = float(np.max(np.ptp(position, axis=0))) if len(position) else 0.0
    spread = float(np.std(deviation[good])) if good.any() else 0.0
    if spread > _POOR * extent > 0.0:
        raise SessionError(
            f"{where}: deviations spread {1e3 * spread:.4g} mm over {1e3 * extent:.4g} mm of travel; "
            "is their unit right?"
        )


def _centred(points: Array, good: np.ndarray) -> Array:
    kept = np.where(good, points, 0.0)
    middle = kept.sum(axis=0) / np.maximum(good.sum(axis=0), 1)
    return np.where(good, points - middle, 0.0)
