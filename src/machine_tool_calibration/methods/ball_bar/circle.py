# SPDX-License-Identifier: Apache-2.0
"""The nominal circles of a ball bar: arms, angles, and the way round."""

import numpy as np

from machine_tool_calibration.arrays import Array, IntArray
from machine_tool_calibration.session.description import BallBar, CircleSetup
from machine_tool_calibration.session.session import Readings

# Component of a tangent below which an axis stands: it reverses there, and its direction says nothing of the way round.
_STANDS = 0.02
# Time from reading to reading, in the fastest setup, below which the tool does not stop for each, s.
_ON_THE_MOVE = 0.5


def arms(description: BallBar, readings: Readings) -> tuple[Array, IntArray]:
    """(n, 3) from the nominal centre to the commanded place, m, and (n, 2) numbers of the axes of the plane."""
    centre = np.array([setup.centre for setup in description.setups])
    plane = np.array([["XYZ".index(axis) for axis in setup.plane] for setup in description.setups])
    return readings.position() - centre[readings.setup], plane[readings.setup]


def in_plane(vector: Array, plane: IntArray) -> Array:
    """(n, 2) components of vectors (n, 3) along the two axes of the plane (n, 2)."""
    return np.take_along_axis(vector, plane, axis=1)


def angles(arm: Array, plane: IntArray) -> Array:
    """(n,) from the plane's first axis towards its second, rad."""
    first, second = in_plane(arm, plane).T
    return np.asarray(np.arctan2(second, first))


def places(setup: CircleSetup, angle: Array) -> tuple[Array, Array]:
    """(n, 3) places on a circle, m, and (n, 3) unit vectors of the way counter-clockwise, at angles (n,), rad."""
    axes = ["XYZ".index(axis) for axis in setup.plane]
    place, way = np.tile(np.array(setup.centre), (len(angle), 1)), np.zeros((len(angle), 3))
    place[:, axes] += setup.radius * np.column_stack([np.cos(angle), np.sin(angle)])
    way[:, axes] = np.column_stack([-np.sin(angle), np.cos(angle)])
    return place, way


def travel_sense(arm: Array, plane: IntArray, readings: Readings) -> Array | None:
    """(n,) +1 counter-clockwise, -1 clockwise, NaN where the axes' directions contradict; None without directions."""
    letters = ["xyz"[j] for j in np.unique(plane)]
    if any(f"dir_{a}" not in readings.columns for a in letters):
        return None
    moved = np.column_stack([readings.columns.get(f"dir_{a}", np.zeros(len(arm))) for a in "xyz"])
    angle = angles(arm, plane)
    tangent = np.column_stack([-np.sin(angle), np.cos(angle)])
    along = np.where(np.abs(tangent) > _STANDS, np.sign(tangent) * np.sign(in_plane(moved, plane)), 0.0).sum(axis=1)
    return np.where(along == 0.0, np.nan, np.sign(along))


def way_over_time(readings: Readings) -> Array:
    """(n,) path speed of each reading's setup, m/s: the median of way over time; NaN where it may have stopped."""
    out = np.full(len(readings), np.nan)
    if "time" not in readings.columns:
        return out
    moved, took = np.linalg.norm(np.diff(readings.position(), axis=0), axis=1), np.diff(readings.columns["time"])
    run = readings.repeat_of_setup
    going = (run[1:] == run[:-1]) & (took > 0) & (moved > 0)
    setups = [going & (readings.setup[1:] == setup) for setup in range(int(readings.setup.max(initial=-1)) + 1)]
    if min((float(np.median(took[mine])) for mine in setups if mine.any()), default=np.inf) < _ON_THE_MOVE:
        for setup, mine in enumerate(setups):
            if mine.any():
                out[readings.setup == setup] = np.median(moved[mine] / took[mine])
    return out
