"""Angular errors that a step diagonal takes for small random functions, where another session knows them."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace

from machine_tool_calibration.methods.step_diagonal.model import StepDiagonalModel

__all__ = ["without_spread"]


def without_spread(model: StepDiagonalModel, known: Collection[str]) -> StepDiagonalModel:
    """The model without the random functions of those angular errors that others have as tables.

    Those that turn the mirror but move no functional point, such as ECX of the chain w-X-Y-b-Z-t, stay: a tracker does
    not know them.

    Args:
        model: of a step diagonal.
        known: names of the error motions that have tables.
    """
    if model.spread is None:
        return model
    told = [angle for angle in model.spread.angles if angle.table.name in known]
    kept = tuple(angle for angle in model.spread.angles if angle.table.name not in known)
    gone = {f"angle.{angle.table.name}" for angle in told}
    unknowns = {p.name for term in model.terms if term.name in gone for p in term.parameters}
    return replace(
        model,
        terms=tuple(term for term in model.terms if term.name not in gone),
        priors=tuple(prior for prior in model.priors if not unknowns & set(prior.weights)),
        constraints=tuple(c for c in model.constraints if not unknowns & set(c.weights)),
        # What the session alone says of the others is no longer all that is known of them.
        spread=replace(model.spread, angles=kept, observations=None) if kept else None,
    )
