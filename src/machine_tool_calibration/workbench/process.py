# SPDX-License-Identifier: Apache-2.0
"""A calculation in a process of its own, which is ended at once wherever it is, in the middle of linear algebra too."""

from __future__ import annotations

import logging
import multiprocessing
import os
import signal
import threading
from collections.abc import Callable
from multiprocessing import forkserver
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any, ClassVar

from machine_tool_calibration.errors import CalibrationError
from machine_tool_calibration.progress import Progress

# Processes are forked off one that has loaded what calculates and does nothing else: they are there in a few
# milliseconds, and no thread of the page's process was in the middle of anything. Nothing of the page is loaded there.
_PROCESSES = multiprocessing.get_context("forkserver")
_PRELOADED = [f"{__package__}.{name}" for name in ("process", "handed_over")]
_LEAN = 0.6e9  # bytes beyond which a process is not kept for the next calculation


def warm_up() -> None:
    """Have what calculates loaded while the page is on its way."""
    _PROCESSES.set_forkserver_preload(_PRELOADED)
    forkserver.ensure_running()


class FaultError(Exception):
    """A fault of the package itself; the terminal has said where it comes from."""


class Calculation:
    """One calculation, in a process that has done others before, if there is one: what it knows from them is warm."""

    def __init__(self, work: Callable[[Progress], Any]) -> None:
        self._work = work
        self._process: _Process | None = None
        self._ended = False
        self._lock = threading.Lock()

    def outcome(self, progress: Progress) -> Any:
        """Do it, and wait for it.

        A CalibrationError or OSError that the calculation raised, or that it was ended; a FaultError if it failed
        otherwise.
        """
        process = _Process.free()
        with self._lock:
            self._process = process
            if self._ended:  # before there was anything to end
                process.kill()
        try:
            process.pipe.send(self._work)
            while (said := process.pipe.recv())[0] == "progress":
                progress(*said[1])
        except (EOFError, ConnectionError):
            process.kill()
            raise CalibrationError("the process that calculated it has ended") from None
        except BaseException:  # what it says next would be taken for the next one's
            process.kill()
            raise
        with self._lock:
            self._process = None
            if not self._ended:
                process.rest()
        kind, outcome = said
        if kind == "raised":
            raise outcome
        return outcome

    def end(self) -> None:
        """Have it end at once; nothing happens where it is over."""
        with self._lock:
            self._ended = True
            if self._process is not None:
                self._process.kill()


class _Process:
    """Calculates one thing after the other."""

    _idle: ClassVar[list[_Process]] = []

    def __init__(self) -> None:
        self.pipe, theirs = _PROCESSES.Pipe()
        self._process = _PROCESSES.Process(target=_calculate, args=(theirs,), daemon=True)
        self._process.start()
        theirs.close()

    @classmethod
    def free(cls) -> _Process:
        try:
            waiting = cls._idle.pop()
        except IndexError:
            return cls()
        return waiting if waiting._process.is_alive() else cls()

    def rest(self) -> None:
        """Wait for the next calculation; one waits at most, and not with the memory of a large one."""
        if self._idle or _memory(self._process.pid) > _LEAN:
            self.kill()
        else:
            self._idle.append(self)

    def kill(self) -> None:
        self._process.kill()
        self._process.join()


def _memory(process: int | None) -> float:
    """Bytes that a process holds; none where the system does not say."""
    try:
        return float(Path(f"/proc/{process}/statm").read_text(encoding="ascii").split()[1]) * os.sysconf("SC_PAGE_SIZE")
    except (OSError, IndexError, ValueError):
        return 0.0


def _calculate(pipe: Connection) -> None:
    """In the process: calculate, and send "progress" and what was "found" or "raised", again and again."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the page's process, which ends this one
    while True:
        try:
            work = pipe.recv()
        except EOFError:
            return
        try:
            outcome = "found", work(lambda what, share: pipe.send(("progress", (what, share))))
        except BrokenPipeError:
            return  # nobody waits for it
        except (CalibrationError, OSError) as error:
            outcome = "raised", error
        except Exception as error:
            logging.getLogger(__name__).error("a fault of the workbench", exc_info=error)
            outcome = "raised", FaultError(repr(error))
        try:
            pipe.send(outcome)
        except BrokenPipeError:
            return
        del work, outcome
