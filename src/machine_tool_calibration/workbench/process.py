# SPDX-License-Identifier: Apache-2.0
"""A calculation in a process of its own, which is ended at once wherever it is, in the middle of linear algebra too."""

from __future__ import annotations

import logging
import multiprocessing
import signal
from collections.abc import Callable
from multiprocessing import forkserver
from multiprocessing.connection import Connection
from typing import Any

from machine_tool_calibration.errors import CalibrationError
from machine_tool_calibration.workbench.models import Progress

__all__ = ["Calculation", "FaultError", "warm_up"]

# Processes are forked off one that has loaded what calculates and does nothing else: they are there in a few
# milliseconds, and no thread of the page's process was in the middle of anything. Nothing of the page is loaded there.
_PROCESSES = multiprocessing.get_context("forkserver")
_PRELOADED = [f"{__package__}.{name}" for name in ("process", "state", "ahead", "handed_over")]


def warm_up() -> None:
    """Have what calculates loaded while the page is on its way."""
    _PROCESSES.set_forkserver_preload(_PRELOADED)
    forkserver.ensure_running()


class FaultError(Exception):
    """A fault of the package itself; the terminal has said where it comes from."""


class Calculation:
    """One calculation."""

    def __init__(self, work: Callable[[Progress], Any]) -> None:
        self._ours, theirs = _PROCESSES.Pipe()
        self._theirs = theirs
        self._process = _PROCESSES.Process(target=_calculate, args=(theirs, work), daemon=True)
        self._ended = False

    def outcome(self, progress: Callable[[str, float], object]) -> Any:
        """Do it, and wait for it.

        Args:
            progress: told what is being done, and the share that is finished.

        Raises:
            CalibrationError: what the calculation raised, or it was ended.
            OSError: likewise.
            FaultError: it failed otherwise.
        """
        self._process.start()
        self._theirs.close()
        if self._ended:  # before there was anything to end
            self._process.kill()
        try:
            while True:
                done, said = self._ours.recv()
                if done is None:
                    progress(*said)
                elif done:
                    return said
                else:
                    raise said
        except EOFError:
            raise CalibrationError("the process that calculated it has ended") from None
        finally:
            self._ours.close()
            self._process.join()

    def end(self) -> None:
        """Have it end at once; nothing happens where it is over."""
        self._ended = True
        if self._process.pid is not None:
            self._process.kill()


def _calculate(pipe: Connection, work: Callable[[Progress], Any]) -> None:
    """In the process: calculate, and send progress and the outcome."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the page's process, which ends this one
    try:
        pipe.send((True, work(lambda what, share: pipe.send((None, (what, share))))))
    except BrokenPipeError:
        return  # nobody waits for it
    except (CalibrationError, OSError) as error:
        pipe.send((False, error))
    except Exception as error:
        logging.getLogger(__name__).error("a fault of the workbench", exc_info=error)
        pipe.send((False, FaultError(repr(error))))
