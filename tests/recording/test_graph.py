# SPDX-License-Identifier: Apache-2.0
"""What is known of the graph's topics without asking the graph."""

import pytest

from machine_tool_calibration.recording.graph import with_depth
from machine_tool_calibration.recording.metadata import Qos

UNKNOWN = Qos(history="unknown", depth=0, durability="transient_local")


@pytest.mark.parametrize("name", ["/reading", "/cell_2/reading"])
def test_a_depth_that_discovery_does_not_tell_is_that_of_the_graph(name: str) -> None:
    known = with_depth(name, "sensor_msgs/msg/JointState", UNKNOWN)
    assert known == Qos(depth=20000, durability="transient_local")


def test_nothing_is_said_of_other_topics_and_of_depths_that_are_known() -> None:
    assert with_depth("/cell_2/my_reading", "sensor_msgs/msg/JointState", UNKNOWN) is UNKNOWN
    assert with_depth("/reading", "std_msgs/msg/String", UNKNOWN) is UNKNOWN
    told = Qos(depth=3, durability="transient_local")
    assert with_depth("/reading", "sensor_msgs/msg/JointState", told) is told
