# SPDX-License-Identifier: Apache-2.0
"""Node `recorder`: writes the graph's topics, or any others, to a bag."""

from collections.abc import Callable
from datetime import datetime
from pathlib import Path

from machine_tool_calibration.errors import CalibrationError, RecordingError
from machine_tool_calibration.nodes.ros.messages import Level, StatusTopic, now, status
from machine_tool_calibration.nodes.ros.node import ManagedNode
from machine_tool_calibration.nodes.ros.taps import Taken, Tap, Taps
from machine_tool_calibration.recording.graph import GRAPH_TOPICS, belongs_to_graph, with_depth
from machine_tool_calibration.recording.metadata import Qos
from machine_tool_calibration.recording.writer import BagWriter

_TAKE = 0.004  # s
_DISCOVER = 0.2  # s
_SHOW = 0.5  # s
_NEVER = ("/rosout", "/parameter_events", "/clock")


class Recorder(ManagedNode):
    """Records serialized messages as they come; says on `recorder/status` what it has and what it lacks."""

    _folder, _bags = "", 0  # the parameter, and how many bags it has begun by it

    def _settings(self) -> None:
        before, (topics, self._everything, self._folder) = self._folder, self.values("topics", "all_topics", "folder")
        self._bags = self._bags if before == self._folder else 0
        self._wanted = {self.resolve_topic_name(name) for name in topics if name}
        names = ("split_size", "split_duration", "flush_period")
        self._split_bytes, self._split_time, self._flush = self.values(*names)

    def _activate(self) -> None:
        """A recording begins, in a bag of its own; further ones have numbers after the folder."""
        folder = self._folder or f"recording_{datetime.now():%Y%m%d_%H%M%S}"
        number = f"_{self._bags + 1}" if self._folder and self._bags else ""
        self._status = StatusTopic(self, "recorder")
        self._ignored = {*_NEVER, self.resolve_topic_name("~/status")}
        self._refused: dict[str, str] = {}
        self._taken = 0
        self.trouble = ""
        self._waiting = self.lives_in_simulated_time
        path = Path(f"{Path(folder)}{number}")
        self.bag = BagWriter(
            path, flush_seconds=self._flush, split_bytes=self._split_bytes, split_seconds=self._split_time
        )
        self._bags += 1
        self.taps = Taps(self, self.resolve_topic_name("/clock") if self._waiting else "")
        for topic in GRAPH_TOPICS:  # whose type is known: they need no publisher to be subscribed to
            name = self.resolve_topic_name(topic.name)
            if not self._wanted or name in self._wanted:
                durability = "transient_local" if topic.latched else "volatile"
                self._add(name, topic.type, Qos(depth=20000 if topic.latched else 1000, durability=durability))
        self._discover()
        self._show()
        self.every(_TAKE, self._take)
        self.every(_DISCOVER, self._discover)
        self.every(_SHOW, self._show)
        self.get_logger().info(f"recording to {self.bag.folder}")

    def _deactivate(self) -> None:
        """Take what has come, end the bag and say what it holds."""
        try:
            self._take(last=True)
            self.bag.close()
        except RecordingError as error:
            self.trouble = str(error)
            self.get_logger().error(str(error))
        self._show()
        if self._waiting:
            self.get_logger().warning("there was no /clock: nothing could be dated, so nothing was written")
        lost = self.lost
        text = f"{self.bag.folder}: {self.bag.messages} messages of {len(self.bag.topics)} topics, {lost} lost"
        (self.get_logger().warning if lost else self.get_logger().info)(text)
        self.taps.close()

    @property
    def lost(self) -> int:
        """Messages that never came or could not be written."""
        return self._taken - self.bag.messages + sum(tap.lost for tap in self.taps.taps.values())

    def _discover(self) -> None:
        self.taps.follow_clock()
        for name, types in self.get_topic_names_and_types():
            if name in self._ignored or name in self._refused:
                continue
            if name not in self.taps.taps:
                of_graph = not self._wanted and belongs_to_graph(name, self.get_namespace())
                if not (name in self._wanted or of_graph or self._everything) or not self.count_publishers(name):
                    continue
                self._add(name, types[0])
            if name in self.taps.taps and self.taps.discover(name):
                self._register(self.taps.taps[name])

    def _add(self, name: str, kind: str, request: Qos | None = None) -> None:
        try:
            self.taps.add(name, kind, request)
        except CalibrationError as error:
            self._refused[name] = str(error)
            self.get_logger().warning(f"{name} is not recorded: {error}")

    def _register(self, tap: Tap) -> None:
        # a standard type's definition and hash are known; else the publisher tells the hash
        offered = tuple(with_depth(tap.topic, tap.type, profile) for profile in tap.offered)
        self.bag.add_topic(tap.topic, tap.type, qos=offered, type_hash=tap.type_hash)

    def _take(self, *, last: bool = False) -> None:
        if self._waiting:
            # in simulated time nothing can be dated before the first clock message; the middleware keeps what comes
            self._waiting = now(self) == 0
            if self._waiting:
                return
        simulated = self.lives_in_simulated_time
        for message in self.taps.take(last=last):
            self._taken += 1
            time = (message.simulated or now(self)) if simulated else message.received
            self._guarded(self._write, message, time)
        self._guarded(self.bag.tick)
        if not self.bag.waits:  # whatever a full disk had refused is written
            self.trouble = ""

    def _write(self, message: Taken, time: int) -> None:
        if not self.bag.has(message.topic):
            self.taps.discover(message.topic)
            self._register(self.taps.taps[message.topic])
        self.bag.write(message.topic, message.data, time, message.sent, message.number)

    def _guarded(self, action: Callable[..., None], *arguments: object) -> None:
        """A disk that is full must not end the recorder: there may be room again."""
        try:
            action(*arguments)
        except RecordingError as error:
            if not self.trouble:
                self.get_logger().error(str(error))
            self.trouble = str(error)

    def _show(self) -> None:
        """Latched, so that a starter learns at any time that all it needs is subscribed to."""
        taps = self.taps.taps
        lost = self.lost
        level, text = Level.OK, "recording"
        if self._waiting:
            level, text = Level.WARN, "waiting for /clock"
        elif self.trouble:
            level, text = Level.ERROR, self.trouble
        elif lost:
            level, text = Level.WARN, f"recording; {lost} messages were lost"
        overall = {
            "state": "waiting" if self._waiting else "recording",
            "bag": self.bag.folder.resolve(),
            "topics": len(taps),
            "messages": self.bag.messages,
            "lost": lost,
            "size": self.bag.size,
            **{f"not recorded {name}": reason for name, reason in self._refused.items()},
        }
        topics = []
        for name, tap in sorted(taps.items()):
            values = {"type": tap.type, "publishers": tap.publishers, "messages": tap.messages, "lost": tap.lost}
            topics.append(status(name, Level.WARN if tap.lost else Level.OK, "subscribed", values))
        self._status.say(level, text, overall, topics)
