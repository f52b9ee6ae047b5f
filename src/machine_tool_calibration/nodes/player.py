# SPDX-License-Identifier: Apache-2.0
"""Node `player`: publishes what a bag holds, at its pace or any other.

Messages are published as they are stored, without being decoded. What was latched is latched again. A topic's last
publication is waited for before its queue would overflow: a reliable subscriber loses nothing at full speed.
"""

import time
from dataclasses import dataclass
from pathlib import Path

from rclpy.duration import Duration
from rclpy.publisher import Publisher
from rosgraph_msgs.msg import Clock as ClockMessage

from machine_tool_calibration.errors import CalibrationError, RecordingError
from machine_tool_calibration.nodes.ros.messages import Level, StatusTopic, to_message
from machine_tool_calibration.nodes.ros.node import ManagedNode
from machine_tool_calibration.nodes.ros.services import offer
from machine_tool_calibration.nodes.ros.taps import message_class, qos_profile
from machine_tool_calibration.recording.graph import with_depth
from machine_tool_calibration.recording.metadata import Qos, Topic
from machine_tool_calibration.recording.reader import BagReader, Message


class Pace:
    """A clock that runs at any rate (s of the bag per s; 0 is as fast as possible), stops, goes on and can be set.

    It starts at a time in the bag, ns, and runs from that of a clock that never jumps, ns; until then nothing is due.
    """

    def __init__(self, rate: float, start: int, begin: int, *, paused: bool = False) -> None:
        self.rate = rate
        self.paused = paused
        self._bag, self._wall = start, begin

    def position(self, now: int) -> int:
        """Time in the bag, ns; without a rate, where it was last set."""
        if self.paused or not self.rate:
            return self._bag
        return self._bag + round(max(now - self._wall, 0) * self.rate)

    def is_due(self, time: int, now: int) -> bool:
        """Whether a message of that time in the bag is to be sent."""
        return not self.paused and now >= self._wall and (not self.rate or time <= self.position(now))

    def pause(self, now: int) -> None:
        """Stand."""
        self._bag, self._wall, self.paused = self.position(now), now, True

    def resume(self, now: int) -> None:
        """Go on from where it stands."""
        if self.paused:
            self._wall, self.paused = now, False

    def set(self, time: int, now: int) -> None:
        """Be at a time in the bag."""
        self._bag, self._wall = time, now


_TICK = 0.002  # s
_MESSAGES_AT_ONCE = 500  # messages, so that services are answered in between
# What is sent as fast as possible waits so long for the first subscriber, and then for the others, ns.
_FIRST, _OTHERS = 4_000_000_000, 500_000_000
_SHOW = 0.2  # s
_ACKNOWLEDGE = Duration(seconds=2.0)
_LEAST_DEPTH = 100
_NEVER = ("/rosout", "/parameter_events")


@dataclass
class _Outlet:
    """A topic's publisher, and how much of its queue may be on the way."""

    publisher: Publisher
    depth: int
    reliable: bool
    unacknowledged: int = 0

    def send(self, data: bytes) -> None:
        if self.reliable and self.unacknowledged >= self.depth // 2:
            self.settle()
        self.publisher.publish(data)
        self.unacknowledged += 1

    def settle(self) -> None:
        if self.reliable and self.publisher.get_subscription_count():
            self.publisher.wait_for_all_acked(_ACKNOWLEDGE)
        self.unacknowledged = 0


