# SPDX-License-Identifier: Apache-2.0
"""What a procedure publishes of a session."""

from rclpy.node import Node
from rclpy.publisher import Publisher
from sensor_msgs.msg import JointState
from std_msgs.msg import String

from machine_tool_calibration.nodes.ros.messages import LATCHED, READINGS, to_message
from machine_tool_calibration.recording.graph import MACHINE
from machine_tool_calibration.recording.session_bag import reading_columns
from machine_tool_calibration.session.parse import description_yaml
from machine_tool_calibration.session.session import Session


def publish(node: Node, session: Session, start: int) -> list[Publisher]:
    """All at once; kept for those who come late as long as the publishers are.

    Args:
        node: whose publishers these are.
        session: what is published.
        start: of the session, ns.
    """
    description = node.create_publisher(String, "session", LATCHED)
    readings = node.create_publisher(JointState, "reading", READINGS)
    description.publish(String(data=description_yaml(session.description)))
    names, table = reading_columns(session)
    for row in table:
        message = JointState(name=names, position=row.tolist())
        message.header.stamp = to_message(start + round(row[names.index("time")] * 1e9))
        message.header.frame_id = MACHINE
        readings.publish(message)
    return [description, readings]
