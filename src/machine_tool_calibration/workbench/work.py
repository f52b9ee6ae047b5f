# SPDX-License-Identifier: Apache-2.0
"""Work beside the page: in a process of its own, with its progress, a button that ends it, and its errors said."""

import logging
import threading
from collections.abc import Callable
from functools import partial
from html import escape
from typing import Any

import panel as pn

from machine_tool_calibration.errors import CalibrationError
from machine_tool_calibration.workbench.look import bar_button, in_order, tell_faults, text
from machine_tool_calibration.workbench.process import Calculation, FaultError
from machine_tool_calibration.workbench.state import Job

_SOON = 300  # ms after which work is told of, unless it says sooner how far it is


class Work:
    """One piece of work at a time of one window."""

    def __init__(self) -> None:
        self._document = pn.state.curdoc
        self._job: object | None = None
        self._calculation: Calculation | None = None
        self._otherwise: Callable[[], object] = lambda: None
        self._bar = pn.indicators.Progress(value=0, max=100, width=110, height=16, visible=False, margin=(10, 6))
        self._stop = bar_button("Stop", self.stop, "danger", visible=False)
        self._words = text("", min_width=140)
        self.view = pn.Row(self._words, self._bar, self._stop)
        tell_faults(self._document, self.fail)
        # For a window that was closed nobody waits.
        self._document.on_session_destroyed(lambda context: self._rest())

    def say(self, words: str) -> None:
        """A remark, in place of the last one."""
        self._words.object = escape(words)

    def turn_over(self) -> None:
        """Another page is looked at: what went wrong on the last one is no longer said."""
        if "error" in self._words.object:
            self.say("")

    def fail(self, error: BaseException) -> None:
        """Say what went wrong, in one line."""
        if isinstance(error, OSError) and error.filename:
            said = f"{error.filename}: {error.strerror}"
        elif isinstance(error, CalibrationError | OSError):
            said = str(error)
        else:
            said = f"unexpected {error} (a fault of mtcal itself; the terminal shows where it comes from)"
            if not isinstance(error, FaultError):
                logging.getLogger(__name__).error("a fault of the workbench", exc_info=error)
        self._words.object = f'<span class="error" role="alert">{escape(" ".join(said.split()))}</span>'

    def alone(self, act: Callable[[], object]) -> bool:
        """Do something at once, unless something runs, whose outcome is for the page as it is; whether it was done."""
        if self._job is not None:
            self.say("One thing at a time: wait for what is running, or stop it.")
            return False
        act()
        return True

    def run(self, what: str, job: Job, otherwise: Callable[[], object] = lambda: None) -> None:
        """Do something beside the page, `what` in words: a calculation in a process of its own, then what takes it.

        `otherwise` is done where that was not begun, was stopped, or failed: a field tells again what is there.
        """
        if not self.alone(partial(self._begin, what, job, otherwise)):
            otherwise()

    def _begin(self, what: str, job: Job, otherwise: Callable[[], object]) -> None:
        self._otherwise = otherwise
        mine = self._job = object()
        # What is over at once need not be told of: every change of the bar is laid out anew.
        self._document.add_timeout_callback(self._if_runs(mine, partial(self._show, what, None)), _SOON)
        calculation = self._calculation = Calculation(job.work)

        def follow() -> None:
            try:
                found = calculation.outcome(lambda *said: self._later(mine, partial(self._show, *said)))
            except Exception as error:
                self._later(mine, partial(self._done, self._failed, error))
            else:
                self._later(mine, partial(self._done, job.take, found))

        threading.Thread(target=follow, name=f"workbench: {what}", daemon=True).start()

    def stop(self) -> None:
        """End it, wherever it is."""
        if self._job is not None:
            self._rest()
            self.say("Stopped.")
            self._otherwise()

    def _later(self, mine: object, act: Callable[[], None]) -> None:
        """Do something on the page, unless the work was stopped in the meantime."""
        self._document.add_next_tick_callback(self._if_runs(mine, act))

    def _if_runs(self, mine: object, act: Callable[[], None]) -> Callable[[], None]:
        def now() -> None:
            if self._job is mine:
                in_order(self._document, act)

        return now

    def _show(self, what: str, share: float | None) -> None:
        """What is being done, and how much of it is, if that is known."""
        if share is None and self._bar.visible:
            return
        self._bar.value = -1 if share is None else int(100 * min(max(share, 0.0), 1.0))
        self._bar.visible = self._stop.visible = True
        self.say(f"{what} …")

    def _done(self, then: Callable[[Any], None], outcome: Any) -> None:
        self._rest()
        self.say("")
        try:
            then(outcome)
        except Exception as error:
            self._failed(error)

    def _failed(self, error: Exception) -> None:
        self.fail(error)
        self._otherwise()

    def _rest(self) -> None:
        if self._calculation is not None:
            self._calculation.end()
        self._job = self._calculation = None
        self._bar.visible = self._stop.visible = False
