# SPDX-License-Identifier: Apache-2.0
"""A program's own node beside a graph, live or replayed: hears what its nodes publish, and calls their services."""

import re
import signal
import threading
import time
import uuid
from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager
from functools import partial
from typing import Any, Self

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.client import Client as ServiceClient
from rclpy.context import Context
from rclpy.exceptions import InvalidNamespaceException
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import NodeNameNonExistentError
from rclpy.subscription import Subscription
from rclpy.validate_namespace import validate_namespace
from sensor_msgs.msg import JointState, PointCloud2
from std_msgs.msg import String
from std_srvs.srv import Trigger

from machine_tool_calibration.errors import CalibrationError
from machine_tool_calibration.maps import FIELDS
from machine_tool_calibration.nodes.heard import SERVICES, Call, Heard, NodeState, Offer
from machine_tool_calibration.nodes.ros import messages
from machine_tool_calibration.nodes.ros.node import GuardedNode
from machine_tool_calibration.nodes.ros.process import default_environment, post
from machine_tool_calibration.nodes.ros.services import goal_of
from machine_tool_calibration.recording.graph import GRAPH_TOPICS
from machine_tool_calibration.session.collect import Reading

_SPIN = 0.05  # s between looks at whether something holds, or it is over
_LOOK = 0.5  # s between looks at which services there are
# Of a server that is heard without a status: it may hear of a client later than the client of it, and drops its answer.
_SETTLE = 3.0  # s
_NAME = re.compile("[A-Za-z_][A-Za-z0-9_]*")
_TRIGGER = "std_srvs/srv/Trigger"
_FIELDS = {"error_map": FIELDS, "residuals": ("row", "setup", "residual")}
_STATUSES = {
    **{topic.name: topic.latched for topic in GRAPH_TOPICS if topic.name.endswith("/status")},
    "recorder/status": True,
    "player/status": True,
}
# What ends a program, and what is done by default.
_USUAL = {signal.SIGINT: signal.default_int_handler, signal.SIGTERM: signal.SIG_DFL}


