"""Samples of a real instrument, read in a thread of its own."""

from __future__ import annotations

import threading
import time
from collections import deque

import numpy as np

from machine_tool_calibration.instruments.drivers import Driver, InstrumentError
from machine_tool_calibration.nodes.averaging import Batch

__all__ = ["DriverSource"]

_MOST = 1_000_000  # samples that wait to be taken; more are dropped and said so
_AGAIN = 1.0  # s between attempts to connect


class DriverSource:
    """Reads a driver and stamps its samples with ROS time.

    Args:
        driver: not yet opened.
        clock_offset: ROS time minus `time.monotonic`, ns.
    """

    def __init__(self, driver: Driver, clock_offset: int) -> None:
        self._driver, self._offset = driver, clock_offset
        self._samples: deque[tuple[int, float]] = deque(maxlen=_MOST)
        self._reason = ""
        self._problem = "connecting"
        self._reconnections = 0
        self._stopped = threading.Event()
        self._thread = threading.Thread(target=self._read, name="instrument driver", daemon=True)
        self._thread.start()

    def _read(self) -> None:
        while not self._stopped.is_set():
            try:
                self._driver.open()
                break
            except InstrumentError as error:
                self._problem = str(error)
                self._stopped.wait(_AGAIN)
        while not self._stopped.is_set():
            try:
                samples = self._driver.read(0.1)
            except InstrumentError as error:
                self._problem = str(error)
                self._stopped.wait(_AGAIN)
                continue
            for sample in samples:
                if not sample.beam:
                    self._reason = f"the instrument says that the beam is broken {sample.status}".rstrip()
                valid = sample.beam and sample.displacement is not None
                value = float(sample.displacement) if valid and sample.displacement is not None else float("nan")
                self._samples.append((round(sample.time * 1e9) + self._offset, value))
            health = self._driver.health()
            self._problem = "" if health.state == "streaming" else health.problem or f"the instrument is {health.state}"
            if health.reconnections != self._reconnections:
                self._reconnections = health.reconnections
                self._reason = "the link to the instrument was lost; it may have lost its count"

    def take(self, now: int) -> Batch:
        """See `Source`."""
        rows = []
        while self._samples:
            rows.append(self._samples.popleft())
        if not rows:
            return Batch(np.zeros(0, np.int64), np.zeros(0))
        return Batch(np.array([row[0] for row in rows]), np.array([row[1] for row in rows]))

    def lost(self) -> str:
        """See `Source`."""
        reason, self._reason = self._reason, ""
        return reason

    def problem(self) -> str:
        """See `Source`."""
        return self._problem

    def close(self) -> None:
        """See `Source`."""
        self._stopped.set()
        self._driver.close()
        self._thread.join(timeout=1.0)


def clock_offset(ros_now: int) -> int:
    """ROS time minus `time.monotonic`, ns."""
    return ros_now - time.monotonic_ns()
