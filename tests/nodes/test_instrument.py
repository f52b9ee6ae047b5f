# SPDX-License-Identifier: Apache-2.0
"""The instrument by itself: the stream, stable readings, a broken beam, a real instrument's driver."""

import socket
import threading
import time
from pathlib import Path

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray
from sensor_msgs.msg import Temperature
from std_msgs.msg import Float64MultiArray

from machine_tool_calibration.errors import CalibrationError
from machine_tool_calibration.nodes.ros.messages import LATCHED, SLOW, STATE, from_message

from .conftest import PATIENCE, SITE


def rows(message):
    samples, columns = (dim.size for dim in message.layout.dim)
    return np.asarray(message.data).reshape(samples, columns)


@pytest.mark.long
def test_ten_kilohertz_stream_is_recorded_without_loss(bench):
    from rosbags.highlevel import AnyReader

    names = ("recorder", "axis_simulator", "rotary_pointer", "instrument")
    noisy = {**SITE, "noise": 3e-7}
    graph = bench.graph(names, simulated_time=False, site=noisy, more={"instrument": {"sample_noise": 2e-8}})
    operator = bench.operator(graph)
    told = []
    operator.node.create_subscription(DiagnosticArray, "recorder/status", told.append, LATCHED)

    def batches():
        """How many the recorder has."""
        topics = {status.name: status for status in told[-1].status} if told else {}
        entries = topics["/instrument/displacement"].values if "/instrument/displacement" in topics else ()
        return int({entry.key: entry.value for entry in entries}.get("messages", 0))

    assert operator.wait(lambda: batches() > 0, PATIENCE)
    seen = []
    operator.node.create_subscription(Float64MultiArray, "instrument/displacement", seen.append, STATE)
    assert operator.wait(lambda: sum(len(rows(message)) for message in seen) > 15_000, PATIENCE)
    heard = [message.data[0] for message in seen]
    counted = batches()
    graph.stop(["recorder"])
    with AnyReader([Path(bench.folder, "bag1")]) as bag:
        chosen = [entry for entry in bag.connections if entry.topic == "/instrument/displacement"]
        recorded = [bag.deserialize(raw, entry.msgtype) for entry, _, raw in bag.messages(connections=chosen)]
    table = np.concatenate([np.asarray(m.data).reshape(-1, 2) for m in recorded])
    assert len(recorded) >= counted > 0
    # every sample 0.1 ms after the one before: none is missing (times of today resolve 0.24 us);
    # only where the simulated axes were starved for a second does the stream begin anew
    steps = np.diff(table[:, 0])
    assert np.abs(steps[steps < 0.9] - 1e-4).max() < 1e-6
    # a busy recorder may stop some batches behind: up to where it came it has all that others heard
    both = {time for time in heard if time <= table[-1, 0]}
    assert len(both) > len(heard) / 2
    assert both <= set(table[:, 0])
    assert 1e-8 < table[:, 1].std() < 1e-6


@pytest.mark.long
def test_datum_capture_and_environment_in_real_time(bench):
    names = ("axis_simulator", "rotary_pointer", "instrument")
    graph = bench.graph(names, simulated_time=False, more={"instrument": {"averaging": 0.2}})
    operator = bench.operator(graph)
    temperatures, stamps = [], []
    operator.node.create_subscription(
        DiagnosticArray,
        "instrument/outcome",
        lambda message: stamps.append(from_message(message.header.stamp)),
        LATCHED,
    )
    operator.node.create_subscription(Temperature, "environment/temperature_air", temperatures.append, SLOW)
    assert operator.wait(lambda: operator.has_node("instrument"), PATIENCE)
    with pytest.raises(CalibrationError, match="no datum"):
        operator.call("instrument/capture", PATIENCE)
    zeroed, taken = zero_and_read(operator)
    assert taken["datum"] == zeroed["datum"]
    assert float(taken["displacement"]) == 0.0  # nothing moved, and the site is without noise
    start, end = int(taken["start"]), int(taken["end"])
    assert end - start == pytest.approx(0.2e9, rel=1e-3)
    assert stamps[-1] == (start + end) // 2
    assert taken["samples"] == "2001"
    assert operator.wait(lambda: bool(temperatures), PATIENCE)
    assert temperatures[-1].temperature == pytest.approx(float(taken["temperature_air"]), abs=0.01)


def zero_and_read(operator):
    """A datum and a reading from it; again where a busy machine let the true positions wait for a second."""
    read = []

    def done():
        zeroed = operator.outcome("instrument/datum", PATIENCE)
        try:
            read.append((zeroed, operator.outcome("instrument/capture", PATIENCE)))
        except CalibrationError as error:
            assert "was not known for a while" in str(error)
        return bool(read)

    assert operator.wait(done, PATIENCE)
    return read[0]


class Interferometer:
    """A TCP server that sends a line for each reading, as a real instrument does."""

    def __init__(self):
        self.value, self.beam = 1.0, 1
        self.server = socket.create_server(("127.0.0.1", 0))
        self.port = self.server.getsockname()[1]
        self.stopped = threading.Event()
        self.thread = threading.Thread(target=self.serve, daemon=True)
        self.thread.start()

    def serve(self):
        link, _ = self.server.accept()
        with link:
            while not self.stopped.is_set():
                link.sendall(f"{self.value:+.7f} OK {self.beam}\r\n".encode())
                time.sleep(0.002)

    def close(self):
        self.stopped.set()
        self.server.close()


def test_a_real_instruments_driver_takes_the_simulators_place(bench):
    peer = Interferometer()
    config = Path(__file__).parents[2] / "config" / "drivers" / "tcp_streaming.yaml"
    text = config.read_text().replace("192.168.0.10", "127.0.0.1").replace("4001", str(peer.port))
    driver = bench.folder / "driver.yaml"
    driver.write_text(text)
    graph = bench.graph(("instrument",), simulated_time=False, more={"instrument": {"driver": str(driver)}})
    operator = bench.operator(graph)
    stream = []
    operator.node.create_subscription(Float64MultiArray, "instrument/displacement", stream.append, STATE)
    try:
        operator.call("instrument/datum", PATIENCE)
        peer.value = 1.5  # mm
        assert operator.wait(
            lambda: bool(stream) and rows(stream[-1])[-1, 1] == pytest.approx(5e-4, abs=1e-12), PATIENCE
        )
        taken = operator.outcome("instrument/capture", PATIENCE)
        assert float(taken["displacement"]) == pytest.approx(5e-4, abs=1e-12)
        assert taken.keys() == {"datum", "start", "end", "displacement", "standard_deviation", "samples"}
        assert abs(int(taken["end"]) * 1e-9 - time.time()) < PATIENCE
        peer.beam = 0
        assert operator.wait(lambda: np.isnan(rows(stream[-1])[-1, 1]), PATIENCE)
        peer.beam = 1
        with pytest.raises(CalibrationError, match=r"no datum: the instrument says that the beam is broken"):
            operator.call("instrument/capture", PATIENCE)
    finally:
        peer.close()