class Client(AbstractContextManager["Client"]):
    """A node in this process, with a context and an executor of its own; a context of Python's, too.

    It hears while `wait`, `call` or `outcome` runs, or, once `listen` was called, in a thread of its own; then `ask`
    is how a service is called. `heard` is told everything; `watch` is called between messages while something is waited
    for, and raises to end the wait. A CalibrationError: the namespace is none.
    """

    def __init__(
        self,
        domain: int | None = None,
        namespace: str = "",
        heard: Heard | None = None,
        watch: Callable[[], None] = lambda: None,
    ) -> None:
        default_environment()
        space = f"/{namespace.strip('/')}"
        try:
            validate_namespace(space)
        except InvalidNamespaceException as error:
            why = str(error).partition("\n")[0].removeprefix("Invalid namespace: ").rstrip(":")
            raise CalibrationError(f"{namespace!r} is no namespace ({why})") from None
        self._context = Context()
        self._context.init(domain_id=domain)
        self.node = GuardedNode(f"mtcal_{uuid.uuid4().hex[:12]}", context=self._context, namespace=space)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self.node)
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._listen, name="listener", daemon=True)
        self._watch, self.heard = watch, heard or Heard()
        self._space = space.strip("/")
        self._names: tuple[str, ...] = ()
        self._clients: dict[str, ServiceClient] = {}
        self._probes: dict[str, Subscription] = {}
        self._known: set[str] = set()  # nodes that know the clients of their services
        self._goals: dict[str, Call] = {}  # which call began a calculation
        self._spinning = self._is_interrupted = False
        is_main = threading.current_thread() is threading.main_thread()
        # The end of a service or of a login (SIGTERM) is as Ctrl-C; what is ignored stays so.
        ours = [number for number, usual in _USUAL.items() if is_main and signal.getsignal(number) is usual]
        self._before = {number: signal.signal(number, self._interrupt) for number in ours}
        self._subscribe(self.heard)
        self.node.every(_LOOK, self._look_around)

    def _subscribe(self, heard: Heard) -> None:
        subscribe = self.node.create_subscription
        subscribe(String, "session", lambda message: heard.describe(message.data), messages.LATCHED)
        subscribe(JointState, "reading", self._read, messages.READINGS)
        for node in ("estimator", "instrument"):
            subscribe(DiagnosticArray, f"{node}/outcome", partial(self._ended, node), messages.OUTCOMES)
        subscribe(DiagnosticArray, "/diagnostics", self._diagnosed, messages.SLOW)
        for topic, latched in _STATUSES.items():
            tell = partial(self._said, topic.rpartition("/")[0])
            subscribe(DiagnosticArray, topic, tell, messages.LATCHED if latched else messages.STATE)
        for topic in _FIELDS:
            subscribe(PointCloud2, topic, partial(self._published, topic), messages.LATCHED)
        subscribe(String, "error_map/result", lambda message: heard.publish(document=message.data), messages.LATCHED)

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Leave the graph."""
        self._over.set()
        for number, before in self._before.items():
            if signal.getsignal(number) == self._interrupt:
                signal.signal(number, before)
        if self._thread.is_alive():
            self._thread.join()
        self._executor.shutdown()
        self.node.destroy_node()
        self._context.try_shutdown()

    def listen(self) -> Self:
        """Hear from now on in a thread of its own."""
        self._thread.start()
        return self

    def _listen(self) -> None:
        while not self._over.is_set():
            self._executor.spin_once(timeout_sec=_SPIN)

    # --- what a program waits for

    def wait(self, until: Callable[[], bool], timeout: float, *, watched: bool = True) -> bool:
        """Hear messages until something holds; False after the timeout, s. If not `watched`, `watch` cannot end it."""
        deadline = time.monotonic() + timeout
        while not until():
            if time.monotonic() > deadline:
                return False
            if watched:
                self._watch()
            self._spinning = True
            try:
                self._executor.spin_once(timeout_sec=_SPIN)
            finally:
                self._spinning = False
            if self._is_interrupted:
                self._is_interrupted = False
                raise KeyboardInterrupt
        return True

    def _interrupt(self, *_: object) -> None:
        """Ctrl-C waits while messages are handled: an exception that comes in the destructor of a future is lost."""
        if not self._spinning:
            raise KeyboardInterrupt
        self._is_interrupted = True

    @property
    def procedure(self) -> NodeState:
        """What the procedure said of itself last, on the topic of its own."""
        return self.heard.said("procedure")

    def has_node(self, name: str) -> bool:
        """Whether a node of that name is in the graph's namespace."""
        return (name, self.node.get_namespace()) in self.node.get_node_names_and_namespaces()

    def call(self, service: str, timeout: float) -> str:
        """Call a `std_srvs/Trigger`, give its message; a CalibrationError: missing, refused, or no answer in time."""
        client = self.client(service)
        if not self.wait(client.service_is_ready, timeout):
            raise CalibrationError(f"the service {service} is not there after {timeout:g} s")
        self.wait(lambda: service.rpartition("/")[0] in self._known, min(_SETTLE, timeout))
        future = client.call_async(Trigger.Request())
        if not self.wait(future.done, timeout):
            raise CalibrationError(f"the service {service} did not answer within {timeout:g} s")
        response = future.result()
        if not response.success:
            raise CalibrationError(f"{service}: {response.message}")
        return str(response.message)

    def outcome(self, service: str, timeout: float, in_vain: Callable[[], bool] = lambda: False) -> Mapping[str, str]:
        """Call a service that has an outcome (as `estimator/identify`), wait for it and give its values.

        There are none where it is `in_vain`: the node that was asked has gone. A CalibrationError: it refuses, fails,
        is cancelled, or takes longer than the timeout, s.
        """
        node, goal = service.rpartition("/")[0], goal_of(self.call(service, timeout))
        if not self.wait(lambda: self.heard.outcome(node).device == goal or in_vain(), timeout):
            raise CalibrationError(f"{service} is not done after {timeout:g} s")
        outcome = self.heard.outcome(node)
        if outcome.device != goal:
            return {}
        if outcome.level:
            raise CalibrationError(f"{service}: {outcome.message}")
        return outcome.entries

    def ask(self, offer: Offer) -> None:
        """Ask for a service; `Heard.calls` tells the answer. May be called from any thread."""
        asked = self.heard.ask(offer.service)

        def call() -> None:
            if offer.service not in self._clients:
                asked.answer(False, "the service is not there")
                return
            future = self._clients[offer.service].call_async(Trigger.Request())
            future.add_done_callback(lambda done: self._answered(asked, done.result()))

        post(self.node, call)

    def client(self, service: str, kind: Any = Trigger) -> ServiceClient:
        """The client of a service, of that type where it is new."""
        if service not in self._clients:
            self._clients[service] = self.node.create_client(kind, service)
            # A node hears of both in this order: one whose status comes from now on knows the client.
            name = service.rpartition("/")[0]
            self._known.discard(name)
            if name in self._probes:
                self.node.destroy_subscription(self._probes[name])
            self._probes[name] = self.node.create_subscription(
                DiagnosticArray, f"{name}/status", lambda _: self._known.add(name), messages.LATCHED
            )
        return self._clients[service]

    def _answered(self, call: Call, response: Trigger.Response) -> None:
        goal = goal_of(response.message) if response.success else ""
        if goal:  # a calculation has begun; what it gives is the answer
            self._goals[goal] = call
        else:
            call.answer(response.success, response.message)

    # --- what is heard

    def _ended(self, node: str, message: DiagnosticArray) -> None:
        for outcome in message.status[:1]:
            self.heard.outcomes[node] = _state(node, outcome.name, outcome)
            if (call := self._goals.pop(outcome.hardware_id, None)) is not None:
                call.answer(not outcome.level[0], outcome.message)

    def _read(self, message: JointState) -> None:
        names = tuple(message.name)
        if names == self._names:
            names = self._names  # one object for all readings
        self._names = names
        self.heard.read(messages.from_message(message.header.stamp), Reading(names, message.position))

    def _diagnosed(self, message: DiagnosticArray) -> None:
        prefix = f"{self._space}/" if self._space else ""
        for status in message.status:
            node, _, kind = status.name.partition(": ")
            own = node.removeprefix(prefix)
            if node.startswith(prefix) and "/" not in own:
                self.heard.say(_state(own, kind, status, repeats=True))

    def _said(self, node: str, message: DiagnosticArray) -> None:
        for status in message.status[:1]:
            self.heard.say(_state(node, status.name, status))

    def _published(self, topic: str, message: PointCloud2) -> None:
        found = messages.columns(message)
        if topic == "error_map" and not all(np.isfinite(found[axis]).all() for axis in "xyz"):
            raise CalibrationError("a position is not a number")
        self.heard.publish(**{topic: {name: found[name] for name in _FIELDS[topic]}})

    def _look_around(self) -> None:
        """Which services there are, and whether their nodes allow them to move axes."""
        heard, ignored = self.heard, self.node.ignored_entries
        heard.ignored = sum(self.node.ignored.values()), str(ignored["ignored_last"])
        offers, refusing = [], []
        for state in heard.nodes():
            if state.kind not in SERVICES:
                continue
            there = self.services(state.node)
            allowed = state.entries.get("services_move_axes") != "False"
            if not allowed:
                refusing.append(state.node)
            for verb, moves in SERVICES[state.kind].items():
                service = f"{state.node}/{verb}"
                if service in there and (allowed or not moves):
                    self.client(service)
                    offers.append(Offer(service, verb, moves))
        heard.offer(offers, refusing)

    def services(self, name: str) -> set[str]:
        """Triggers that a node has, without the namespace; the graph's list has those that only we ask for too."""
        space = self.node.get_namespace()
        if not _NAME.fullmatch(name):
            return set()
        try:
            found = self.node.get_service_names_and_types_by_node(name, space)
        except NodeNameNonExistentError:
            return set()
        return {service.removeprefix(space).lstrip("/") for service, types in found if _TRIGGER in types}


def _state(node: str, kind: str, status: DiagnosticStatus, *, repeats: bool = False) -> NodeState:
    entries = {entry.key: entry.value for entry in status.values}
    device = "" if status.hardware_id == messages.NO_HARDWARE else status.hardware_id
    return NodeState(node, kind, status.level[0], status.message, entries, device, time.monotonic(), repeats)
