# SPDX-License-Identifier: Apache-2.0
"""Replays: what a live graph hears of a bag, when, and that it identifies the same from it."""

import json
import time
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from unittest.mock import MagicMock

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="the graph needs ROS 2")

from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_msgs.msg import String
from visualization_msgs.msg import MarkerArray

from machine_tool_calibration.methods.identify import identify
from machine_tool_calibration.nodes import player
from machine_tool_calibration.nodes.client import Client
from machine_tool_calibration.nodes.ros import process
from machine_tool_calibration.nodes.ros.messages import LATCHED as LATCHED_QOS
from machine_tool_calibration.nodes.ros.messages import from_message
from machine_tool_calibration.recording.cdr import JOINT_STATE, TEXT, encode, encode_joint_state
from machine_tool_calibration.recording.metadata import LATCHED, Qos
from machine_tool_calibration.recording.open import open_measurement
from machine_tool_calibration.recording.session_bag import session_to_bag
from machine_tool_calibration.recording.writer import BagWriter

from ..told import Verb
from .conftest import PATIENCE
from .forked import ForkedGraph

SESSION = Path(__file__).parents[1] / "data" / "tracking_2d"
START = 1_700_000_000_000_000_000


@pytest.fixture
def play(tmp_path: Path, bench) -> Callable[..., Client]:
    """Starts a player, and whatever else is named, in a namespace of its own; gives an operator that hears it."""

    def start(bag: Path, *more: str, **parameters: object) -> Client:
        nodes = {**{name: {} for name in more}, "player": {"bag": str(bag), **parameters}}
        graph = bench.stack.enter_context(ForkedGraph(nodes, tmp_path / "log", bench.domain))
        operator = bench.operator(graph)
        operator._watch = graph.check
        return operator

    return start


def ticks(path: Path, count: int = 20, step: int = 50_000_000) -> Path:
    """A bag with one volatile topic, evenly in time, and a latched text at its beginning."""
    with BagWriter(path) as bag:
        bag.add_topic("/session", TEXT, qos=[LATCHED])
        bag.add_topic("/joint_states", JOINT_STATE, qos=[Qos()])
        bag.write("/session", encode(TEXT, "latched"), START)
        for k in range(count):
            at = START + k * step
            bag.write("/joint_states", encode_joint_state(at, "f", ["x"], np.array([float(k)])), at)
    return path


class Heard:
    """Positions of `joint_states` and times of `/clock`."""

    def __init__(self, operator: Client) -> None:
        self.values: list[float] = []
        self.clock: list[int] = []
        operator.node.create_subscription(JointState, "/joint_states", self._take, 1000)
        self.session = ""
        operator.node.create_subscription(String, "/session", self._describe, LATCHED_QOS)
        operator.node.create_subscription(Clock, "/clock", lambda m: self.clock.append(from_message(m.clock)), 1000)

    def _describe(self, message: String) -> None:
        self.session = message.data

    def _take(self, message: JointState) -> None:
        self.values.append(message.position[0])


def ready(operator: Client) -> Heard:
    """Heard by both sides: a clock that stands still has come."""
    heard = Heard(operator)
    assert operator.wait(lambda: bool(heard.clock) and operator.node.count_publishers("/joint_states") == 1, PATIENCE)
    return heard


@pytest.mark.long
def test_a_live_estimator_gives_the_same_map_to_the_last_bit(tmp_path: Path, play) -> None:
    bag = tmp_path / "bag"
    session_to_bag(open_measurement(SESSION), bag, start=START)
    operator = play(bag, "estimator", rate=0.0)
    total = len(open_measurement(bag).readings)
    assert operator.wait(
        lambda: (
            operator.heard.said("estimator").number("readings") == total
            and operator.heard.said("estimator").entries["session"] == "described"
        ),
        PATIENCE,
    ), operator.heard.said("estimator")
    drawn: list[MarkerArray] = []
    operator.node.create_subscription(MarkerArray, "/error_map/arrows", drawn.append, LATCHED_QOS)
    operator.outcome("estimator/identify", PATIENCE)
    assert operator.wait(
        lambda: operator.heard.published.error_map and operator.heard.published.document and drawn, PATIENCE
    )
    assert len(drawn[0].markers) == len(operator.heard.published.error_map["x"]) + 2
    direct = identify(open_measurement(bag))
    heard = operator.heard.published.error_map
    for names, values in (("xyz", direct.error_map.points), ("e", direct.error_map.error)):
        fields = list(names) if names == "xyz" else ["ex", "ey", "ez"]
        for j, name in enumerate(fields):
            assert np.array_equal(heard[name], values[:, j], equal_nan=True)
    assert operator.heard.published.document == json.dumps(direct.document(), allow_nan=False)


