# SPDX-License-Identifier: Apache-2.0
"""What was heard of a graph so far, for whoever shows it: one thread hears, others look. Needs no ROS."""

import re
import threading
from collections import deque
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.errors import CalibrationError
from machine_tool_calibration.nodes.descriptions import description_of
from machine_tool_calibration.session.collect import Reading, Received

SERVICES: Mapping[str, Mapping[str, bool]] = {
    "estimator": dict.fromkeys(("identify", "compare", "diagnose", "improve", "reset"), False),
    "procedure": {"start": True, "pause": False, "resume": True, "abort": False},
}
"""What nodes are asked for, by what they are, and whether it moves the axes."""

_SILENT = 5.0  # s; a node says how it is once a second
_NODES = 200  # that are kept
_CALLS = 6


@dataclass(frozen=True)
class NodeState:
    """What a node said of itself."""

    node: str  # its name, without the graph's namespace
    kind: str  # what the status is about, such as `instrument` or `axes`, whatever the node's name
    level: int = 0  # 0 as it should be, 1 waiting or stopped, 2 error
    message: str = ""  # one sentence
    entries: Mapping[str, str] = field(default_factory=dict)  # values by key
    device: str = ""  # behind the node
    at: float = 0.0  # when it was heard, s of a clock that never jumps
    repeats: bool = False  # whether it is said once a second, so that silence means something

    def number(self, key: str) -> int:
        """A count among the values; 0 where it is missing or none."""
        text = self.entries.get(key, "")
        return int(text) if re.fullmatch("[0-9]{1,18}", text) else 0

    def silent(self, now: float) -> float:
        """How long a node has said nothing that should have spoken, s; 0 if it speaks."""
        since = now - self.at
        return since if self.repeats and since > _SILENT else 0.0


@dataclass(frozen=True)
class Offer:
    """A service that may be asked for, without the graph's namespace; `verb` is the last part of its name."""

    service: str
    verb: str
    moves_axes: bool = False


@dataclass
class Call:
    """A request to a service, and its answer: `success` is None while there is none."""

    service: str
    success: bool | None = None
    message: str = ""

    def answer(self, success: bool, message: str) -> None:
        """The service answered."""
        self.success, self.message = success, message


@dataclass(frozen=True)
class Published:
    """What an estimator published last."""

    number: int = 0  # grows with every message
    error_map: Mapping[str, Array] = field(default_factory=dict)  # columns of the topic `error_map`, m
    residuals: Mapping[str, Array] = field(default_factory=dict)  # columns of the topic `residuals`, SI
    document: str = ""  # text of the topic `error_map/result`


