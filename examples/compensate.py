# SPDX-License-Identifier: Apache-2.0
"""Corrects commanded positions by the latched error map of topic `error_map`.

    python3 compensate.py --ros-args -r __ns:=/cell_1

`commanded` (geometry_msgs/PointStamped, m, the map's frame) → `corrected` (the same type and stamp): where to send the
machine so that it arrives. Before there is a map, and outside of what it covers, nothing is published and the log says
why: an uncorrected position must not pass for a corrected one.
"""

import sys

import rclpy
from geometry_msgs.msg import PointStamped
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import PointCloud2

from machine_tool_calibration.errors import CalibrationError
from machine_tool_calibration.maps import PositionErrors, error_map_from_message

# Both sides must ask for it: a volatile subscriber gets no map that was published before it came.
LATCHED = QoSProfile(depth=1, reliability=ReliabilityPolicy.RELIABLE, durability=DurabilityPolicy.TRANSIENT_LOCAL)


class Compensate(Node):  # type: ignore[misc]  # rclpy comes without types
    """See the module."""

    def __init__(self) -> None:
        super().__init__("compensate")
        self.error_map: PositionErrors | None = None
        self.corrected = self.create_publisher(PointStamped, "corrected", 10)
        self.create_subscription(PointCloud2, "error_map", self.take_map, LATCHED)
        self.create_subscription(PointStamped, "commanded", self.correct, 10)

    def take_map(self, message: PointCloud2) -> None:
        """A new map; a broken one leaves the old."""
        try:
            self.error_map = error_map_from_message(message)
        except CalibrationError as error:
            self.get_logger().error(str(error))
            return
        self.get_logger().info(f"error map of {message.width} points ({self.error_map.kind})")

    def correct(self, message: PointStamped) -> None:
        """Answer a commanded position."""
        if self.error_map is None:
            self.get_logger().warning("no error map yet", throttle_duration_sec=5.0)
            return
        if message.header.frame_id not in ("", self.error_map.frame):
            self.get_logger().error(f"frame {message.header.frame_id!r} is not the map's {self.error_map.frame!r}")
            return
        try:
            command = self.error_map.compensated([message.point.x, message.point.y, message.point.z])
        except CalibrationError as error:
            self.get_logger().error(str(error))
            return
        answer = PointStamped(header=message.header)
        answer.point.x, answer.point.y, answer.point.z = map(float, command)
        self.corrected.publish(answer)


def main() -> None:
    """Run the node."""
    if {"-h", "--help"} & set(sys.argv[1:]):
        print(__doc__)
        return
    rclpy.init()
    node = Compensate()
    try:
        # With a timeout: a signal that comes just before the wait ends it a second later, and not never.
        while rclpy.ok():
            rclpy.spin_once(node, timeout_sec=1.0)
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    finally:
        node.destroy_node()
        rclpy.try_shutdown()


if __name__ == "__main__":
    main()
