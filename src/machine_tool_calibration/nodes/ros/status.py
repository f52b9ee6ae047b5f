# SPDX-License-Identifier: Apache-2.0
"""What a node says of itself: latched on a topic of its own, and once a second on `/diagnostics`.

That follows the convention of `diagnostic_updater` (REP 107): an entry named `<node>: <what>`, again and again, so that
an aggregator notices a node that has fallen silent.
"""

import time
from collections.abc import Callable, Mapping, Sequence

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.publisher import Publisher

from machine_tool_calibration.nodes.ros.messages import LATCHED, NO_HARDWARE, SLOW, Level, now, status, to_message
from machine_tool_calibration.nodes.ros.node import GuardedNode

_PERIOD = 1.0  # s of the wall clock; an aggregator takes a node for silent after 5 s


class StatusTopic:
    """Says how a node is, and the device behind it, on a topic of its own: `~/status`, latched, by default.

    The clock gives the stamps, ns; by default ROS time. As long as it gives 0, the wall clock does.
    """

    def __init__(
        self,
        node: GuardedNode,
        name: str,
        *,
        publisher: Publisher | None = None,
        hardware_id: str = NO_HARDWARE,
        clock: Callable[[], int] | None = None,
    ) -> None:
        self._node = node
        self._publisher = publisher or node.create_publisher(DiagnosticArray, "~/status", LATCHED)
        self._name, self._hardware = name, hardware_id
        self._clock = clock or (lambda: now(node))
        self._said: tuple[Level, str, Mapping[str, object], Sequence[DiagnosticStatus]] | None = None
        self._ignored = node.ignored_entries
        self._is_dated = True
        self._common = node.create_publisher(DiagnosticArray, "/diagnostics", SLOW)
        node.every(_PERIOD, self._repeat)

    def say(
        self, level: Level, text: str, entries: Mapping[str, object], more: Sequence[DiagnosticStatus] = ()
    ) -> None:
        """Publish a status; the messages that were ignored are added, `more` entries to the node's own topic only."""
        self._said, self._ignored = (level, text, entries, more), self._node.ignored_entries
        self._is_dated = self._clock() > 0
        self._publisher.publish(self._message([self._own(level, text, entries), *more]))

    def show(self, level: Level, text: str, entries: Mapping[str, object]) -> None:
        """As `say`, where anything has changed since it was said last."""
        if self._said != (level, text, entries, ()):
            self.say(level, text, entries)

    def _own(self, level: Level, text: str, entries: Mapping[str, object]) -> DiagnosticStatus:
        return status(self._name, level, text, {**entries, **self._ignored}, self._hardware)

    def _repeat(self) -> None:
        if self._said is None:
            return
        is_dated_now = not self._is_dated and self._clock() > 0  # simulated time has begun
        if is_dated_now or self._ignored != self._node.ignored_entries:
            self.say(*self._said)
        own = self._own(*self._said[:3])
        own.name = f"{self._node.get_fully_qualified_name().lstrip('/')}: {own.name}"
        self._common.publish(self._message([own]))

    def _message(self, entries: list[DiagnosticStatus]) -> DiagnosticArray:
        message = DiagnosticArray(status=entries)
        message.header.stamp = to_message(self._clock() or time.time_ns())
        return message
