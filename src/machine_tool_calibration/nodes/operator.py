# SPDX-License-Identifier: Apache-2.0
"""Operates a running graph from a program: calls its services, hears its states, and gathers what it publishes."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.client import Client
from rclpy.qos import QoSProfile
from sensor_msgs.msg import JointState, PointCloud2
from std_msgs.msg import String
from std_srvs.srv import Trigger

from machine_tool_calibration.errors import CalibrationError
from machine_tool_calibration.nodes.heard import SERVICES, NodeState
from machine_tool_calibration.nodes.ros.guest import Guest
from machine_tool_calibration.nodes.ros.messages import LATCHED, READINGS, values

__all__ = ["Operator"]

_SPIN = 0.05  # s
# Of a server that is heard without a status: it may hear of a client later than the client of it, and drops its answer.
_SETTLE = 3.0  # s
_STATUSES = ("procedure", "estimator", "recorder")
_SERVICES = [f"{node}/{verb}" for node, verbs in SERVICES.items() for verb in verbs]


class Operator:
    """A node in this process, as a context.

    Args:
        domain: ROS domain id.
        namespace: of the graph.
        watch: called between messages; raises to end a wait.
    """

    def __init__(self, domain: int, namespace: str = "", watch: Callable[[], None] = lambda: None) -> None:
        self._watch = watch
        self._guest = Guest(f"mtcal_{int(time.monotonic() * 1e3) % 1_000_000}", domain, namespace)
        self._node = self._guest.node
        self.procedure, self.estimator, self.recorder = (NodeState(node, node) for node in _STATUSES)
        self.outcome = NodeState("estimator", "")
        self.session = ""
        self.readings: list[JointState] = []
        self.document = ""
        self.error_map: PointCloud2 | None = None
        self._others: set[str] = set()
        # Before the subscriptions: nodes hear of both in this order, so one whose status came knows the clients.
        self._clients = {name: self._node.create_client(Trigger, name) for name in _SERVICES}
        heard: tuple[tuple[str, Any, Callable[[Any], None], QoSProfile], ...] = (
            *((f"{node}/status", DiagnosticArray, partial(self._keep_status, node), LATCHED) for node in _STATUSES),
            ("estimator/outcome", DiagnosticArray, partial(self._keep_status, "outcome"), LATCHED),
            ("session", String, self._keep_session, LATCHED),
            ("reading", JointState, self.readings.append, READINGS),
            ("error_map/result", String, self._keep_document, LATCHED),
            ("error_map", PointCloud2, self._keep_map, LATCHED),
        )
        for topic, kind, keep, qos in heard:
            self._node.create_subscription(kind, topic, keep, qos)

    def __enter__(self) -> Operator:
        return self

    def __exit__(self, *_: object) -> None:
        self._guest.close()

    def _keep_status(self, node: str, message: DiagnosticArray) -> None:
        status = message.status[0]
        said = NodeState(node, status.name, status.level[0], status.message, values(message), status.hardware_id)
        setattr(self, node, said)

    def _keep_session(self, message: String) -> None:
        self.session = message.data

    def _keep_document(self, message: String) -> None:
        self.document = message.data

    def _keep_map(self, message: PointCloud2) -> None:
        self.error_map = message

    def wait(self, until: Callable[[], bool], timeout: float) -> bool:
        """Hear messages until something holds; False if it does not within the timeout, s."""
        deadline = time.monotonic() + timeout
        while not until():
            if time.monotonic() > deadline:
                return False
            self._watch()
            self._guest.hear(_SPIN)
        return True

    def has_node(self, name: str) -> bool:
        """Whether a node of that name is in the graph's namespace."""
        space = self._node.get_namespace()
        return (name, space) in self._node.get_node_names_and_namespaces()

    def _has_heard(self, service: str) -> bool:
        """Whether a status of the service's node has come, which then knows the clients that were made before."""
        name = service.partition("/")[0]
        if name == "procedure":
            return bool(self.procedure.entries)
        if name == "estimator":
            return bool(self.estimator.entries)
        return name in self._others

    def _client(self, service: str) -> Client:
        """The client of a service, made with what tells when its server knows it."""
        if service not in self._clients:
            self._clients[service] = self._node.create_client(Trigger, service)
            name = service.partition("/")[0]
            self._others.discard(name)  # what was heard before says nothing about this client
            self._node.create_subscription(DiagnosticArray, f"{name}/status", lambda _: self._others.add(name), LATCHED)
        return self._clients[service]

    def call(self, service: str, timeout: float) -> str:
        """Call a `std_srvs/Trigger` and give its message.

        Raises:
            CalibrationError: the service is missing, refuses, or does not answer in time.
        """
        client = self._client(service)
        if not self.wait(client.service_is_ready, timeout):
            raise CalibrationError(f"the service {service} is not there after {timeout:g} s")
        self.wait(lambda: self._has_heard(service), min(_SETTLE, timeout))
        future = client.call_async(Trigger.Request())
        if not self.wait(future.done, timeout):
            raise CalibrationError(f"the service {service} did not answer within {timeout:g} s")
        response = future.result()
        if not response.success:
            raise CalibrationError(f"{service}: {response.message}")
        return str(response.message)

    def calculate(self, verb: str, timeout: float, in_vain: Callable[[], bool] = lambda: False) -> Mapping[str, str]:
        """Have the estimator calculate something, wait for the outcome and give its values.

        Args:
            verb: such as `identify`.
            timeout: s.
            in_vain: whether the estimator that was asked has gone; then there are no values.

        Raises:
            CalibrationError: it refuses, fails, is cancelled, or takes longer than the timeout.
        """
        goal = self.call(f"estimator/{verb}", timeout).removeprefix("goal ").partition(":")[0]
        if not self.wait(lambda: self.outcome.device == goal or in_vain(), timeout):
            raise CalibrationError(f"estimator/{verb} is not done after {timeout:g} s")
        if self.outcome.device != goal:
            return {}
        if self.outcome.level:
            raise CalibrationError(f"estimator/{verb}: {self.outcome.message}")
        return self.outcome.entries
