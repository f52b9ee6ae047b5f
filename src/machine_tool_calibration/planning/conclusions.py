"""What follows from a diagnosis: what the candidates would change, and what to measure to be sure."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from machine_tool_calibration.diagnosis.consequence import Consequence, consequences
from machine_tool_calibration.diagnosis.diagnose import Diagnosis
from machine_tool_calibration.effects.effect import Effect
from machine_tool_calibration.planning.advice import Advice
from machine_tool_calibration.planning.what_to_measure import what_to_measure

__all__ = ["SEARCH", "Conclusions", "conclude"]

SEARCH = 0.7
"""Share of the whole time that the diagnosis itself takes."""
_CHANGES = 0.1


@dataclass(frozen=True)
class Conclusions:
    """What follows from a diagnosis.

    Attributes:
        changes: what the candidates would change in the readings and in the map, by effect.
        advice: what to measure next.
    """

    changes: Mapping[str, Consequence]
    advice: Advice


def conclude(
    found: Diagnosis, *, model: str | None, own: Sequence[Effect], progress: Callable[[str, float], None]
) -> Conclusions:
    """Draw the conclusions.

    Args:
        found: the diagnosis.
        model: with which it was made.
        own: the user's own effects.
        progress: told what is being done and the share of the whole, which begins at `SEARCH`.
    """
    progress("what the candidates would change", SEARCH)
    changes = consequences(found)
    done = SEARCH + _CHANGES
    advice = what_to_measure(
        found, model=model, own=own, progress=lambda what, share: progress(what, done + (1.0 - done) * share)
    )
    return Conclusions(changes, advice)
