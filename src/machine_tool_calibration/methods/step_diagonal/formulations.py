"""The formulations of Ibaraki and Hata 2010: conventional (Wang), new, alternative, and the two-dimensional case.

All take R, (..., D, d, N): displacements of the single moves for the diagonals ppp, npp, pnp (in a plane pp, np), the
axis of the move and the block counted along the increasing axis, m; and give increments of the position errors,
(..., d, d, N): axis of the motion, component, block, m. Leading dimensions are passed through.
"""

from __future__ import annotations

import numpy as np

from machine_tool_calibration.arrays import Array

__all__ = ["alternative", "conventional", "conventional_2d", "new", "new_2d"]

_X, _Y, _Z = 0, 1, 2
_PPP, _NPP, _PNP = 0, 1, 2


def conventional(R: Array, step: Array) -> Array:
    """Wang's formulation, Eq. (2) with the nominal directions of Eq. (3).

    It takes the mirror to be at right angles to the beam: a tilt of 1 mrad makes it wrong by tens of micrometres.

    Args:
        R: (..., 3, 3, N), m.
        step: (3,) a_x, a_y, a_z, m.
    """
    signs = np.array([[1.0, 1.0, 1.0], [-1.0, 1.0, 1.0], [1.0, -1.0, 1.0]])
    beams = signs * step / np.linalg.norm(step)
    out = np.empty(R.shape)
    for axis in range(3):
        # A move of -a along the axis reads minus the beam's share of it.
        matrix = signs[:, axis, None] * beams
        out[..., axis, :, :] = np.linalg.solve(matrix, R[..., :, axis, :])
        out[..., axis, axis, :] -= step[axis]
    return out


def new(R: Array, linear: Array, step: Array) -> Array:
    """The formulation that is immune to the mirrors' tilts, Eqs. (6)-(19), in the coordinate system of Eq. (17).

    Args:
        R: (..., 3, 3, N), m.
        linear: (..., 3, N) increments of the positioning errors de_x(x), de_y(y), de_z(z) from linear runs, m.
        step: (3,) a_x, a_y, a_z, m.
    """
    length = np.linalg.norm(step)
    ax, ay, az = step
    dx, dy, dz = (linear[..., axis, :] for axis in range(3))
    rx, ry, rz = (R[..., :, axis, :] for axis in range(3))

    def mean(values: Array) -> Array:
        return np.asarray(values.mean(axis=-1, keepdims=True))

    # Eqs. (16) and (18); under Eq. (17) the means of de_y(x), de_z(x) and de_y(z) vanish.
    l_xx = mean(-2 * ax / length * (dx + ax) + rx[..., _PPP, :] + rx[..., _NPP, :])
    l_yy = mean(-2 * ay / length * (dy + ay) + ry[..., _PPP, :] + ry[..., _PNP, :])
    l_zz = mean(-2 * az / length * (dz + az) + rz[..., _NPP, :] + rz[..., _PNP, :])
    l_yx = mean(rx[..., _PPP, :] - rx[..., _PNP, :])
    l_zx = mean(rx[..., _PNP, :] - rx[..., _NPP, :])
    l_yz = mean(rz[..., _PPP, :] - rz[..., _PNP, :])
    # Eq. (19)
    l_xz = -l_zx - l_xx - l_yy - l_zz
    l_xy = -l_yx - l_zx - l_xz
    l_zy = -l_yx - l_yz - l_xy
    out = np.empty(R.shape)
    # Eqs. (7)-(9), (11)-(13); positioning from the linear runs
    out[..., _X, _X, :] = dx
    out[..., _X, _Y, :] = length / (2 * ay) * (rx[..., _PPP, :] - rx[..., _PNP, :] - l_yx)
    out[..., _X, _Z, :] = length / (2 * az) * (rx[..., _PNP, :] - rx[..., _NPP, :] - l_zx)
    out[..., _Y, _X, :] = length / (2 * ax) * (ry[..., _PPP, :] - ry[..., _NPP, :] - l_xy)
    out[..., _Y, _Y, :] = dy
    out[..., _Y, _Z, :] = length / (2 * az) * (ry[..., _NPP, :] - ry[..., _PNP, :] - l_zy)
    out[..., _Z, _X, :] = length / (2 * ax) * (rz[..., _PPP, :] - rz[..., _NPP, :] - l_xz)
    out[..., _Z, _Y, :] = length / (2 * ay) * (rz[..., _PPP, :] - rz[..., _PNP, :] - l_yz)
    out[..., _Z, _Z, :] = dz
    return out


