# SPDX-License-Identifier: Apache-2.0
"""The recorder's process: nothing lost, stopped cleanly, killed without harm."""

import itertools
import json
import os
import signal
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="needs ROS 2")

from machine_tool_calibration.errors import RecordingError, UnfinishedError
from machine_tool_calibration.recording.cdr import NUMBERS, decode, text
from machine_tool_calibration.recording.reader import BagReader
from machine_tool_calibration.recording.recover import recover

from ..nodes.forked import Forked

PUBLISHER = Path(__file__).with_name("stream_publisher.py")
PATIENCE = 300  # s


@contextmanager
def program(*arguments: str) -> Iterator[subprocess.Popen[str]]:
    process = subprocess.Popen(
        [sys.executable, *arguments],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env={**os.environ, "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"},
    )
    try:
        yield process
    finally:
        process.kill()
        process.communicate(timeout=PATIENCE)


class Recorder(Forked):
    """The recorder's process."""

    def __init__(self, arguments: list[str], log: Path) -> None:
        self.log = log
        command = [sys.executable, "-m", "machine_tool_calibration.nodes", "recorder", "--ros-args", *arguments]
        super().__init__(command, {**os.environ, "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}, log)

    def said(self) -> str:
        """All that it said, once it has ended."""
        self.wait(PATIENCE)
        return self.log.read_text()


@contextmanager
def recorder(*parameters: str, namespace: str = "/") -> Iterator[Recorder]:
    arguments = [word for parameter in parameters for word in ("-p", parameter)]
    with tempfile.TemporaryDirectory() as folder:
        process = Recorder(["-r", f"__ns:={namespace}", *arguments], Path(folder, "log"))
        try:
            yield process
        finally:
            process.kill()
            process.wait(PATIENCE)


def publisher(namespace: str, batches: int, rate: float, samples: int, *more: str):
    return program(str(PUBLISHER), namespace, str(batches), str(rate), str(samples), *more)


def expect(process: subprocess.Popen[str], word: str) -> str:
    assert process.stdout is not None
    for line in process.stdout:
        if line.startswith(word):
            return line
    raise AssertionError(f"ended before {word!r}: {process.stderr.read() if process.stderr else ''}")


def stop(process: Recorder, number: int = signal.SIGINT) -> str:
    """Ask it to stop; returns what it said."""
    process.send_signal(number)
    said = process.said()
    assert process.returncode == 0, said
    return said


def samples_of(bag: BagReader, topic: str = "/instrument/displacement") -> np.ndarray:
    return np.concatenate([decode(NUMBERS, message.data).data for message in bag.messages([topic])])


@pytest.mark.long
def test_ten_thousand_samples_a_second_of_a_graph_in_its_namespace(tmp_path: Path, ros_domain: int) -> None:
    folder = tmp_path / "bag"
    with publisher("/cell_2", 500, 500, 20) as sender:
        expect(sender, "up")  # so that the description is older than the recorder
        with recorder(f"folder:={folder}", "split_size:=50000", namespace="/cell_2") as process:
            expect(sender, "sent")
            assert "0 lost" in stop(process, signal.SIGTERM)
    bag = BagReader(folder)
    assert len(bag.files) > 1
    assert set(bag.topics) == {
        "/cell_2/session",
        "/cell_2/instrument/displacement",
        "/cell_2/joint_states",
        "/cell_2/environment/extra_sensor",
    }
    assert [text(message.data) for message in bag.messages(["/cell_2/session"])] == ["before the recorder"]
    assert bag.topics["/cell_2/session"].qos[0].latched
    assert not bag.topics["/cell_2/joint_states"].qos[0].latched
    assert bag.topics["/cell_2/joint_states"].messages == 500
    assert np.array_equal(samples_of(bag, "/cell_2/instrument/displacement"), np.arange(10_000))
    messages = list(bag.messages(["/cell_2/joint_states"]))
    assert [message.sequence for message in messages] == list(range(1, 501))
    # the middleware's times: sent before received, and in order
    assert all(message.publish_time <= message.log_time for message in messages)
    assert all(b.log_time >= a.log_time for a, b in itertools.pairwise(messages))


@pytest.mark.long
def test_chosen_topics_of_any_quality(tmp_path: Path, ros_domain: int) -> None:
    folder = tmp_path / "bag"
    with recorder(f"folder:={folder}", "topics:=['loose', '/instrument/displacement']") as process:
        with publisher("/", 200, 500, 1, "loose") as sender:
            expect(sender, "sent")
        stop(process)
    bag = BagReader(folder)
    assert set(bag.topics) == {"/loose", "/instrument/displacement"}
    assert bag.topics["/loose"].qos[0].reliability == "best_effort"
    assert bag.topics["/loose"].messages > 0


@pytest.mark.long
def test_simulated_time(tmp_path: Path, ros_domain: int) -> None:
    folder = tmp_path / "bag"
    with recorder(f"folder:={folder}", "use_sim_time:=true") as process, publisher("/", 100, 100, 1, "clock") as sender:
        expect(sender, "sent")
        stop(process)
    bag = BagReader(folder)
    assert np.array_equal(samples_of(bag), np.arange(100))
    times = [message.log_time for message in bag.messages()]
    # nothing is dated before the first clock message, though the description came before it
    assert min(times) >= 100 * 10**9
    assert max(times) < 200 * 10**9
    assert times == sorted(times)
    assert bag.topics["/session"].messages == 1
    # dated by the tick before them, though they are taken from the middleware later
    states = [message.log_time for message in bag.messages(["/joint_states"])]
    assert sum(time == (100 + k) * 10**9 for k, time in enumerate(states)) > 90


@pytest.mark.long
def test_a_kill_costs_nothing_once_a_pause_was_as_long_as_the_period(tmp_path: Path, ros_domain: int) -> None:
    """What has come is in the file without another message, and without an end; the period is the writer's."""
    folder, batches = tmp_path / "bag", 200
    with recorder(f"folder:={folder}") as process, publisher("/", batches, 400, 20) as sender:
        expect(sender, "sent")
        for attempt in itertools.count():  # ended by the test's own timeout where they never come
            assert process.poll() is None
            with suppress(RecordingError, KeyError):  # nothing is there yet
                recover(folder, tmp_path / f"saved_{attempt}")  # only reads there: as if it had been killed now
                if BagReader(tmp_path / f"saved_{attempt}").topics["/joint_states"].messages == batches:
                    break
        process.kill()
        process.wait(timeout=PATIENCE)
    with pytest.raises(UnfinishedError, match=f"`mtcal recover {folder}` makes it whole"):
        BagReader(folder)
    recover(folder, tmp_path / "saved")
    assert np.array_equal(samples_of(BagReader(tmp_path / "saved")), np.arange(20 * batches))


def test_a_wrong_request_is_one_line(tmp_path: Path, ros_domain: int) -> None:
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "file").write_text("kept")
    with ExitStack() as stack:
        started = [
            (stack.enter_context(recorder(parameter)), expected)
            for parameter, expected in (
                (f"folder:={tmp_path}/full", f"{tmp_path}/full: is not empty; a recording needs a new folder"),
                ("split_size:=-1", "split_size"),
                ("flush_period:=5.0", "flush_period"),
            )
        ]
        verb = stack.enter_context(command(tmp_path / "full"))
        for process, expected in started:
            said = process.said()
            assert process.returncode == 1
            assert len(said.strip().splitlines()) == 1
            assert expected in said
        _, said = verb.communicate(timeout=PATIENCE)
        assert said == f"mtcal: {tmp_path}/full: is not empty; a recording needs a new folder\n"


def command(folder: Path, *words: str):
    return program("-m", "machine_tool_calibration", "record", "-o", str(folder), "--json", *words)


@pytest.mark.long
def test_the_command_records_until_it_is_stopped(tmp_path: Path, ros_domain: int) -> None:
    folder = tmp_path / "b 'ag"
    with publisher("/", 200, 400, 5) as sender, command(folder) as process:
        expect(sender, "sent")
        process.send_signal(signal.SIGINT)
        output, errors = process.communicate(timeout=PATIENCE)
        assert process.returncode == 0, errors
    document = json.loads(output)
    assert document["format"] == "mtcal-recording/1"
    assert document["lost"] == 0
    assert document["messages"] == BagReader(folder).messages_in_all == 421  # 200 twice, 20 and the description
    assert "/session" in {topic["name"] for topic in document["topics"]}


@pytest.mark.long
def test_the_command_records_for_a_time(tmp_path: Path, ros_domain: int) -> None:
    with command(tmp_path / "bag", "--duration", "0.5") as process:
        output, errors = process.communicate(timeout=PATIENCE)
        assert process.returncode == 0, errors
    assert json.loads(output)["messages"] == BagReader(tmp_path / "bag").messages_in_all
