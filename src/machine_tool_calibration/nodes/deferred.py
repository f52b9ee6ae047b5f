"""A service whose answer may come later than its handler returns."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from rclpy.node import Node

__all__ = ["Answer", "DeferredService"]


class Answer:
    """The answer that a handler owes; `send` it once, from the node's own thread."""

    def __init__(self, response: Any) -> None:
        self.response = response
        self._send: Callable[[Any], None] | None = None
        self._sent = False

    def send(self, success: bool, message: str) -> None:
        """Answer the request; a second answer is ignored."""
        if self._sent:
            return
        self._sent = True
        self.response.success, self.response.message = success, message
        if self._send is not None:
            self._send(self.response)

    @property
    def sent(self) -> bool:
        """Whether it has been answered."""
        return self._sent


class DeferredService:
    """A `std_srvs/Trigger`-like service.

    The events executor of Jazzy knows neither coroutines nor callback groups, and a handler that waits would stop
    the whole node. Executors hand what the handler returns to `Service.send_response` together with the request's
    header: so the handler returns the unsent `Answer`, and the header is kept with it until it is sent.

    Args:
        node: that offers the service.
        kind: the service's type; its response has `success` and `message`.
        name: the service's name.
        handler: called with an `Answer`; may send it at once or later.
    """

    def __init__(self, node: Node, kind: Any, name: str, handler: Callable[[Answer], None]) -> None:
        def called(request: Any, response: Any) -> Answer:
            answer = Answer(response)
            handler(answer)
            return answer

        self.service = node.create_service(kind, name, called)
        now = self.service.send_response

        def later(answer: Answer, header: Any) -> None:
            if answer.sent:
                now(answer.response, header)
            else:
                answer._send = lambda response: now(response, header)

        self.service.send_response = later  # type: ignore[method-assign]