def alternative(R: Array, linear: Array, step: Array) -> Array:
    """Eq. (20) with the direction cosines that the print lacks on its right-hand side.

    Rows 1-3 subtract l_x (a_x + de_x(x)) + l_y (a_y + de_y(y)) + l_z (a_z + de_z(z)), row 4 l_x,pnp (a_x + de_x(x)),
    row 5 l_y,ppp (a_y + de_y(y)) and row 6 l_z,ppp (a_z + de_z(z)). The orientation that comes out is any; Eq. (17)
    turns it.

    Args:
        R: (..., 3, 3, N), m.
        linear: (..., 3, N) increments of the positioning errors from linear runs, m.
        step: (3,) a_x, a_y, a_z, m.
    """
    lx, ly, lz = step / np.linalg.norm(step)
    # Unknown: de_y(x), de_z(x), de_x(y), de_z(y), de_x(z), de_y(z). The signs of npp and pnp are in the coefficients.
    matrix = np.array(
        [
            [ly, lz, lx, lz, lx, ly],
            [-ly, -lz, -lx, lz, -lx, ly],
            [-ly, lz, -lx, -lz, lx, -ly],
            [-ly, lz, 0, 0, 0, 0],
            [0, 0, lx, lz, 0, 0],
            [0, 0, 0, 0, lx, ly],
        ]
    )
    along = np.array([lx, ly, lz])[:, None] * (step[:, None] + linear)
    total = along.sum(axis=-2)
    right = np.stack(
        [
            R[..., _PPP, :, :].sum(axis=-2) - total,
            R[..., _NPP, :, :].sum(axis=-2) - total,
            R[..., _PNP, :, :].sum(axis=-2) - total,
            R[..., _PNP, _X, :] - along[..., _X, :],
            R[..., _PPP, _Y, :] - along[..., _Y, :],
            R[..., _PPP, _Z, :] - along[..., _Z, :],
        ],
        axis=-2,
    )
    solved = np.linalg.solve(matrix, right)
    out = np.empty(R.shape)
    for axis in range(3):
        out[..., axis, axis, :] = linear[..., axis, :]
    out[..., _X, _Y, :], out[..., _X, _Z, :] = solved[..., 0, :], solved[..., 1, :]
    out[..., _Y, _X, :], out[..., _Y, _Z, :] = solved[..., 2, :], solved[..., 3, :]
    out[..., _Z, _X, :], out[..., _Z, _Y, :] = solved[..., 4, :], solved[..., 5, :]
    return out


def conventional_2d(R: Array, step: Array) -> Array:
    """Eq. (2) in a plane: diagonals pp and np.

    Args:
        R: (..., 2, 2, N), m.
        step: (2,) a_x, a_y, m.
    """
    length = np.linalg.norm(step)
    ax, ay = step
    plus, minus = R[..., 0, :, :] + R[..., 1, :, :], R[..., 0, :, :] - R[..., 1, :, :]
    out = np.empty(R.shape)
    out[..., _X, _X, :] = length / (2 * ax) * plus[..., _X, :] - ax
    out[..., _X, _Y, :] = length / (2 * ay) * minus[..., _X, :]
    out[..., _Y, _X, :] = length / (2 * ax) * minus[..., _Y, :]
    out[..., _Y, _Y, :] = length / (2 * ay) * plus[..., _Y, :] - ay
    return out


def new_2d(R: Array, linear: Array, step: Array) -> Array:
    """The new formulation in a plane (Ibaraki, Hata and Matsubara 2009), with the mean of de_y(x) zero.

    A tilt adds a constant to each move whose sum over x and y is zero, so lambda_xy = -lambda_yx. The normal errors are
    those of the conventional formulation but for the orientation of the coordinate system (the paper's Remark 1).

    Args:
        R: (..., 2, 2, N), m.
        linear: (..., 2, N) increments of the positioning errors from linear runs, m.
        step: (2,) a_x, a_y, m.
    """
    length = np.linalg.norm(step)
    out = conventional_2d(R, step)
    tilt = (R[..., 0, _X, :] - R[..., 1, _X, :]).mean(axis=-1, keepdims=True)
    out[..., _X, _Y, :] -= length / (2 * step[_Y]) * tilt
    out[..., _Y, _X, :] += length / (2 * step[_X]) * tilt
    for axis in range(2):
        out[..., axis, axis, :] = linear[..., axis, :]
    return out
