# SPDX-License-Identifier: Apache-2.0
"""Work beside the page: in a thread, with its progress, a button to stop it, and its errors said on the page."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable
from functools import partial
from html import escape
from typing import Any, TypeVar

import panel as pn

from machine_tool_calibration.errors import CalibrationError
from machine_tool_calibration.workbench.look import bar_button, text

__all__ = ["Progress", "Work"]

Progress = Callable[[str, float], None]
Outcome = TypeVar("Outcome")


class _StoppedError(Exception):
    """The user does not wait for it any longer."""


class Work:
    """One piece of work at a time of one window.

    The thread ends where the work next reports its progress; what it would have found is not used, and the page can be
    used at once.
    """

    def __init__(self) -> None:
        self._document = pn.state.curdoc
        self._job: object | None = None
        self._bar = pn.indicators.Progress(value=0, max=100, width=220, height=16, visible=False, margin=(10, 6))
        self._stop = bar_button("Stop", self.stop, "danger", visible=False)
        self._words = text("", min_width=200)
        self.view = pn.Row(self._words, self._bar, self._stop, sizing_mode="stretch_width", min_height=36)

    def say(self, words: str) -> None:
        """A remark, in place of the last one."""
        self._words.object = escape(words)

    def fail(self, error: BaseException) -> None:
        """Say what went wrong, in one line."""
        if isinstance(error, CalibrationError | OSError):
            said = str(error)
        else:
            said = f"unexpected {error!r} (a fault of mtcal itself; the terminal shows where it comes from)"
            logging.getLogger(__name__).error("a fault of the workbench", exc_info=error)
        self._words.object = f'<span class="error" role="alert">{escape(" ".join(said.split()))}</span>'

    def run(self, what: str, job: Callable[[Progress], Outcome], then: Callable[[Outcome], None]) -> None:
        """Do something beside the page.

        Args:
            what: is being done, in words.
            job: the work, given what it reports its progress to: what is being done and the share that is finished.
            then: takes the outcome, on the page again.
        """
        if self._job is not None:
            self.say("One thing at a time: wait for what is running, or stop it.")
            return
        mine = self._job = object()
        self.say(f"{what} …")
        self._bar.value, self._bar.visible, self._stop.visible = -1, True, True

        def report(what: str, share: float) -> None:
            if self._job is not mine:
                raise _StoppedError
            self._later(mine, partial(self._show, what, share))

        def whole() -> None:
            try:
                outcome = job(report)
            except _StoppedError:
                return
            except Exception as error:
                self._later(mine, partial(self._done, self.fail, error))
            else:
                self._later(mine, partial(self._done, then, outcome))

        threading.Thread(target=whole, name=f"workbench: {what}", daemon=True).start()

    def stop(self) -> None:
        """Wait for it no longer."""
        self._rest()
        self.say("Stopped.")

    def _later(self, mine: object, act: Callable[[], None]) -> None:
        """Do something on the page, unless the work was stopped in the meantime."""

        def now() -> None:
            if self._job is mine:
                act()

        self._document.add_next_tick_callback(now)

    def _show(self, what: str, share: float) -> None:
        self._bar.value = int(100 * min(max(share, 0.0), 1.0))
        self.say(f"{what} …")

    def _done(self, then: Callable[[Any], None], outcome: Any) -> None:
        self._rest()
        self.say("")
        try:
            then(outcome)
        except Exception as error:
            self.fail(error)

    def _rest(self) -> None:
        self._job = None
        self._bar.visible = self._stop.visible = False