@pytest.mark.long
def test_paused_until_it_goes_on(tmp_path: Path, play) -> None:
    operator = play(ticks(tmp_path / "bag"), paused=True)
    heard = ready(operator)
    assert heard.values == [] and set(heard.clock) == {START}
    assert heard.session == ""  # what is at the beginning itself has not been played yet
    operator.call("player/resume", PATIENCE)
    assert operator.wait(lambda: heard.session == "latched", PATIENCE)
    assert operator.wait(lambda: len(heard.values) == 20, PATIENCE)
    assert heard.values == [float(k) for k in range(20)]
    assert operator.wait(lambda: heard.clock[-1] == START + 19 * 50_000_000, PATIENCE)
    assert heard.clock == sorted(heard.clock)


@pytest.mark.long
def test_nothing_is_sent_before_the_delay_is_over(tmp_path: Path, play) -> None:
    operator = play(ticks(tmp_path / "bag"), rate=0.0, delay=10 * PATIENCE)
    heard = Heard(operator)
    assert operator.wait(lambda: operator.node.count_publishers("/joint_states") == 1, PATIENCE)
    operator.call("player/pause", PATIENCE)
    assert heard.values == [] and set(heard.clock) <= {START} and heard.session == ""
    operator.call("player/resume", PATIENCE)
    assert operator.wait(lambda: len(heard.values) == 20, PATIENCE)


@pytest.mark.long
def test_the_rate_is_kept(tmp_path: Path, play) -> None:
    """Never faster than asked; how much slower a busy machine is, is not ours to say."""
    operator = play(ticks(tmp_path / "bag", 21, 200_000_000), rate=4.0, paused=True)
    heard = ready(operator)
    begin = time.monotonic()
    operator.call("player/resume", PATIENCE)
    assert operator.wait(lambda: len(heard.values) == 21, PATIENCE)
    assert time.monotonic() - begin >= 4.0 / 4.0
    assert heard.values == [float(k) for k in range(21)]


def test_as_fast_as_possible_hundreds_are_sent_at_once() -> None:
    one, sent = player.Player.__new__(player.Player), list[int]()  # no node is needed for what is due
    one._pace, one._wait_until, one.sent = player.Pace(0.0, 0, 0), 0, 0
    one._time_topic, one._period, one._last_clock = None, 0, None
    one._outlets = {"/a": SimpleNamespace(send=sent.append)}
    one._messages = (SimpleNamespace(topic="/a", data=k, log_time=1000 * k) for k in range(2000))
    one._next = next(one._messages)
    one._tick()
    assert sent == list(range(player._MESSAGES_AT_ONCE))


def test_as_fast_as_possible_waits_for_whoever_comes_a_little_later(tmp_path: Path, play) -> None:
    operator = play(ticks(tmp_path / "bag"), rate=0.0)
    heard = Heard(operator)
    assert operator.wait(lambda: len(heard.values) == 20, PATIENCE)
    assert heard.values == [float(k) for k in range(20)]


@pytest.fixture
def play_here(verb: Verb, monkeypatch: pytest.MonkeyPatch) -> Verb:
    """`mtcal play` in this process, which keeps its own signals: what is started later would inherit others."""
    monkeypatch.setattr(process, "signal", MagicMock())
    monkeypatch.setattr(process, "_await_stop", lambda *_: None)
    return verb


@pytest.mark.long
def test_it_ends_by_itself_counts_and_says_that_nobody_listened(
    tmp_path: Path, play_here: Verb, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(player, "_FIRST", 10**8)  # ns that somebody who listens is waited for
    words = ("play", ticks(tmp_path / "bag"), "/joint_states", "--fast")
    played = play_here(*words, "--json").document
    assert played == {"format": "mtcal-played/1", "bag": str(words[1]), "messages": 20, "state": "finished"}
    assert "20 messages sent, finished; nobody listened" in play_here(*words).text


def test_wrong_requests_are_one_line(tmp_path: Path, play_here: Verb) -> None:
    assert "no such file" in play_here.refused("play", tmp_path / "none")
    assert "no topic '/nothing'" in play_here.refused("play", ticks(tmp_path / "bag"), "/nothing")
