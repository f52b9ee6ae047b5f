"""Rotations as the quaternions of geometry_msgs, to the last digits of float64."""

from __future__ import annotations

import math

import numpy as np
from geometry_msgs.msg import Pose, PoseStamped, Quaternion

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.nodes.stamps import to_message

__all__ = ["pose_message", "quaternion_along", "quaternion_of", "rotation_of"]


def quaternion_along(direction: Array) -> Quaternion:
    """The rotation that turns +X onto a direction (3,): first about Z, then down or up."""
    x, y, z = map(float, direction)
    azimuth, elevation = math.atan2(y, x), math.atan2(z, math.hypot(x, y))
    cz, sz = math.cos(0.5 * azimuth), math.sin(0.5 * azimuth)
    cy, sy = math.cos(-0.5 * elevation), math.sin(-0.5 * elevation)
    return Quaternion(x=-sz * sy, y=cz * sy, z=sz * cy, w=cz * cy)


def quaternion_of(rotation: Array) -> Quaternion:
    """The quaternion of a rotation matrix (3, 3); the largest part is found first, so that nothing cancels."""
    trace = float(np.trace(rotation))
    parts = np.array([trace, *np.diag(rotation)])
    k = int(np.argmax(parts))
    q = np.zeros(4)  # w, x, y, z
    if k == 0:
        root = math.sqrt(1.0 + trace)
        q[0] = 0.5 * root
        q[1:] = np.array(
            [rotation[2, 1] - rotation[1, 2], rotation[0, 2] - rotation[2, 0], rotation[1, 0] - rotation[0, 1]]
        ) / (2.0 * root)
    else:
        i, j, m = k - 1, k % 3, (k + 1) % 3
        root = math.sqrt(1.0 + rotation[i, i] - rotation[j, j] - rotation[m, m])
        q[1 + i] = 0.5 * root
        q[0] = (rotation[m, j] - rotation[j, m]) / (2.0 * root)
        q[1 + j] = (rotation[j, i] + rotation[i, j]) / (2.0 * root)
        q[1 + m] = (rotation[m, i] + rotation[i, m]) / (2.0 * root)
    w, x, y, z = map(float, q)
    return Quaternion(x=x, y=y, z=z, w=w)


def rotation_of(quaternion: Quaternion) -> Array:
    """(3, 3) matrix of a quaternion."""
    x, y, z, w = quaternion.x, quaternion.y, quaternion.z, quaternion.w
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def pose_message(stamp: int, frame: str, place: Array, turn: Quaternion) -> PoseStamped:
    """A pose at a time, ns."""
    message = PoseStamped(pose=Pose(orientation=turn))
    message.header.stamp = to_message(stamp)
    message.header.frame_id = frame
    position = message.pose.position
    position.x, position.y, position.z = map(float, place)
    return message
