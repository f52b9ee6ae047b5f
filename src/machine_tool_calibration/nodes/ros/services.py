# SPDX-License-Identifier: Apache-2.0
"""Services whose answer may come later, and one long calculation at a time beside a node's own thread."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from typing import Any, TypeVar

from rclpy.node import Node
from rclpy.service import Service
from std_srvs.srv import Trigger

from machine_tool_calibration.errors import CalibrationError
from machine_tool_calibration.nodes.ros.process import post

__all__ = ["Answer", "Background", "Progress", "deferred_service"]


class Answer:
    """The answer that a handler owes; `send` it once, from the node's own thread.

    Attributes:
        response: what is answered.
        sent: whether it has been.
    """

    def __init__(self, response: Trigger.Response) -> None:
        self.response = response
        self.sent = False
        self._send: Callable[[Trigger.Response], None] | None = None

    def send(self, success: bool, message: str) -> None:
        """Answer the request; a second answer is ignored."""
        if self.sent:
            return
        self.sent = True
        self.response.success, self.response.message = success, message
        if self._send is not None:
            self._send(self.response)


def deferred_service(node: Node, name: str, handler: Callable[[Answer], None]) -> Service:
    """Offer a `std_srvs/Trigger` whose answer may come later.

    The events executor of Jazzy knows neither coroutines nor callback groups, and a handler that waits would stop
    the whole node. Executors hand what the handler returns to `Service.send_response` together with the request's
    header: so the handler returns the unsent `Answer`, and the header is kept with it until it is sent.

    Args:
        node: that offers the service.
        name: the service's name.
        handler: called with an `Answer`; may send it at once or later.
    """

    def called(_: Trigger.Request, response: Trigger.Response) -> Answer:
        answer = Answer(response)
        handler(answer)
        return answer

    service = node.create_service(Trigger, name, called)
    now = service.send_response

    def later(answer: Answer | Trigger.Response, header: Any) -> None:
        if not isinstance(answer, Answer):  # of a handler that failed
            now(answer, header)
        elif answer.sent:
            now(answer.response, header)
        else:
            answer._send = lambda response: now(response, header)

    service.send_response = later
    return service


Outcome = TypeVar("Outcome")
Progress = Callable[[str, float], None]
"""Told what is being done, and the share that is finished."""


class _StoppedError(Exception):
    """The node ends; nobody wants the outcome any more."""


class Background:
    """Runs calculations for a node.

    Attributes:
        doing: what is being calculated, for people; empty if nothing is.
        step: the part of it that is under way.
        share: how much of it is finished, 0 to 1.
    """

    def __init__(self, node: Node) -> None:
        self._node = node
        self._lock = threading.Lock()
        self._stopped = False
        self._began = 0.0
        self._thread: threading.Thread | None = None
        self.doing, self.step, self.share = "", "", 0.0

    @property
    def busy(self) -> bool:
        """Whether a calculation is under way, or its outcome has not been taken yet."""
        return self._thread is not None

    @property
    def seconds(self) -> float:
        """How long the present one has run, s."""
        return time.monotonic() - self._began

    def start(self, doing: str, work: Callable[[Progress], Outcome], done: Callable[[Outcome | str], None]) -> None:
        """Begin a calculation; only while none is under way.

        Args:
            doing: what it is, for people.
            work: the calculation, called in a thread of its own; it tells its progress now and then.
            done: called in the node's own thread with the outcome, or with a sentence if there is none.
        """
        assert not self.busy

        def run() -> None:
            outcome: Outcome | str
            try:
                outcome = work(self._tell)
            except _StoppedError:
                return
            except CalibrationError as error:
                outcome = str(error)
            except Exception as error:  # a fault of ours must not end the node
                outcome = f"unexpected {type(error).__name__}: {error}"
            with self._lock:  # the executor must not be asked once it is being taken down
                if not self._stopped:
                    post(self._node, lambda: self._finish(done, outcome))

        self.doing, self.step, self.share = doing, "", 0.0
        self._began = time.monotonic()
        self._thread = threading.Thread(target=run, name="calculation", daemon=True)
        self._thread.start()

    def stop(self) -> None:
        """The node ends: the outcome of what is under way is not wanted."""
        with self._lock:
            self._stopped = True

    def _tell(self, step: str, share: float) -> None:
        if self._stopped:
            raise _StoppedError
        self.step, self.share = step, share

    def _finish(self, done: Callable[[Outcome | str], None], outcome: Outcome | str) -> None:
        self._thread = None
        self.doing, self.step, self.share = "", "", 0.0
        done(outcome)
