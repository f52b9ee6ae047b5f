# SPDX-License-Identifier: Apache-2.0
"""Arguments that cannot be, refused in one line before anything is calculated from them."""

import operator
from typing import Any

from machine_tool_calibration.errors import CalibrationError

MOST_DRAWS = 100_000
"""Random draws that can be asked for: quantiles of more are no better known than what is drawn from."""
# Smallest and largest.
_LIMITS = {"seed": (0, 2**63 - 1), "draws": (0, MOST_DRAWS)}


def require_whole(**numbers: Any) -> None:
    """Refuse (CalibrationError) a `seed`, or a number of `draws`, that is no whole number within its limits."""
    for name, value in numbers.items():
        low, high = _LIMITS[name]
        try:
            fits = low <= operator.index(value) <= high
        except TypeError:
            fits = False
        if not fits:
            raise _refused(f"{name} must be a whole number from {low} to {high}", value)


def require_kind(value: Any, kind: type, words: str) -> None:
    """Refuse an argument that is of another kind.

    Args:
        value: what was given.
        kind: what it has to be.
        words: that, in words, with the argument's name before it.

    Raises:
        CalibrationError: it is not.
    """
    if not isinstance(value, kind):
        raise _refused(words, value)


def _refused(words: str, value: Any) -> CalibrationError:
    from machine_tool_calibration.session.defects import shown  # loads pydantic, which few verbs need

    return CalibrationError(f"{words}, not {shown(value)}")
