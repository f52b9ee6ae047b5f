# SPDX-License-Identifier: Apache-2.0
"""Messages are dated by the simulated clock of when they were sent, whichever topic a busy machine brings first."""

import pytest

pytest.importorskip("rclpy", reason="the recorder needs ROS 2")

import rclpy
from rclpy.serialization import serialize_message
from rosgraph_msgs.msg import Clock

from machine_tool_calibration.nodes.ros.messages import to_message
from machine_tool_calibration.nodes.ros.taps import Taken, Taps

SECOND = 10**9
LONG_AGO = 1_000 * SECOND  # by the system's clock: whatever was received then has waited long enough


def tick(shown, sent):
    data = serialize_message(Clock(clock=to_message(shown * SECOND)))
    return Taken("/clock", data, LONG_AGO, sent, 0)


def reading(sent, received=LONG_AGO):
    return Taken("/reading", b"", received, sent, 0)


@pytest.fixture
def taps(ros_domain, monkeypatch):
    """Gives what has come, by name of the topic, in place of the middleware."""
    context = rclpy.Context()
    rclpy.init(context=context, domain_id=ros_domain)
    node = rclpy.create_node("taps_test", context=context)
    monkeypatch.setattr(rclpy, "create_node", lambda *args, **more: node)
    made = Taps(node, "/clock")
    made.add("/reading", "rosgraph_msgs/msg/Clock")
    come = {"/clock": [], "/reading": []}

    def give(tap):
        given, come[tap.topic] = come[tap.topic], []
        return given

    monkeypatch.setattr(made, "_take", give)
    yield made, come
    node.destroy_node()
    rclpy.shutdown(context=context)


def test_a_message_that_comes_after_later_ticks(taps):
    made, come = taps
    come["/clock"] = [tick(10, 1), tick(20, 3), tick(30, 5)]
    come["/reading"] = [reading(4), reading(2)]
    assert [(m.sent, m.simulated) for m in made.take()] == [(2, 10 * SECOND), (4, 20 * SECOND)]
    come["/reading"] = [reading(2)]
    assert [m.simulated for m in made.take()] == [10 * SECOND]


def test_a_message_waits_for_a_tick_that_may_still_be_on_its_way(taps):
    made, come = taps
    soon = 2**62  # received after everything that the system's clock shows
    come["/clock"], come["/reading"] = [tick(10, 1)], [reading(4, soon)]
    assert made.take() == []
    come["/clock"] = [tick(30, 5), tick(20, 3)]
    assert [m.simulated for m in made.take()] == [20 * SECOND]


def test_at_the_end_no_message_waits_and_what_is_older_than_the_clock_has_its_first_time(taps):
    made, come = taps
    come["/clock"], come["/reading"] = [tick(10, 3)], [reading(1, 2**62), reading(9, 2**62)]
    assert [m.sent for m in made.take()] == [1]
    assert [(m.sent, m.simulated) for m in made.take(last=True)] == [(9, 10 * SECOND)]
