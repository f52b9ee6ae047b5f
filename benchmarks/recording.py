# SPDX-License-Identifier: Apache-2.0
"""Recordings: speed beside rosbags and mcap, an hour of the stream, and recorders killed at random.

python benchmarks/recording.py speed     writing and reading, beside the libraries `rosbags` and `mcap`
python benchmarks/recording.py hour      an hour of 10 kHz through the writer: memory and size
python benchmarks/recording.py live      10 kHz through the recorder's process: loss and memory (needs ROS 2)
python benchmarks/recording.py kill -n 50      recorders killed at random: what each kill costs (needs ROS 2)
"""

from __future__ import annotations

import argparse
import os
import random
import resource
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path

import numpy as np

from machine_tool_calibration.recording.cdr import (
    JOINT_STATE,
    NUMBERS,
    decode,
    definition_of,
    encode,
    encode_joint_state,
    part,
    typestore,
)
from machine_tool_calibration.recording.reader import BagReader
from machine_tool_calibration.recording.recover import recover
from machine_tool_calibration.recording.writer import BagWriter

SAMPLES = 20  # of 10 kHz in batches at 500 Hz
NAMES = ["time", "repeat", "x", "y", "z", "dir_x", "dir_y", "dir_z", "azimuth", "elevation", "displacement"]


def batch(rng: np.random.Generator, samples: int = SAMPLES) -> bytes:
    dims = [
        part("std_msgs/msg/MultiArrayDimension", "sample", samples, 2 * samples),
        part("std_msgs/msg/MultiArrayDimension", "time,displacement", 2, 2),
    ]
    layout = part("std_msgs/msg/MultiArrayLayout", dims, 0)
    return encode(NUMBERS, layout, rng.normal(size=2 * samples) * 1e-7 + 0.1)