class Heard:
    """Everything as it was said last."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._received = Received()
        self._rows: list[tuple[int, float]] = []
        self._run = 0
        self._first: int | None = None
        self._spoken: dict[str, NodeState] = {}
        self._said: dict[str, NodeState] = {}
        self._calls: deque[Call] = deque(maxlen=_CALLS)
        self.ignored = (0, "")  # how many messages meant nothing, and why the last one did not
        self.description = ""  # of the session
        self.setups: tuple[str, ...] = ()  # ids of its setups
        self.published = Published()  # by the estimator, last
        self.outcomes: dict[str, NodeState] = {}  # what requests gave, the last one by node
        self.offers: tuple[Offer, ...] = ()  # services that may be asked for
        self.refusing: tuple[str, ...] = ()  # nodes that do not allow their services to move axes

    # --- the thread that hears

    def describe(self, text: str) -> None:
        """The session's description came. A CalibrationError: it is none."""
        setups = tuple(setup.id for setup in description_of(text).setups)
        with self._lock:
            self.description, self.setups = text, setups

    def read(self, stamp: int, reading: Reading) -> None:
        """A reading of that time, ns, came; raises CalibrationError where it cannot be one."""
        columns = dict(zip(reading.names, reading.values, strict=True))
        index, displacement = columns.get("setup_index", np.nan), columns.get("displacement", np.nan)
        with self._lock:
            # The first one again: a replay has begun anew.
            again = stamp == self._first and len(self._received) > 1
            received = Received() if again else self._received
            if received.add(stamp, reading) or again:
                self._received = received
                self._rows, self._run = [], self._run + 1
            if len(self._received) > len(self._rows):
                setup = int(index) if np.isfinite(index) else 0
                self._first = stamp if not self._rows else self._first
                self._rows.append((setup, displacement))

    def say(self, state: NodeState) -> None:
        """A node said how it is, again and again or on a topic of its own; a CalibrationError: too many nodes."""
        states = self._spoken if state.repeats else self._said
        key = f"{state.node}: {state.kind}"
        with self._lock:
            if key not in states and len(states) >= _NODES:
                raise CalibrationError(f"more than {_NODES} nodes")
            states[key] = state

    def publish(self, **changes: Any) -> None:
        """The estimator published a part of its result; the arguments are fields of `Published`."""
        self.published = replace(self.published, number=self.published.number + 1, **changes)

    def offer(self, offers: Iterable[Offer], refusing: Iterable[str] = ()) -> None:
        """These services are there, but not those of the `refusing`; who asks for one that has gone gets no answer."""
        self.offers, self.refusing = tuple(offers), tuple(refusing)
        there = {one.service for one in self.offers}
        for call in self.calls:
            if call.success is None and call.service not in there:
                call.answer(False, "no answer: the node has gone")

    def ask(self, service: str) -> Call:
        """A service is asked for; the call is to be told the answer."""
        call = Call(service)
        with self._lock:
            self._calls.appendleft(call)
        return call

    # --- those who look

    def rows(self, run: int, first: int) -> tuple[int, int, Sequence[tuple[int, float]]]:
        """Readings in the order of their coming, beyond the `first` ones of a run, which are known already.

        The present run, how many of its readings are known, and the others: place of the setup, displacement (m).
        """
        with self._lock:
            known = first if run == self._run else 0
            return self._run, known, self._rows[known:]

    def session(self) -> tuple[str, list[Reading]]:
        """The description and all readings in the order of time."""
        with self._lock:
            return self.description, self._received.in_order()

    @property
    def count(self) -> tuple[int, int]:
        """The present run and how many readings it has."""
        with self._lock:
            return self._run, len(self._received)

    @property
    def missing(self) -> int:
        """Readings of the session that never came, as far as those that came tell."""
        with self._lock:
            return self._received.missing

    @property
    def calls(self) -> list[Call]:
        """The last requests to services, the newest first."""
        with self._lock:
            return list(self._calls)

    def nodes(self) -> list[NodeState]:
        """How the nodes are, by name, each as said last, also on topics of their own where none speaks for long."""
        with self._lock:
            spoken, said = list(self._spoken.values()), list(self._said.values())
        out: list[NodeState] = []
        for kind in dict.fromkeys(one.kind for one in (*spoken, *said)):
            speaking, topics = ([one for one in every if one.kind == kind] for every in (spoken, said))
            last = max((one.at for one in speaking), default=-np.inf)
            newer = [one for one in topics if one.at > last]
            if any(one.at > last + _SILENT for one in newer):
                out += topics
            elif newer and len(speaking) == 1:
                (topic,) = newer[-1:]
                out.append(replace(topic, node=speaking[0].node, at=speaking[0].at, repeats=True))
            else:
                out += speaking
        return sorted(out, key=lambda one: one.node)

    def said(self, node: str) -> NodeState:
        """What a node said last on the topic of its own, such as `procedure/status`."""
        with self._lock:
            return next((one for one in self._said.values() if one.node == node), NodeState(node, node))

    def outcome(self, node: str) -> NodeState:
        """What a node's last request gave; `device` is the goal, empty if there was none."""
        return self.outcomes.get(node, NodeState(node, ""))

    def newest(self, kind: str) -> NodeState | None:
        """What was said last of what is of a kind, such as `procedure`; None if nothing was."""
        with self._lock:
            found = [one for one in (*self._said.values(), *self._spoken.values()) if one.kind == kind]
        return max(found, key=lambda one: one.at, default=None)
