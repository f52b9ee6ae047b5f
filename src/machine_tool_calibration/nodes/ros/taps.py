# SPDX-License-Identifier: Apache-2.0
"""Subscriptions that hand over serialized messages with their times and numbers.

The executor of this release that is fast enough cannot give a message's times, so nobody spins these
subscriptions: whoever owns them takes what has come, every few milliseconds. The middleware stamps each message when it
is sent and when it arrives, so the times do not depend on when it is taken. Of two topics one may arrive late where
others keep the machine busy: in simulated time messages and ticks of the clock are put in order by when they were sent.
"""

import importlib
import time
from bisect import bisect_right
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, field, replace

import rclpy
from rclpy.node import Node
from rclpy.qos import (
    DurabilityPolicy,
    HistoryPolicy,
    QoSCompatibility,
    QoSProfile,
    ReliabilityPolicy,
    qos_check_compatible,
)
from rclpy.serialization import deserialize_message
from rclpy.subscription import Subscription
from rosgraph_msgs.msg import Clock

from machine_tool_calibration.errors import CalibrationError
from machine_tool_calibration.nodes.ros.messages import from_message
from machine_tool_calibration.nodes.ros.sound import require_sound
from machine_tool_calibration.recording.graph import request_for
from machine_tool_calibration.recording.metadata import Qos

_MOST_AT_ONCE = 2000  # messages of one topic, so that no topic keeps the others waiting
_NO_NUMBER = 2**64 - 1
# What any publisher of a clock can give; a lost tick costs no more than its step.
_CLOCK = Qos(depth=1000, reliability="best_effort")
_OVERTAKEN = 1_000_000_000  # ns that a message waits for a tick sent after it, so that none before it is missing
_TICKS_KEPT = 2_000  # ticks that are kept for messages that are still on their way


@dataclass(frozen=True)
class Taken:
    """A serialized message; times in ns."""

    topic: str  # absolute name
    data: bytes  # as it came
    received: int  # by the system's clock
    sent: int  # by the system's clock; when it was received, if the middleware does not tell
    number: int  # that the publisher gave it
    simulated: int = 0  # what the simulated clock showed when it was sent; 0 if that is not known


@dataclass
class Tap:
    """One subscribed topic."""

    topic: str  # absolute name
    type: str  # such as `sensor_msgs/msg/JointState`
    request: Qos  # what it asks of publishers
    subscription: Subscription
    offered: tuple[Qos, ...] = ()  # what they offer, as far as they were discovered
    type_hash: str = ""  # that the publishers tell
    messages: int = 0  # taken so far
    lost: int = 0  # that the publisher sent after the first one taken and that never came
    _last: int = field(default=0, repr=False)

    @property
    def publishers(self) -> int:
        """Publishers that are matched."""
        return int(self.subscription.get_publisher_count())

    def count(self, number: int) -> None:
        """Note a message's publication number; gaps are losses, as long as there is one publisher."""
        self.messages += 1
        if number in (0, _NO_NUMBER) or len(self.offered) > 1:
            self._last = 0
            return
        if self._last and number > self._last:
            self.lost += number - self._last - 1
        self._last = number


