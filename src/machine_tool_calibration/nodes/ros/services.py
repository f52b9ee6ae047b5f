# SPDX-License-Identifier: Apache-2.0
"""Services whose answer may come later, what they gave, and long calculations that can be followed and cancelled.

A `std_srvs/Trigger` answers with a sentence. What a program wants of it (values, and why there are none) stands on a
topic `outcome`, which is latched; the goal's id brings both together. It begins the sentence: `goal <id>: …`.

A long calculation is followed as an action's goal is. An action needs a message type of its own, and no package of
standard messages has one that fits. So its parts stand side by side, of standard types, below the node's name:

- `~/<verb>` (`std_srvs/Trigger`) sends a goal: answered at once, with the goal's id;
- `~/cancel` (`action_msgs/CancelGoal`), as that of an action: a goal by its id, or all;
- `~/goals` (`action_msgs/GoalStatusArray`, latched), as an action's status;
- `~/outcome` (`diagnostic_msgs/DiagnosticArray`, latched) in place of its result: id, sentence and values.
"""

import re
import threading
import time
import uuid
from collections import deque
from collections.abc import Awaitable, Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any, TypeVar

from action_msgs.msg import GoalInfo, GoalStatus, GoalStatusArray
from action_msgs.srv import CancelGoal
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.task import Future
from std_srvs.srv import Trigger

from machine_tool_calibration.errors import CalibrationError
from machine_tool_calibration.nodes.ros import messages
from machine_tool_calibration.nodes.ros.node import ManagedNode
from machine_tool_calibration.nodes.ros.process import post
from machine_tool_calibration.progress import Progress

_GOAL = re.compile("goal ([0-9a-f]{32}): ")


class Reply:
    """The answer that a handler owes; `send` it once, from the node's own thread."""

    def __init__(self) -> None:
        self._future: Future = Future()

    def send(self, success: bool, message: str) -> None:
        """Answer the request; a second answer is ignored."""
        if not self._future.done():
            self._future.set_result((success, message))

    async def into(self, response: Trigger.Response) -> Trigger.Response:
        """Wait for the answer, and put it into the response."""
        response.success, response.message = await self._future
        return response


def offer(node: Node, **handlers: Callable[[], str]) -> None:
    """Offer `std_srvs/Trigger`s below the node's name; handlers say what they did or raise what they cannot do."""

    def called(handler: Callable[[], str], reply: Reply) -> None:
        try:
            reply.send(True, handler())
        except CalibrationError as error:
            reply.send(False, str(error))

    for name, handler in handlers.items():
        offer_later(node, f"~/{name}", partial(called, handler))


def offer_later(node: Node, name: str, handler: Callable[[Reply], None]) -> None:
    """Offer a `std_srvs/Trigger` whose handler may send its `Reply` at once or later."""

    def called(_: Trigger.Request, response: Trigger.Response) -> Awaitable[Trigger.Response]:
        answer = Reply()
        handler(answer)
        return answer.into(response)

    # a group of its own: an answer that is owed keeps no other callback waiting
    node.create_service(Trigger, name, called, callback_group=ReentrantCallbackGroup())


def goal_sentence(goal: str, text: str) -> str:
    """The message of a Trigger that is about a goal."""
    return f"goal {goal}: {text}"


def goal_of(message: str) -> str:
    """Id of the goal that the message of a Trigger is about; empty where it is about none."""
    match = _GOAL.match(message)
    return match[1] if match else ""


class Outcomes:
    """Publishes what requests gave; several may end at once, and each outcome is waited for."""

    def __init__(self, node: Node, topic: str = "~/outcome", qos: QoSProfile = messages.OUTCOMES) -> None:
        self._publisher = node.create_publisher(DiagnosticArray, topic, qos)

    def answer(
        self, answers: Iterable[Reply], verb: str, stamp: int, text: str, values: Mapping[str, object], kind: str = ""
    ) -> None:
        """Publish what a request gave at a time, ns, `values` or the `kind` of failure, then answer all who asked."""
        goal = uuid.uuid4().hex
        level = messages.Level.ERROR if kind else messages.Level.OK
        self.tell(verb, goal, stamp, text, {**({"kind": kind} if kind else {}), **values}, level)
        for answer in answers:
            answer.send(not kind, goal_sentence(goal, text))

    def tell(
        self, verb: str, goal: str, stamp: int, text: str, values: Mapping[str, object], level: messages.Level
    ) -> None:
        """Publish an outcome of the goal of that id, at a time, ns."""
        status = messages.status(verb, level, text, values, goal)
        self._publisher.publish(messages.dated(DiagnosticArray(status=[status]), stamp, ""))


Outcome = TypeVar("Outcome")

_GOALS_KEPT = 10  # goals that have ended


class _CancelledError(CalibrationError):
    """Nobody wants the outcome any more."""


@dataclass
class _Goal:
    """One calculation; `status` is one of GoalStatus's."""

    verb: str
    number: uuid.UUID
    stamp: int
    doing: str
    began: float
    status: int = GoalStatus.STATUS_EXECUTING
    is_outdated: bool = False  # what it is about is gone

    def is_meant(self, wanted: GoalInfo) -> bool:
        """As CancelGoal defines it: by the id; without an id all until a time; without either all."""
        number, until = bytes(wanted.goal_id.uuid), messages.from_message(wanted.stamp)
        if any(number):
            return number == self.number.bytes
        return not until or self.stamp <= until


