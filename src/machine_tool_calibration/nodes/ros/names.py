# SPDX-License-Identifier: Apache-2.0
"""Names that belong to a node: below the node's own name (`~/…`), which a renamed node takes with it.

Earlier releases wrote the kind of node for it: `estimator/status` whatever the estimator was called. For one release a
renamed node offers these names too, unless its parameter `old_names` is false.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from rclpy.qos import QoSProfile

from machine_tool_calibration.nodes.ros.node import GuardedNode
from machine_tool_calibration.nodes.ros.services import Answer, deferred_service

__all__ = ["OwnPublisher", "offer", "own_names"]


def own_names(node: GuardedNode, kind: str, name: str) -> tuple[str, ...]:
    """The names of a topic or service of a node, its own first.

    Args:
        node: whose it is.
        kind: the node's name where nobody renames it.
        name: of the topic or service, below the node's.
    """
    if not node.has_parameter("old_names"):
        node.declare("old_names", True, "a renamed node also has topics and services of the name that it usually has")
    own, old = f"~/{name}", f"{kind}/{name}"
    is_renamed = node.resolve_topic_name(own) != node.resolve_topic_name(old)
    return (own, old) if is_renamed and node.get_parameter("old_names").value else (own,)


class OwnPublisher:
    """Publishes on a topic of the node's own; the arguments are those of `own_names` and of a publisher."""

    def __init__(self, node: GuardedNode, kind: str, name: str, message: Any, qos: QoSProfile) -> None:
        self._publishers = [node.create_publisher(message, topic, qos) for topic in own_names(node, kind, name)]

    def publish(self, message: Any) -> None:
        """Publish a message."""
        for publisher in self._publishers:
            publisher.publish(message)


def offer(node: GuardedNode, kind: str, name: str, handler: Callable[[Answer], None]) -> None:
    """Offer a service of the node's own, with a handler as `deferred_service` takes it."""
    for own in own_names(node, kind, name):
        deferred_service(node, own, handler)
