"""A further measurement that could be made."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from machine_tool_calibration.session.session import Session

__all__ = ["Option"]

# What is done beside measuring, s: only to choose between measurements that are equally good.
_EFFORT = {"swing": 3600.0, "warmer": 3 * 3600.0, "station": 900.0, "turned": 120.0}


@dataclass(frozen=True)
class Option:
    """A further measurement that could be made.

    Attributes:
        kind: short name: again, backwards, both_ways, order, swing, warmer, turned, station, index, diagonal, offset.
        words: what to do, for people.
        session: the session followed by it; its displacements are only rough.
        first_row: number of its first reading.
        seconds: time that it takes at the session's own pace; None without a time column.
        aside: what comes on top of that time, in words; empty if nothing does.
        turned: for effects that sit in a part which is turned for it, the angle about Z, rad.
    """

    kind: str
    words: str
    session: Session
    first_row: int
    seconds: float | None
    aside: str = ""
    turned: Mapping[str, float] = field(default_factory=dict)

    @property
    def effort(self) -> float:
        """Time with what comes on top, s, roughly."""
        return (self.seconds or 0.0) + _EFFORT.get(self.kind, 0.0)

    @classmethod
    def of(
        cls,
        session: Session,
        kind: str,
        words: str,
        extended: tuple[Session, float | None],
        aside: str = "",
        turned: Mapping[str, float] | None = None,
    ) -> Option:
        """An option from the session as it was and as it would be."""
        first = int(session.readings.row.max(initial=-1)) + 1
        return cls(kind, words, extended[0], first, extended[1], aside, turned or {})