class Goals:
    """The goals of a node, one at a time, each in a thread of its own; `changed` is called when one begins or ends."""

    def __init__(self, node: ManagedNode, changed: Callable[[], None]) -> None:
        self._node, self._changed = node, changed
        self._lock = threading.Lock()
        self._is_closed = False
        self._present: _Goal | None = None
        self._goals: deque[_Goal] = deque(maxlen=_GOALS_KEPT)
        self.step, self.share = "", 0.0  # the part of the present one that is under way, and how much of it is finished
        self.last, self.level = "", messages.Level.OK  # sentence about the one that ended last, and its level
        self._statuses = node.create_publisher(GoalStatusArray, "~/goals", messages.LATCHED)
        self._outcomes = Outcomes(node, qos=messages.LATCHED)
        node.create_service(CancelGoal, "~/cancel", self._cancel)

    @property
    def doing(self) -> str:
        """What is being calculated, for people; empty if nothing is."""
        if self._present is None:
            return ""
        is_cancelling = self._present.status == GoalStatus.STATUS_CANCELING
        return f"cancelling: {self._present.doing}" if is_cancelling else self._present.doing

    @property
    def number(self) -> str:
        """Id of the present goal; empty if there is none."""
        return "" if self._present is None else self._present.number.hex

    def offer(
        self,
        verb: str,
        begin: Callable[[], tuple[str, Callable[[Progress], Outcome]]],
        done: Callable[[Outcome], tuple[str, Mapping[str, object]]],
    ) -> None:
        """Offer a calculation as the service `verb`, below the node's name.

        `begin` gives what is going to be done, for people, and the calculation, which is called in a thread of its own
        and tells its progress now and then; a CalibrationError where nothing can be calculated. `done`, called in the
        node's own thread, publishes the outcome and gives a sentence and values about it.
        """

        def called() -> str:
            if self._present is not None:
                seconds = f"{time.monotonic() - self._present.began:.0f} s so far"
                raise CalibrationError(f"busy: {self.doing} ({seconds}); ask again when that is done")
            doing, work = begin()
            goal = self._present = _Goal(verb, uuid.uuid4(), messages.stamp_now(self._node), doing, time.monotonic())
            self._goals.append(goal)
            self.step, self.share = "", 0.0
            self._show()
            threading.Thread(target=self._run, args=(goal, work, done), name="calculation", daemon=True).start()
            return goal_sentence(goal.number.hex, doing)

        offer(self._node, **{verb: called})

    def forget(self) -> None:
        """What was calculated, or is being, is about what is gone: no sentence is left of it but its outcome."""
        self.last, self.level = "", messages.Level.OK
        if self._present is not None:
            self._present.is_outdated = True

    def close(self) -> None:
        """The node leaves the graph: no outcome is wanted."""
        with self._lock:
            self._is_closed = True

    def _run(self, goal: _Goal, work: Callable[[Progress], Any], done: Callable[[Any], Any]) -> None:
        def tell(step: str, share: float) -> None:
            if self._is_closed or goal.status == GoalStatus.STATUS_CANCELING:
                raise _CancelledError("cancelled")
            self.step, self.share = step, share

        outcome: Any
        try:
            outcome = work(tell)
            tell("done", 1.0)
        except CalibrationError as error:
            outcome = error
        except Exception as error:  # a fault of ours must not end the node
            outcome = CalibrationError(f"unexpected {type(error).__name__}: {error}")
        with self._lock:  # the executor must not be asked once it is being taken down
            if not self._is_closed:
                post(self._node, lambda: self._end(goal, outcome, done))

    def _end(self, goal: _Goal, outcome: Any, done: Callable[[Any], tuple[str, Mapping[str, object]]]) -> None:
        if self._is_closed:  # since it was posted
            return
        self._present, self.step, self.share = None, "", 0.0
        found: Mapping[str, object] = {}
        if not isinstance(outcome, CalibrationError):
            try:
                text, found = done(outcome)
            except Exception as error:  # a client waits for the outcome
                self._node.note_fault(goal.verb, error)
                outcome = CalibrationError(f"unexpected {type(error).__name__}: {error}")
        if isinstance(outcome, _CancelledError):
            goal.status, level, text = GoalStatus.STATUS_CANCELED, messages.Level.WARN, f"cancelled: {goal.doing}"
        elif isinstance(outcome, CalibrationError):
            goal.status, level, text = GoalStatus.STATUS_ABORTED, messages.Level.ERROR, str(outcome)
        else:
            goal.status, level = GoalStatus.STATUS_SUCCEEDED, messages.Level.OK
        if not goal.is_outdated:
            self.last, self.level = text, level
        self._outcomes.tell(goal.verb, goal.number.hex, messages.stamp_now(self._node), text, found, level)
        self._show()

    def _cancel(self, request: CancelGoal.Request, response: CancelGoal.Response) -> CancelGoal.Response:
        meant = [goal for goal in self._goals if goal.is_meant(request.goal_info)]
        present = [goal for goal in meant if goal is self._present]
        for goal in present:
            goal.status = GoalStatus.STATUS_CANCELING
            response.goals_canceling.append(_info(goal))
        is_one = any(request.goal_info.goal_id.uuid)
        if is_one and not meant:
            response.return_code = CancelGoal.Response.ERROR_UNKNOWN_GOAL_ID
        elif is_one and not present:
            response.return_code = CancelGoal.Response.ERROR_GOAL_TERMINATED
        if present:
            self._show()
        return response

    def _show(self) -> None:
        statuses = [GoalStatus(goal_info=_info(goal), status=goal.status) for goal in self._goals]
        self._statuses.publish(GoalStatusArray(status_list=statuses))
        self._changed()


def _info(goal: _Goal) -> GoalInfo:
    info = GoalInfo(stamp=messages.to_message(goal.stamp))
    info.goal_id.uuid = list(goal.number.bytes)
    return info
