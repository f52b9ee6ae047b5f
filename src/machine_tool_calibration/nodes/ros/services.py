# SPDX-License-Identifier: Apache-2.0
"""Services whose answer may come later."""

from __future__ import annotations

from collections.abc import Awaitable, Callable

from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.node import Node
from rclpy.task import Future
from std_srvs.srv import Trigger

from machine_tool_calibration.errors import CalibrationError

__all__ = ["Answer", "answer_by", "offer"]


class Answer:
    """The answer that a handler owes; `send` it once, from the node's own thread."""

    def __init__(self) -> None:
        self._future: Future = Future()

    @property
    def sent(self) -> bool:
        """Whether it has been sent."""
        return bool(self._future.done())

    def send(self, success: bool, message: str) -> None:
        """Answer the request; a second answer is ignored."""
        if not self.sent:
            self._future.set_result((success, message))

    async def into(self, response: Trigger.Response) -> Trigger.Response:
        """Wait for the answer, and put it into the response."""
        response.success, response.message = await self._future
        return response


def offer(node: Node, name: str, handler: Callable[[Answer], None]) -> None:
    """Offer a `std_srvs/Trigger` whose answer may come later.

    Args:
        node: that offers the service.
        name: the service's name.
        handler: called with an `Answer`; may send it at once or later.
    """

    def called(_: Trigger.Request, response: Trigger.Response) -> Awaitable[Trigger.Response]:
        answer = Answer()
        handler(answer)
        return answer.into(response)

    # a group of its own: an answer that is owed keeps no other callback waiting
    node.create_service(Trigger, name, called, callback_group=ReentrantCallbackGroup())


def answer_by(handler: Callable[[], str], answer: Answer) -> None:
    """Answer a request by a function that says what it did or raises what it cannot do."""
    try:
        answer.send(True, handler())
    except CalibrationError as error:
        answer.send(False, str(error))
