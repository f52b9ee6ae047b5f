# SPDX-License-Identifier: Apache-2.0
"""Listens to a graph beside it, live or replayed, in a thread of its own, and asks its nodes for services."""

from __future__ import annotations

import os
import re
import threading
import time
from functools import partial

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.client import Client
from rclpy.node import NodeNameNonExistentError
from sensor_msgs.msg import JointState, PointCloud2
from std_msgs.msg import String
from std_srvs.srv import Trigger

from machine_tool_calibration.errors import CalibrationError
from machine_tool_calibration.maps import FIELDS
from machine_tool_calibration.nodes.heard import SERVICES, Heard, NodeState, Offer
from machine_tool_calibration.nodes.ros.guest import Guest
from machine_tool_calibration.nodes.ros.messages import (
    LATCHED,
    NO_HARDWARE,
    READINGS,
    SLOW,
    STATE,
    columns,
    from_message,
)
from machine_tool_calibration.nodes.ros.process import post
from machine_tool_calibration.recording.graph import GRAPH_TOPICS
from machine_tool_calibration.session.collect import Reading

__all__ = ["Listener"]

_REST = 0.1  # s between looks at whether it is over
_LOOK = 0.5  # s between looks at which services there are
_NAME = re.compile("[A-Za-z_][A-Za-z0-9_]*")
_GOAL = re.compile("goal ([0-9a-f]{32}): ")
_TRIGGER = "std_srvs/srv/Trigger"
_FIELDS = {"error_map": FIELDS, "residuals": ("row", "setup", "residual")}
_STATUSES = {
    **{topic.name: topic.latched for topic in GRAPH_TOPICS if topic.name.endswith("/status")},
    "recorder/status": True,
    "player/status": True,
}


class Listener:
    """A node beside the graph, until it is closed.

    Args:
        heard: is told everything.
        domain: ROS domain id; None for that of the environment.
        namespace: of the graph.
    """

    def __init__(self, heard: Heard, domain: int | None = None, namespace: str = "") -> None:
        self._heard = heard
        self._guest = Guest(f"mtcal_listener_{os.getpid()}", domain, namespace)
        self._node = self._guest.node
        self._space = self._node.get_namespace().strip("/")
        self._names: tuple[str, ...] = ()
        self._clients: dict[str, Client] = {}
        self._goals: dict[str, int] = {}  # which call began a calculation
        node = self._node
        node.create_subscription(String, "session", lambda message: heard.describe(message.data), LATCHED)
        node.create_subscription(JointState, "reading", self._read, READINGS)
        node.create_subscription(DiagnosticArray, "estimator/outcome", self._ended, LATCHED)
        node.create_subscription(DiagnosticArray, "/diagnostics", self._diagnosed, SLOW)
        for topic, latched in _STATUSES.items():
            tell = partial(self._said, topic.rpartition("/")[0])
            node.create_subscription(DiagnosticArray, topic, tell, LATCHED if latched else STATE)
        for topic in _FIELDS:
            node.create_subscription(PointCloud2, topic, partial(self._published, topic), LATCHED)
        node.create_subscription(
            String, "error_map/result", lambda message: heard.publish(document=message.data), LATCHED
        )
        node.every(_LOOK, self._look_around)
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._hear, name="listener", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Leave the graph."""
        self._over.set()
        self._thread.join()
        self._guest.close()

    def ask(self, offer: Offer) -> None:
        """Ask for a service; `Heard.calls` tells the answer. May be called from any thread."""
        number = self._heard.ask(offer.service)

        def call() -> None:
            client = self._clients.get(offer.service)
            if client is None:
                self._heard.answer(number, False, "the service is not there")
                return
            asked = client.call_async(Trigger.Request())
            asked.add_done_callback(lambda done: self._answered(number, done.result()))

        post(self._node, call)

    def _answered(self, number: int, response: Trigger.Response) -> None:
        goal = _GOAL.match(response.message) if response.success else None
        if goal is None:
            self._heard.answer(number, response.success, response.message)
        else:  # a calculation has begun; what it gives is the answer
            self._goals[goal[1]] = number

    def _ended(self, message: DiagnosticArray) -> None:
        for outcome in message.status[:1]:
            number = self._goals.pop(outcome.hardware_id, None)
            if number is not None:
                self._heard.answer(number, not outcome.level[0], outcome.message)

    def _hear(self) -> None:
        while not self._over.is_set():
            self._guest.hear(_REST)

    def _read(self, message: JointState) -> None:
        names = tuple(message.name)
        if names == self._names:
            names = self._names  # one object for all readings
        self._names = names
        self._heard.read(from_message(message.header.stamp), Reading(names, message.position))

    def _diagnosed(self, message: DiagnosticArray) -> None:
        prefix = f"{self._space}/" if self._space else ""
        for status in message.status:
            node, _, kind = status.name.partition(": ")
            own = node.removeprefix(prefix)
            if node.startswith(prefix) and "/" not in own:
                self._heard.say(_state(own, kind, status, repeats=True))

    def _said(self, node: str, message: DiagnosticArray) -> None:
        for status in message.status[:1]:
            self._heard.say(_state(node, status.name, status, repeats=False))

    def _published(self, topic: str, message: PointCloud2) -> None:
        found = columns(message)
        if topic == "error_map" and not all(np.isfinite(found[axis]).all() for axis in "xyz"):
            raise CalibrationError("a position is not a number")
        self._heard.publish(**{topic: {name: found[name] for name in _FIELDS[topic]}})

    def _look_around(self) -> None:
        """Which services there are, and whether their nodes allow them to move axes."""
        node, heard = self._node, self._heard
        heard.ignored = sum(node.ignored.values()), str(node.ignored_entries["ignored_last"])
        offers, refusing = [], []
        for state in heard.nodes():
            if state.kind not in SERVICES:
                continue
            there = self._services(state.node)
            allowed = state.entries.get("services_move_axes") != "False"
            if not allowed:
                refusing.append(state.node)
            for verb, moves in SERVICES[state.kind].items():
                service = f"{state.node}/{verb}"
                if service in there and (allowed or not moves):
                    if service not in self._clients:
                        self._clients[service] = node.create_client(Trigger, service)
                    offers.append(Offer(service, verb, moves))
        heard.offer(offers, refusing)

    def _services(self, name: str) -> set[str]:
        """Those that a node has, without the graph's namespace; the graph's list has those that only we ask for too."""
        space = self._node.get_namespace()
        if not _NAME.fullmatch(name):
            return set()
        try:
            found = self._node.get_service_names_and_types_by_node(name, space)
        except NodeNameNonExistentError:
            return set()
        return {service.removeprefix(space).lstrip("/") for service, types in found if _TRIGGER in types}


def _state(node: str, kind: str, status: DiagnosticStatus, *, repeats: bool) -> NodeState:
    return NodeState(
        node=node,
        kind=kind,
        level=status.level[0],
        message=status.message,
        entries={entry.key: entry.value for entry in status.values},
        device="" if status.hardware_id == NO_HARDWARE else status.hardware_id,
        at=time.monotonic(),
        repeats=repeats,
    )
