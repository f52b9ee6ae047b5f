# SPDX-License-Identifier: Apache-2.0
"""Time stamps of other programs, to seconds."""

from __future__ import annotations

import re
from datetime import UTC, datetime

import numpy as np

__all__ = ["are_stamps", "stamp_seconds"]

_CLOCK = re.compile(r"\d?\d:\d\d(:\d\d([.,]\d+)?)?")
_GERMAN = re.compile(r"(\d?\d)\.(\d?\d)\.(\d{4})[ T](.*)")


def are_stamps(cells: np.ndarray) -> bool:
    """Whether a column holds dates or times of day; numbers of seconds otherwise."""
    return any(":" in cell for cell in cells[:1000])


def stamp_seconds(text: str, pattern: str | None) -> float:
    """A time stamp in seconds since 1970, or since midnight where it has no date; NaN where it is none.

    Read are ISO 8601 (2024-05-03 10:15:00.25, with or without an offset), 3.5.2024 10:15:00 (the day first, as dots
    say) and 10:15:00. Of 5/3/2024 nobody knows which is the day: that needs a pattern.

    Args:
        text: the cell.
        pattern: of `datetime.strptime`, such as `%m/%d/%Y %H:%M:%S`; none of the above is tried then.
    """
    try:
        if pattern is not None:
            found = datetime.strptime(text, pattern)
        elif _CLOCK.fullmatch(text):
            hours, minutes, *rest = text.replace(",", ".").split(":")
            return 3600.0 * int(hours) + 60.0 * int(minutes) + float(rest[0] if rest else 0)
        else:
            if (match := _GERMAN.fullmatch(text)) is not None:
                day, month, year, clock = match.groups()
                text = f"{year}-{int(month):02d}-{int(day):02d} {clock}"
            found = datetime.fromisoformat(text.replace(",", "."))
        return (found if found.tzinfo else found.replace(tzinfo=UTC)).timestamp()
    except (ValueError, OverflowError):
        return float("nan")
