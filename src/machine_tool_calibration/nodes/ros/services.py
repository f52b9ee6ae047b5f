# SPDX-License-Identifier: Apache-2.0
"""Services whose answer may come later, and what they gave.

A `std_srvs/Trigger` answers with a sentence. What a program wants of it (values, and why there are none) stands on a
topic `outcome`, which is latched; the goal's id brings both together. It begins the sentence: `goal <id>: …`.
"""

from __future__ import annotations

import re
import uuid
from collections.abc import Awaitable, Callable, Iterable, Mapping

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.task import Future
from std_srvs.srv import Trigger

from machine_tool_calibration.errors import CalibrationError
from machine_tool_calibration.nodes.ros.messages import OUTCOMES, Level, dated, status

__all__ = ["Outcomes", "Reply", "answer_by", "goal_of", "goal_sentence", "offer"]

_GOAL = re.compile("goal ([0-9a-f]{32}): ")


class Reply:
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


def offer(node: Node, name: str, handler: Callable[[Reply], None]) -> None:
    """Offer a `std_srvs/Trigger` whose answer may come later.

    Args:
        node: that offers the service.
        name: the service's name.
        handler: called with a `Reply`; may send it at once or later.
    """

    def called(_: Trigger.Request, response: Trigger.Response) -> Awaitable[Trigger.Response]:
        answer = Reply()
        handler(answer)
        return answer.into(response)

    # a group of its own: an answer that is owed keeps no other callback waiting
    node.create_service(Trigger, name, called, callback_group=ReentrantCallbackGroup())


def answer_by(handler: Callable[[], str], answer: Reply) -> None:
    """Answer a request by a function that says what it did or raises what it cannot do."""
    try:
        answer.send(True, handler())
    except CalibrationError as error:
        answer.send(False, str(error))


def goal_sentence(goal: str, text: str) -> str:
    """The message of a Trigger that is about a goal."""
    return f"goal {goal}: {text}"


def goal_of(message: str) -> str:
    """Id of the goal that the message of a Trigger is about; empty where it is about none."""
    match = _GOAL.match(message)
    return match[1] if match else ""


class Outcomes:
    """Publishes what requests gave.

    Args:
        node: that publishes.
        topic: name of the topic.
        qos: of it; several requests may end at once, and each outcome is waited for.
    """

    def __init__(self, node: Node, topic: str = "~/outcome", qos: QoSProfile = OUTCOMES) -> None:
        self._publisher = node.create_publisher(DiagnosticArray, topic, qos)

    def answer(
        self, answers: Iterable[Reply], verb: str, stamp: int, text: str, values: Mapping[str, object], kind: str = ""
    ) -> None:
        """Publish what a request gave, then answer all who asked.

        Args:
            answers: that are owed.
            verb: what was asked for.
            stamp: when it is so, ns.
            text: one sentence for people.
            values: for programs, SI.
            kind: why there is nothing, in a word; empty where there is.
        """
        goal = uuid.uuid4().hex
        level = Level.ERROR if kind else Level.OK
        self.tell(verb, goal, stamp, text, {**({"kind": kind} if kind else {}), **values}, level)
        for answer in answers:
            answer.send(not kind, goal_sentence(goal, text))

    def tell(
        self, verb: str, goal: str, stamp: int, text: str, values: Mapping[str, object], level: Level = Level.OK
    ) -> None:
        """Publish an outcome.

        Args:
            verb: what was asked for.
            goal: id of the request.
            stamp: when it is so, ns.
            text: one sentence for people.
            values: for programs, SI.
            level: whether it succeeded.
        """
        self._publisher.publish(dated(DiagnosticArray(status=[status(verb, level, text, values, goal)]), stamp, ""))
