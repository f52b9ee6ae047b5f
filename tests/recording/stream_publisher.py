# SPDX-License-Identifier: Apache-2.0
"""A program for the tests: publishes a stream, and a description that is latched, once the recorder listens.

Arguments: namespace, batches, batches per second (0: as they fit), samples per batch, `clock` if it shall also
publish /clock, which begins at 100 s and advances by a second a batch, and `loose` if the recorder listens to the
displacement and to what is published best effort, and not to all that belongs to the graph. Prints a line for each
event.
Every sample is its own number.
"""

import sys
import time
from array import array

import rclpy
from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState, Temperature
from std_msgs.msg import Float64MultiArray, String

DEADLINE = 300.0  # s; reached only in a failure


def main() -> None:
    namespace, batches, rate, samples = sys.argv[1], int(sys.argv[2]), float(sys.argv[3]), int(sys.argv[4])
    latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    stream_qos = QoSProfile(depth=2000)  # as many as a busy machine may let wait for some seconds
    rclpy.init()
    node = rclpy.create_node("stream_publisher", namespace=namespace)
    node.create_publisher(String, "session", latched).publish(String(data="before the recorder"))
    stream = node.create_publisher(Float64MultiArray, "instrument/displacement", stream_qos)
    states = node.create_publisher(JointState, "joint_states", stream_qos)
    sensor = node.create_publisher(Temperature, "environment/extra_sensor", stream_qos)
    loose = node.create_publisher(String, "loose", QoSProfile(depth=100, reliability=ReliabilityPolicy.BEST_EFFORT))
    heard: list[DiagnosticArray] = []
    node.create_subscription(DiagnosticArray, "recorder/status", heard.append, latched)
    print("up", flush=True)
    end = time.monotonic() + DEADLINE
    awaited = (stream, loose) if "loose" in sys.argv else (stream, states, sensor)
    while not heard or not all(matched(heard[-1], publisher) for publisher in awaited):
        rclpy.spin_once(node, timeout_sec=0.05)
        if time.monotonic() > end:
            raise SystemExit("the recorder did not come")
    print("matched", flush=True)
    clock = node.create_publisher(Clock, "/clock", 10) if "clock" in sys.argv else None
    # the node's own clock, the recorder's that any publisher can give, and the one that misses no tick
    while clock is not None and clock.get_subscription_count() < 3:
        rclpy.spin_once(node, timeout_sec=0.05)
        if time.monotonic() > end:
            raise SystemExit("the recorder does not ask for the clock")
    start = time.monotonic()
    for k in range(batches):
        if clock:
            clock.publish(Clock(clock=Time(sec=100 + k)))
        stream.publish(Float64MultiArray(data=array("d", range(k * samples, (k + 1) * samples))))
        states.publish(JointState(name=["x"], position=[float(k)]))
        if k % 10 == 0:
            sensor.publish(Temperature(temperature=20.0))
            loose.publish(String(data=str(k)))
        if rate:
            time.sleep(max(0.0, start + (k + 1) / rate - time.monotonic()))
    # reliable writers keep what was not yet acknowledged only as long as they live
    for publisher in (stream, states):
        if not publisher.wait_for_all_acked(rclpy.duration.Duration(seconds=DEADLINE)):
            raise SystemExit(f"the recorder does not acknowledge {publisher.topic_name}")
    print("sent", batches, flush=True)
    sys.stdin.read()
    node.destroy_node()
    rclpy.shutdown()


def matched(message: DiagnosticArray, publisher: Publisher) -> bool:
    """Whether publisher and recorder both know of each other."""
    for status in message.status:
        if status.name == publisher.topic_name and publisher.get_subscription_count():
            return any(entry.key == "publishers" and int(entry.value) > 0 for entry in status.values)
    return False


if __name__ == "__main__":
    main()