def speed(count: int) -> None:
    """Messages per second, writing serialized messages and reading them with their values."""
    from mcap.reader import make_reader
    from mcap.writer import Writer as McapWriter
    from mcap_ros2.decoder import DecoderFactory
    from rosbags.rosbag2 import Reader as RosbagsReader
    from rosbags.rosbag2 import StoragePlugin
    from rosbags.rosbag2 import Writer as RosbagsWriter

    rng = np.random.default_rng(0)
    kinds = {"/stream": (NUMBERS, [batch(rng) for _ in range(100)])}
    values = rng.normal(size=(100, len(NAMES)))
    kinds["/reading"] = (JOINT_STATE, [encode_joint_state(i, "A", NAMES, row) for i, row in enumerate(values)])

    def own(path: Path, topic: str, kind: str, messages: list[bytes]) -> None:
        with BagWriter(path) as bag:
            bag.add_topic(topic, kind)
            for i in range(count):
                bag.write(topic, messages[i % 100], i * 1000)

    def rosbags(path: Path, topic: str, kind: str, messages: list[bytes]) -> None:
        with RosbagsWriter(path, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
            connection = writer.add_connection(topic, kind, typestore=typestore())
            for i in range(count):
                writer.write(connection, i * 1000, messages[i % 100])

    def mcap(path: Path, topic: str, kind: str, messages: list[bytes]) -> None:
        path.mkdir()
        with (path / "a.mcap").open("wb") as stream:
            writer = McapWriter(stream)
            writer.start("ros2")
            schema = writer.register_schema(kind, "ros2msg", definition_of(kind).text.encode())
            channel = writer.register_channel(topic, "cdr", schema)
            for i in range(count):
                writer.add_message(channel, i * 1000, messages[i % 100], i * 1000)
            writer.finish()  # type: ignore[no-untyped-call]

    def read_own(path: Path, topic: str, kind: str) -> int:
        read = partial(decode, kind)
        return sum(read(message.data) is not None for message in BagReader(path).messages([topic]))

    def read_rosbags(path: Path, topic: str, kind: str) -> int:
        store = typestore()
        with RosbagsReader(path) as reader:
            return sum(store.deserialize_cdr(data, kind) is not None for _, _, data in reader.messages())

    def read_mcap(path: Path, topic: str, kind: str) -> int:
        with next(path.glob("*.mcap")).open("rb") as stream:
            reader = make_reader(stream, decoder_factories=[DecoderFactory()])
            return sum(1 for _ in reader.iter_decoded_messages([topic]))

    print(f"{count} messages: microseconds of processor time each")
    print(f"{'':22}{'write':>10}{'':8}{'read with values':>10}")
    for topic, (kind, messages) in kinds.items():
        for name, write, read in (
            ("this project", own, read_own),
            ("rosbags", rosbags, read_rosbags),
            ("mcap, mcap-ros2", mcap, read_mcap),
        ):
            with tempfile.TemporaryDirectory() as folder:
                path = Path(folder) / "bag"
                start = time.process_time()
                write(path, topic, kind, messages)
                written = time.process_time()
                assert read(path, topic, kind) == count
                end = time.process_time()
            each = 1e6 / count
            print(f"{topic:10}{name:18}{(written - start) * each:8.2f}{(end - written) * each:18.2f}")


def hour(seconds: int) -> None:
    """An hour of everything that a graph sends, as fast as the writer takes it."""
    rng = np.random.default_rng(0)
    batches = [batch(rng) for _ in range(500)]
    states = [encode_joint_state(i, "", ["x", "y", "z"], rng.normal(size=3)) for i in range(100)]
    with tempfile.TemporaryDirectory() as folder:
        bag = BagWriter(Path(folder) / "bag", split_bytes=1 << 30)
        bag.add_topic("/instrument/displacement", NUMBERS)
        bag.add_topic("/joint_states", JOINT_STATE)
        start = time.perf_counter()
        for second in range(seconds):
            at = second * 10**9
            for i, data in enumerate(batches):
                bag.write("/instrument/displacement", data, at + i * 2_000_000)
            for i, data in enumerate(states):
                bag.write("/joint_states", data, at + i * 10_000_000)
            bag.flush()  # twice as many chunks as in real time at the least
            if second % 600 == 599:
                print(f"{second + 1:5} s recorded: peak memory {memory():.1f} MB", flush=True)
        bag.close()
        took = time.perf_counter() - start
        size = sum(file.stat().st_size for file in bag.folder.glob("*.mcap"))
        count = sum(1 for _ in BagReader(bag.folder).messages())
        assert count == seconds * (len(batches) + len(states))
    print(f"{count} messages in {took:.1f} s ({seconds / took:.0f} times real time), {size / 1e6:.0f} MB")


def memory() -> float:
    """Peak resident memory of this process, MB."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3


PUBLISHER = """
import sys, time
from array import array
import rclpy
from rclpy.qos import QoSProfile
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray
rclpy.init()
node = rclpy.create_node("publisher")
stream = node.create_publisher(Float64MultiArray, "instrument/displacement", QoSProfile(depth=100))
states = node.create_publisher(JointState, "joint_states", QoSProfile(depth=100))
end = time.monotonic() + 60
while not (stream.get_subscription_count() and states.get_subscription_count()) and time.monotonic() < end:
    time.sleep(0.02)
time.sleep(1.0)
start, k, seconds = time.monotonic(), 0, float(sys.argv[1])
print("started", flush=True)
while time.monotonic() - start < seconds:
    stream.publish(Float64MultiArray(data=array("d", range(20 * k, 20 * k + 20))))
    states.publish(JointState(name=["wall"], position=[time.time()]))
    k += 1
    time.sleep(max(0.0, start + k / 500 - time.monotonic()))
stream.wait_for_all_acked(rclpy.duration.Duration(seconds=10))
print("sent", k, flush=True)
sys.stdin.read()
"""


@contextmanager
def program(*arguments: str) -> Iterator[subprocess.Popen[str]]:
    env = {**os.environ, "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
    process = subprocess.Popen(
        [sys.executable, *arguments],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
        env=env,
    )
    try:
        yield process
    finally:
        process.kill()
        process.communicate()


def recorder(folder: Path) -> list[str]:
    return ["-m", "machine_tool_calibration.nodes", "recorder", "--ros-args", "-p", f"folder:={folder}"]


def live(seconds: float) -> None:
    """The recorder's process under the stream."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "bag"
        with program(*recorder(path)) as process, program("-c", PUBLISHER, str(seconds)) as sender:
            assert sender.stdout is not None
            first = None
            for line in sender.stdout:
                if line.startswith("started"):
                    time.sleep(min(3.0, seconds / 2))
                    first = resident(process.pid)
                elif line.startswith("sent"):
                    sent = int(line.split()[1])
                    break
            last, cpu = resident(process.pid), cpu_seconds(process.pid)
            begin = time.perf_counter()
            process.send_signal(signal.SIGINT)
            process.wait(timeout=30)
            stopped = time.perf_counter() - begin
        bag = BagReader(path)
        samples = np.concatenate(
            [decode(NUMBERS, message.data).data for message in bag.messages(["/instrument/displacement"])]
        )
        assert np.array_equal(samples, np.arange(len(samples)))
        delays = [message.log_time - message.publish_time for message in bag.messages(["/joint_states"])]
        print(
            f"{sent} batches sent, {len(samples) // 20} recorded; memory {first:.1f} MB, then {last:.1f} MB; "
            f"{100 * cpu / seconds:.0f} % of a core; stopped in {stopped:.2f} s; "
            f"on the way {np.median(delays) / 1e3:.0f} us, at most {max(delays) / 1e6:.1f} ms"
        )


def kill(count: int, seed: int) -> None:
    """Recorders killed at random moments; what each kill cost."""
    rng = random.Random(seed)
    costs = []
    for number in range(count):
        with tempfile.TemporaryDirectory() as folder:
            path, saved = Path(folder) / "bag", Path(folder) / "saved"
            with program(*recorder(path)) as process, program("-c", PUBLISHER, "1000") as sender:
                assert sender.stdout is not None
                sender.stdout.readline()
                time.sleep(rng.uniform(1.0, 4.0))
                killed = time.time()
                process.kill()
                process.wait()
            report = recover(path, saved)
            bag = BagReader(saved)
            *_, last = bag.messages(["/joint_states"])
            samples = np.concatenate(
                [decode(NUMBERS, message.data).data for message in bag.messages(["/instrument/displacement"])]
            )
            assert np.array_equal(samples, np.arange(len(samples))), "a gap"
            cost = killed - float(decode(JOINT_STATE, last.data).position[0])
            costs.append(cost)
            print(f"{number + 1:3}: {report.messages} messages saved, the last {cost:.3f} s lost", flush=True)
    print(f"{count} kills: lost {np.median(costs):.3f} s in the middle, at most {max(costs):.3f} s")
    if max(costs) >= 1.0:
        raise SystemExit("a kill cost a second or more")


def resident(pid: int) -> float:
    """Resident memory of a process, MB."""
    for line in Path(f"/proc/{pid}/status").read_text().splitlines():
        if line.startswith("VmRSS"):
            return int(line.split()[1]) / 1e3
    return float("nan")


def cpu_seconds(pid: int) -> float:
    """Processor time of a process, s."""
    fields = Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=["speed", "hour", "live", "kill"])
    parser.add_argument("-n", type=int, help="messages (speed), seconds (hour, live) or kills (kill)")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    if options.what == "speed":
        speed(options.n or 50_000)
    elif options.what == "hour":
        hour(options.n or 3600)
    elif options.what == "live":
        live(float(options.n or 30))
    else:
        kill(options.n or 50, options.seed)


if __name__ == "__main__":
    main()
