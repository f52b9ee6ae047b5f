# SPDX-License-Identifier: Apache-2.0
"""A program's own node beside a graph: it hears and asks, and belongs to no measurement."""

from __future__ import annotations

from rclpy.context import Context
from rclpy.exceptions import InvalidNamespaceException
from rclpy.executors import SingleThreadedExecutor
from rclpy.validate_namespace import validate_namespace

from machine_tool_calibration.errors import CalibrationError
from machine_tool_calibration.nodes.ros.node import GuardedNode
from machine_tool_calibration.nodes.ros.process import default_environment

__all__ = ["Guest"]


class Guest:
    """A node with a context and an executor of its own, so that a process may have several.

    Attributes:
        context: of the node.
        node: the node; callbacks run while `hear` does.
        executor: of the node.

    Args:
        name: of the node, which others in the graph must not have.
        domain: ROS domain id; None for that of the environment.
        namespace: of the graph.

    Raises:
        CalibrationError: the namespace is none.
    """

    def __init__(self, name: str, domain: int | None, namespace: str = "") -> None:
        default_environment()
        space = f"/{namespace.strip('/')}"
        try:
            validate_namespace(space)
        except InvalidNamespaceException as error:
            why = str(error).partition("\n")[0].removeprefix("Invalid namespace: ").rstrip(":")
            raise CalibrationError(f"{namespace!r} is no namespace ({why})") from None
        self.context = Context()
        self.context.init(domain_id=domain)
        self.node = GuardedNode(name, context=self.context, namespace=space)
        self.executor = SingleThreadedExecutor(context=self.context)
        self.executor.add_node(self.node)

    def hear(self, timeout: float) -> None:
        """Handle what comes next, or nothing within the timeout, s."""
        self.executor.spin_once(timeout_sec=timeout)

    def close(self) -> None:
        """Leave the graph."""
        self.executor.shutdown()
        self.node.destroy_node()
        self.context.try_shutdown()