class Player(ManagedNode):
    """See the module; says on `player/status` where it stands."""

    def _settings(self) -> None:
        self._path, self._rate, self._paused, self._frequency = self.values("bag", "rate", "paused", "clock_rate")
        self._wanted, self._ends, self._delay = self.values("topics", "exit_at_end", "delay")

    def _configure(self) -> None:
        if not self._path:
            raise CalibrationError("the parameter bag is missing: which recording is to be played?")
        self.bag = BagReader(Path(self._path))

    def _activate(self) -> None:
        self.sent, self.trouble, self.heard = 0, "", False
        self._outlets = self._create_outlets({name for name in self._wanted if name}, with_clock=bool(self._frequency))
        self._time_topic = self.create_publisher(ClockMessage, "/clock", 10) if self._frequency else None
        self._period = round(1e9 / self._frequency) if self._frequency else 0
        self._last_clock: int | None = None
        self._status = StatusTopic(self, "player", clock=time.time_ns)
        offer(self, pause=self._pause, resume=self._resume)
        begin = time.monotonic_ns() + round(self._delay * 1e9)
        self._pace = Pace(self._rate, self.bag.first, begin, paused=self._paused)
        self._wait_until = 0 if self._rate else begin + _FIRST
        self._messages = self.bag.messages(self._outlets)
        self._next = next(self._messages, None)
        self._ended = self._next is None
        self.every(_TICK, self._tick)
        self.every(_SHOW, self._show)
        if self._time_topic is not None:
            self.every(1.0 / self._frequency, self._tell_time)
        self._show()

    def _deactivate(self) -> None:
        """Let what was sent arrive."""
        for outlet in self._outlets.values():
            outlet.settle()
        self._show()

    def _create_outlets(self, wanted: set[str], *, with_clock: bool) -> dict[str, _Outlet]:
        names = {name if name.startswith("/") else f"/{name}" for name in wanted}
        if unknown := sorted(names - set(self.bag.topics)):
            known = ", ".join(sorted(self.bag.topics))
            raise CalibrationError(f"{self.bag.path}: no topic {unknown[0]!r}; it holds {known or 'none'}")
        outlets = {}
        for name, topic in self.bag.topics.items():
            if (names and name not in names) or name in _NEVER or (with_clock and name == "/clock"):
                continue
            try:
                if topic.encoding != "cdr":
                    raise CalibrationError(f"its messages are encoded as {topic.encoding!r}, not as cdr")
                kind = message_class(topic.type)
            except CalibrationError as error:
                self.get_logger().warning(f"{name} is not played: {error}")
                continue
            offered = _offered(topic)
            publisher = self.create_publisher(kind, name, qos_profile(offered))
            outlets[name] = _Outlet(publisher, offered.depth, offered.reliability == "reliable")
        return outlets

    def _tick(self) -> None:
        try:
            now = time.monotonic_ns()
            if self._awaits_subscribers(now):
                return
            for _ in range(_MESSAGES_AT_ONCE):
                message = self._next
                if message is None or not self._pace.is_due(message.log_time, now):
                    return
                self._advance(message, now)
        except RecordingError as error:
            self.trouble = str(error)
            self.get_logger().error(self.trouble)
            self._next = None
            self._end()

    def _awaits_subscribers(self, now: int) -> bool:
        """Whether what is sent as fast as possible would be over before anybody is found."""
        if self._wait_until and self._is_heard():
            self._wait_until = min(self._wait_until, now + _OTHERS)
        if now >= self._wait_until:
            self._wait_until = 0
        return self._wait_until > 0

    def _is_heard(self) -> bool:
        self.heard = self.heard or any(o.publisher.get_subscription_count() for o in self._outlets.values())
        return self.heard

    def _advance(self, message: Message, now: int) -> None:
        if not self._pace.rate:
            self._pace.set(message.log_time, now)  # not later, when nothing more would be due
        if self._last_clock is None or message.log_time - self._last_clock >= self._period:
            self._tell_time(message.log_time)
        self._outlets[message.topic].send(message.data)
        self.sent += 1
        self._next = next(self._messages, None)
        if self._next is None:
            self._end()

    def _end(self) -> None:
        self._ended = True
        if not self._is_heard():
            self.get_logger().warning("nobody listened")
        self._pace.pause(time.monotonic_ns())
        self._pace.set(self.bag.last, time.monotonic_ns())
        self._tell_time()
        self._show()
        self.done = self._ends

    def _tell_time(self, at: int | None = None) -> None:
        if self._time_topic is None:
            return
        if at is None:
            at = min(self._pace.position(time.monotonic_ns()), self.bag.last)
            if self._next is not None and self._pace.rate:
                at = min(at, self._next.log_time)  # what is late must not seem to come from the past
        if self._last_clock is not None and at < self._last_clock:
            at = self._last_clock
        self._last_clock = at
        self._time_topic.publish(ClockMessage(clock=to_message(at)))

    def _pause(self) -> str:
        self._pace.pause(time.monotonic_ns())
        self._show()
        return "paused"

    def _resume(self) -> str:
        if self._ended:
            raise CalibrationError("the bag has been played to its end")
        self._pace.resume(time.monotonic_ns())
        self._show()
        return "playing"

    @property
    def state(self) -> str:
        """playing, paused, finished or failed."""
        if self.trouble:
            return "failed"
        if self._ended:
            return "finished"
        return "paused" if self._pace.paused else "playing"

    def _show(self) -> None:
        self._is_heard()  # latched messages are heard after the end as well
        position = min(max(self._pace.position(time.monotonic_ns()), self.bag.first), self.bag.last)
        entries = {
            "state": self.state,
            "position": f"{(position - self.bag.first) / 1e9:.3f}",
            "duration": f"{self.bag.duration:.3f}",
            "messages": self.sent,
            "rate": self._rate,
        }
        level = Level.ERROR if self.trouble else Level.OK
        self._status.show(level, self.trouble or self.state, entries)


def _offered(topic: Topic) -> Qos:
    """What the recorded publishers offered, with a queue that is worth waiting for."""
    if not topic.qos:
        return Qos(depth=_LEAST_DEPTH)
    first = with_depth(topic.name, topic.type, topic.qos[0])
    depth = max(first.depth, 1 if first.latched else _LEAST_DEPTH)
    return Qos(depth=depth, reliability=first.reliability, durability=first.durability)
