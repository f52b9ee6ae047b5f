# SPDX-License-Identifier: Apache-2.0
"""What a driver of a displacement instrument is, for the node that publishes its readings."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, Protocol, runtime_checkable

from machine_tool_calibration.errors import CalibrationError

LinkState = Literal["disconnected", "silent", "streaming"]


class InstrumentError(CalibrationError):
    """An instrument that cannot be reached or set up; the message says which, where and why."""


@dataclass(frozen=True)
class Sample:
    """One reading as the instrument sent it.

    Attributes:
        time: when it arrived, s, on the driver's clock (`time.monotonic` unless another was given).
        displacement: the reading, m; None when the instrument says that it is not valid.
        beam: False when the instrument says that the beam is broken: its count is lost, a new datum is needed.
        status: the instrument's own word, empty if it has none.
    """

    time: float
    displacement: float | None
    beam: bool = True
    status: str = ""


@dataclass(frozen=True)
class Health:
    """The state of the link, for diagnostics.

    Attributes:
        state: `streaming`, `silent` (connected, but no sample for longer than the driver allows) or `disconnected`.
        rejected: the last line that was no reading, shortened; empty if there was none.
        reconnections: number of times that the link was lost and made again.
        problem: why the link is down; empty if it is up.
    """

    state: LinkState
    rejected: str = ""
    reconnections: int = 0
    problem: str = ""


@runtime_checkable
class Driver(Protocol):
    """A displacement instrument.

    `open` and `read` are called from one thread; `health` and `close` from any.
    A link that is lost after `open` is made again by `read`, so a caller only looks at `health`.
    A driver that knows which instrument it has may say so in an attribute `hardware_id`, for diagnostics.
    """

    def open(self) -> None:
        """Connect.

        Raises:
            InstrumentError: the instrument cannot be reached. It may be tried again.
        """

    def read(self, timeout: float) -> list[Sample]:
        """Every sample that has arrived; waits for the first one at most `timeout` seconds, else returns none."""

    def health(self) -> Health:
        """The state of the link."""

    def close(self) -> None:
        """Disconnect; a `read` that waits returns at once. Closing twice is no error."""
