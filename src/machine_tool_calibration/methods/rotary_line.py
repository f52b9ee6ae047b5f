"""Where the axis average line stands in the machine, from the stations whose place in the machine is known."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from machine_tool_calibration.arrays import Array

__all__ = ["average_line", "line_names"]

_STEPS = 20


def line_names(axis: str) -> tuple[tuple[str, int], ...]:
    """ISO 230-1 names of an axis average line's errors and their places among (X, Y, Z, A, B, C): X0C Y0C A0C B0C."""
    along = "ABC".index(axis)
    shifts = tuple((f"{'XYZ'[j]}0{axis}", j) for j in range(3) if j != along)
    return shifts + tuple((f"{'ABC'[j]}0{axis}", 3 + j) for j in range(3) if j != along)


def average_line(stations: Array, covariance: Array, nominal: Array, uncertainty: Array) -> tuple[Array, Array] | None:
    """Shift and turn from the frame of the axis to the machine's.

    nominal = R(turn) station + shift, by weighted least squares; the turn is a rotation vector, which for a table that
    stands tilted is large.

    Args:
        stations: (S, 3) in the frame of the axis, m.
        covariance: (3 S, 3 S), m^2.
        nominal: (S, 3) in the machine frame, m.
        uncertainty: (S,) standard uncertainty of each of its coordinates, m.

    Returns:
        (6,) shift of the line's point at the axis's origin and turn, m and rad, and (6, 6) covariance; None where the
        stations do not determine them.
    """
    if len(stations) < 3:
        return None
    known = np.repeat(uncertainty**2, 3)
    turn, shift = Rotation.identity(), np.zeros(3)
    inverse = np.zeros((6, 6))
    for _ in range(_STEPS):
        seen = turn.apply(stations)
        columns = np.zeros((len(stations), 3, 6))
        columns[:, :, :3] = np.eye(3)
        for j in range(3):
            columns[:, :, 3 + j] = np.cross(np.eye(3)[j], seen)
        flat = columns.reshape(-1, 6)
        carry = np.kron(np.eye(len(stations)), turn.as_matrix())
        weight = np.linalg.inv(carry @ covariance @ carry.T + np.diag(known))
        normal = flat.T @ weight @ flat
        if np.linalg.cond(normal) > 1e12:
            return None
        inverse = np.asarray(np.linalg.inv(normal), dtype=np.float64)
        step = inverse @ flat.T @ weight @ (nominal - seen - shift).ravel()
        shift, turn = shift + step[:3], Rotation.from_rotvec(step[3:]) * turn
        if np.abs(step).max() < 1e-12:
            break
    return np.concatenate([shift, turn.as_rotvec()]), inverse
