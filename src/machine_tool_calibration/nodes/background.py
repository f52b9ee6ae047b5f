"""One long calculation at a time beside a node's own thread, which goes on hearing messages meanwhile."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from typing import TypeVar

from rclpy.node import Node

from machine_tool_calibration.errors import CalibrationError
from machine_tool_calibration.nodes.process import post

__all__ = ["Background", "Progress"]

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
