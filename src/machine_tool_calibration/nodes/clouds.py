"""sensor_msgs/PointCloud2 with float64 fields."""

from __future__ import annotations

from array import array
from collections.abc import Mapping

import numpy as np
from sensor_msgs.msg import PointCloud2, PointField

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.nodes.stamps import to_message

__all__ = ["cloud", "columns"]


def cloud(stamp: int, fields: Mapping[str, Array], frame: str = "machine") -> PointCloud2:
    """One row for each point.

    Args:
        stamp: ROS time, ns.
        fields: (n,) values by name; NaN is a value that is not determined.
        frame: in which x, y, z are given.
    """
    rows = np.column_stack(list(fields.values())).astype("<f8")
    message = PointCloud2(
        height=1,
        width=len(rows),
        fields=[
            PointField(name=name, offset=8 * index, datatype=PointField.FLOAT64, count=1)
            for index, name in enumerate(fields)
        ],
        is_bigendian=False,
        point_step=8 * len(fields),
        row_step=8 * rows.size,
        data=array("B", rows.tobytes()),
        is_dense=bool(np.all(np.isfinite(rows))),
    )
    message.header.stamp = to_message(stamp)
    message.header.frame_id = frame
    return message


def columns(message: PointCloud2) -> dict[str, Array]:
    """The fields of such a message, each (n,)."""
    rows = np.frombuffer(bytes(message.data), "<f8").reshape(message.width, len(message.fields))
    return {field.name: rows[:, index].copy() for index, field in enumerate(message.fields)}
