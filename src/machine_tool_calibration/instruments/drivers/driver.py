# SPDX-License-Identifier: Apache-2.0
"""What a driver of a displacement instrument is, for the node that publishes its readings."""

from dataclasses import dataclass
from typing import Literal, Protocol, runtime_checkable

from machine_tool_calibration.errors import CalibrationError

LinkState = Literal["disconnected", "silent", "streaming"]


class InstrumentError(CalibrationError):
    """An instrument that cannot be reached or set up; the message says which, where and why."""


@dataclass(frozen=True)
class Sample:
    """One reading as the instrument sent it."""

    time: float  # when it arrived, s, on the driver's clock (`time.monotonic` unless another was given)
    displacement: float | None  # the reading, m; None when the instrument says that it is not valid
    # False when the instrument says that the beam is broken: its count is lost, a new datum is needed
    beam: bool = True
    status: str = ""  # the instrument's own word, empty if it has none


@dataclass(frozen=True)
class Health:
    """The state of the link, for diagnostics."""

    state: LinkState  # `streaming`, `silent` (connected, but without a sample for too long) or `disconnected`
    rejected: str = ""  # the last line that was no reading, shortened; empty if there was none
    reconnections: int = 0  # number of times that the link was lost and made again
    problem: str = ""  # why the link is down; empty if it is up


@runtime_checkable
class Driver(Protocol):
    """A displacement instrument.

    `open` and `read` are called from one thread; `health` and `close` from any.
    A link that is lost after `open` is made again by `read`, so a caller only looks at `health`.
    A driver that knows which instrument it has may say so in an attribute `hardware_id`, for diagnostics.
    """

    def open(self) -> None:
        """Connect; an InstrumentError if the instrument cannot be reached, which may be tried again."""

    def read(self, timeout: float) -> list[Sample]:
        """Every sample that has arrived; waits for the first one at most `timeout` seconds, else returns none."""

    def health(self) -> Health:
        """The state of the link."""

    def close(self) -> None:
        """Disconnect; a `read` that waits returns at once. Closing twice is no error."""
