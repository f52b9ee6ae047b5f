# SPDX-License-Identifier: Apache-2.0
"""Whether a model fits its readings, by the levels of the p-value, and whether its uncertainty stands."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Literal

Fits = Literal["bad", "nearly", "well", "too well"]

# A right model with a right uncertainty is called bad once in a thousand measurements, and nearly fitting once in 20.
_BAD, _NEARLY = 1e-3, 0.05


def fits(p_value: float | None) -> Fits:
    """How a model fits readings of that p-value; well where there is none, as nothing speaks against it."""
    if p_value is None or p_value != p_value:
        return "well"
    if p_value > 1.0 - _BAD:
        return "too well"
    return "bad" if p_value < _BAD else "nearly" if p_value < _NEARLY else "well"


def only_if_right(p_value: float | None, content: Mapping[str, Any] | None) -> bool:
    """Whether the readings speak against the model on which the uncertainty of a map with this content rests.

    The reversal of runs that are read directly (ISO 230-2) does not, as it is part of their result.
    """
    return fits(p_value) == "bad" and "one_direction" not in ((content or {}).get("scatter") or {})
