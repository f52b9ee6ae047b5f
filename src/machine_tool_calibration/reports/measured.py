# SPDX-License-Identifier: Apache-2.0
"""What a verb is asked about: measurements, the model to fit to them, and the document of what comes of it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from machine_tool_calibration.words import say

if TYPE_CHECKING:
    from machine_tool_calibration.diagnosis.history import Entry
    from machine_tool_calibration.methods.fitted import FitRequest
    from machine_tool_calibration.methods.identify import JointResult
    from machine_tool_calibration.model.result import Result
    from machine_tool_calibration.session.session import Session

__all__ = ["Measured"]


@dataclass(frozen=True)
class Measured:
    """Measurements as they were recorded, and what is to be fitted to them.

    Attributes:
        recorded: the measurements, with all their readings.
        chosen: those to fit, without what the history's model sets aside, and the model: one that was asked for, or
            one of the history.
        history: the models from the first to the one in use, where it is the history's.
    """

    recorded: tuple[Session, ...]
    chosen: FitRequest
    history: tuple[Entry, ...] = ()

    def document(self, result: Result | JointResult) -> dict[str, Any]:
        """The result as a JSON document, with the readings that the history's model set aside among the rejected."""
        document = result.document()
        last = self.history[-1].number if self.history else 0
        why = say("result.aside_by", n=last) if last else say("result.aside_by_history")
        for label, session, kept in zip(self.chosen.labels or ("",), self.recorded, self.chosen.sessions, strict=True):
            gone = sorted(set(session.readings.row.tolist()) - set(kept.readings.row.tolist()))
            named = {"session": label} if label else {}
            document["rejected"] += [{**named, "row": row, "reason": why} for row in gone]
            document["observations"] += len(gone)
        return document