class Taps:
    """All topics that are recorded."""

    def __init__(self, node: Node, clock: str = "") -> None:
        """A hidden node beside the given one, which nobody spins; messages are dated by the simulated clock, if any."""
        self._node = node
        # remappings are applied by the owner; here they would rename this node too
        self._hidden = rclpy.create_node(
            f"_{node.get_name()}_taps",
            namespace=node.get_namespace(),
            use_global_arguments=False,
            start_parameter_services=False,
            enable_rosout=False,
        )
        self.taps: dict[str, Tap] = {}
        kind = "rosgraph_msgs/msg/Clock"
        # The present one last; one before it is heard until this one is.
        self._clocks = [Tap(clock, kind, _CLOCK, self._subscribe(clock, kind, _CLOCK))] if clock else []
        self._ticks: list[tuple[int, int]] = []  # when each was sent, and what it shows
        self._undated: list[Taken] = []

    def add(self, topic: str, message_type: str, request: Qos | None = None) -> None:
        """Subscribe to an absolute name, as requested or as publishers can give; a CalibrationError: unknown type."""
        if request is None:
            request = request_for(self._offered(topic))
        self.taps[topic] = Tap(topic, message_type, request, self._subscribe(topic, message_type, request))

    def _offered(self, topic: str) -> list[Qos]:
        return [offered_qos(info.qos_profile) for info in self._node.get_publishers_info_by_topic(topic)]

    def discover(self, topic: str) -> bool:
        """Learn what a topic's publishers offer, and ask for what they can give; whether anything is new."""
        tap = self.taps[topic]
        found = [info for info in self._node.get_publishers_info_by_topic(topic) if info.topic_type == tap.type]
        offered = tuple(offered_qos(info.qos_profile) for info in found)
        if not offered or offered == tap.offered:
            return False
        tap.offered = offered
        tap.type_hash = str(found[0].topic_type_hash)
        best = request_for(offered)
        asked = qos_profile(tap.request)
        unmatched = any(qos_check_compatible(info.qos_profile, asked)[0] == QoSCompatibility.ERROR for info in found)
        # nothing came yet: ask again for what was latched; else only where a publisher cannot be heard
        if best != tap.request and (unmatched or (best.latched and not tap.messages)):
            self._hidden.destroy_subscription(tap.subscription)
            tap.request, tap.subscription = best, self._subscribe(topic, tap.type, best)
        return True

    def follow_clock(self) -> None:
        """Ask for every tick, as soon as it is known that all who publish the clock can give that."""
        if not self._clocks or self._clocks[-1].request.reliability == "reliable":
            return
        topic, kind = self._clocks[-1].topic, self._clocks[-1].type
        offered = self._offered(topic)
        if offered and all(profile.reliability == "reliable" for profile in offered):
            request = replace(_CLOCK, reliability="reliable")
            self._clocks.append(Tap(topic, kind, request, self._subscribe(topic, kind, request)))

    def take(self, *, last: bool = False) -> list[Taken]:
        """What has come, in order, in simulated time of sending, as far as dated: the `last` time nothing waits."""
        taken = [message for tap in self.taps.values() for message in self._take(tap)]
        if self._clocks:
            return self._dated(taken, last)
        return sorted(taken, key=lambda message: message.received)

    def _dated(self, taken: list[Taken], last: bool) -> list[Taken]:
        """Messages with the simulated time at which each was sent, however late they come or are taken."""
        self._hear_clock()
        told, overdue = self._ticks[-1][0] if self._ticks else 0, time.time_ns() - _OVERTAKEN
        ready: list[Taken] = []
        waiting: list[Taken] = []
        for message in (*self._undated, *taken):
            (ready if last or message.sent < told or message.received < overdue else waiting).append(message)
        self._undated = waiting
        return [replace(m, simulated=self._shown(m.sent)) for m in sorted(ready, key=lambda m: m.sent)]

    def _shown(self, sent: int) -> int:
        """What the last tick before shows; what is older than all of them belongs to the first."""
        before = bisect_right(self._ticks, sent, key=lambda tick: tick[0])
        return self._ticks[max(before - 1, 0)][1] if self._ticks else 0

    def _hear_clock(self) -> None:
        ticks = [message for clock in self._clocks for message in self._take(clock)]
        while len(self._clocks) > 1 and self._clocks[-1].messages:
            self._hidden.destroy_subscription(self._clocks.pop(0).subscription)
        new = []
        for tick in ticks:
            message = deserialize_message(tick.data, Clock)
            with suppress(CalibrationError):  # the node's own clock counts them and says so
                require_sound(message)
                new.append((tick.sent, from_message(message.clock)))
        if new:
            self._ticks = sorted([*self._ticks[-_TICKS_KEPT:], *new])

    def close(self) -> None:
        """Unsubscribe."""
        self._hidden.destroy_node()

    def _take(self, tap: Tap) -> Iterator[Taken]:
        """What has come since it was asked before."""
        handle, kind = tap.subscription.handle, tap.subscription.msg_type
        with handle:
            for _ in range(_MOST_AT_ONCE):
                if (found := handle.take_message(kind, True)) is None:
                    return
                data, info = found
                number = info["publication_sequence_number"] or 0
                tap.count(number)
                received, sent = info["received_timestamp"], info["source_timestamp"]
                yield Taken(tap.topic, data, received, sent or received, number)

    def _subscribe(self, topic: str, message_type: str, request: Qos) -> Subscription:
        return self._hidden.create_subscription(
            message_class(message_type), topic, lambda _: None, qos_profile(request), raw=True
        )


def offered_qos(profile: QoSProfile) -> Qos:
    """A publisher's profile as discovery tells it."""
    return Qos(
        history=HistoryPolicy(profile.history).short_key,
        depth=profile.depth,
        reliability=ReliabilityPolicy(profile.reliability).short_key,
        durability=DurabilityPolicy(profile.durability).short_key,
        deadline=profile.deadline.nanoseconds,
        lifespan=profile.lifespan.nanoseconds,
        liveliness=profile.liveliness.short_key,
        lease=profile.liveliness_lease_duration.nanoseconds,
    )


def qos_profile(qos: Qos) -> QoSProfile:
    """The profile of a subscription or publisher that keeps its last messages; what is not known is the usual."""
    best_effort = qos.reliability == "best_effort"
    return QoSProfile(
        depth=qos.depth,
        reliability=ReliabilityPolicy.BEST_EFFORT if best_effort else ReliabilityPolicy.RELIABLE,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if qos.latched else DurabilityPolicy.VOLATILE,
    )


def message_class(message_type: str) -> type:
    """The class of a message type such as `sensor_msgs/msg/JointState`; CalibrationError where it is not installed."""
    parts = message_type.split("/")
    try:
        found: type = getattr(importlib.import_module(f"{parts[0]}.{parts[1]}"), parts[2])
        return found
    except (ImportError, AttributeError, IndexError):
        raise CalibrationError(f"the message type {message_type} is not installed") from None
