# SPDX-License-Identifier: Apache-2.0
"""Whether a model fits its readings, by the levels of the p-value, and whether its uncertainty stands."""

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


# Scatter of the readings of one direction over that about a model, within which both are the same scatter.
_SAME = 1.1


def one_direction(content: Mapping[str, Any] | None) -> float | None:
    """The scatter, m, of readings of one place and direction by which a fit with a map of this content is judged.

    That of runs that are read directly (ISO 230-2), where the model leaves no less: the reversal between both
    directions is part of the result.
    """
    scatter = (content or {}).get("scatter") or {}
    own: float | None = scatter.get("one_direction")
    return own if own is not None and own < _SAME * scatter["found"] else None


def lacks_reversal(content: Mapping[str, Any]) -> bool:
    """Whether the directions of such runs differ by what the model has not."""
    own = one_direction(content)
    return own is not None and content["scatter"]["found"] > _SAME * own


def scatter_p_value(p_value: float | None, content: Mapping[str, Any] | None) -> float | None:
    """The p-value of the scatter by which a fit with a map of this content is judged."""
    if content is None or one_direction(content) is None:
        return p_value
    return float(content["scatter"]["one_direction_p_value"])


def only_if_right(p_value: float | None, content: Mapping[str, Any] | None) -> bool:
    """Whether the readings speak against the model on which the uncertainty of a map with this content rests."""
    return fits(p_value) == "bad" and one_direction(content) is None
