# SPDX-License-Identifier: Apache-2.0
"""One machine over months, as a text, a table, a picture and a document."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

from machine_tool_calibration.interface.show import Answer
from machine_tool_calibration.reports.tables import show_table
from machine_tool_calibration.reports.trends import check_remarks, check_table, check_verdict
from machine_tool_calibration.trends.check import LEVEL
from machine_tool_calibration.trends.check import Check as Checked

if TYPE_CHECKING:
    from rich.console import Console

__all__ = ["Check"]


@dataclass(frozen=True, eq=False, repr=False)
class Check(Answer, Checked):
    """Whether an earlier map still predicts a measurement."""

    @property
    def headline(self) -> str:
        """The verdict, in one line."""
        return check_verdict(self)

    def show(self, screen: Console, /) -> None:
        """Print what changed, the verdict, and what could not be told."""
        show_table(screen, check_table(self))
        screen.print()
        for words in (check_verdict(self), *check_remarks(self)):
            screen.print(words)

    @cached_property
    def _document(self) -> dict[str, Any]:
        return {
            "format": "mtcal-check/1",
            "map": self.earlier,
            "measurement": self.now,
            "since": self.since,
            "until": self.until,
            "holds": not self.moved,
            "verdict": check_verdict(self),
            "level": LEVEL,
            "rule": "holm",
            "correlated": self.correlated,
            "sessions_of_spread": self.sessions,
            "moved": [one.name for one in self.moved],
            "too_uncertain": [one.name for one in self.blind],
            "not_compared": self.untold,
            "changes": [asdict(one) | {"moved": one.moved, "too_uncertain": one.blind} for one in self.changes],
        }
