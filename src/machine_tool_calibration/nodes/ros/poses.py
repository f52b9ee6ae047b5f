# SPDX-License-Identifier: Apache-2.0
"""Poses in messages; apart from the other messages, as scipy takes its time to be imported."""

import math

import numpy as np
from geometry_msgs.msg import Point, Pose, PoseStamped, Quaternion
from scipy.spatial.transform import Rotation

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.nodes.ros.messages import dated, point


def pose_message(stamp: int, place: Array, turn: Quaternion) -> PoseStamped:
    """A pose in the machine's frame at a time, ns."""
    return dated(PoseStamped(pose=Pose(position=point(place), orientation=turn)), stamp)


def place_of(point: Point) -> Array:
    """(3,) place of a point."""
    return np.array([point.x, point.y, point.z])


def quaternion_along(direction: Array) -> Quaternion:
    """The rotation that turns +X onto a direction (3,): first about Z, then down or up."""
    x, y, z = map(float, direction)
    return _quaternion(Rotation.from_euler("ZY", [math.atan2(y, x), -math.atan2(z, math.hypot(x, y))]))


def quaternion_of(rotation: Array) -> Quaternion:
    """The quaternion of a rotation matrix (3, 3)."""
    return _quaternion(Rotation.from_matrix(rotation))


def _quaternion(rotation: Rotation) -> Quaternion:
    x, y, z, w = map(float, rotation.as_quat())
    return Quaternion(x=x, y=y, z=z, w=w)


def rotation_of(quaternion: Quaternion) -> Array:
    """(3, 3) matrix of a quaternion."""
    return np.asarray(Rotation.from_quat([quaternion.x, quaternion.y, quaternion.z, quaternion.w]).as_matrix())
