"""Columns of everything that is looked for in the residuals."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.effects.effect import Effect
from machine_tool_calibration.model.observations import Observations

__all__ = ["Block", "Candidate", "effect_candidates", "stack"]

# Change of a reading, in standard uncertainties, below which an effect does not act.
_TRACE = 0.01


@dataclass(frozen=True)
class Block:
    """Columns of a candidate at one set of nonlinear coefficients."""

    shape: tuple[float, ...]
    columns: Array


@dataclass(frozen=True)
class Candidate:
    """Something that may be missing.

    Attributes:
        name: an effect's id, or the name of a structure.
        blocks: one for each set of nonlinear coefficients that is tried.
        shapes: how many nonlinear coefficients there are.
        sample: number of readings that tell of each of its coefficients.
        effect: the effect; None for a structure without a cause.
    """

    name: str
    blocks: tuple[Block, ...]
    shapes: int
    sample: int
    effect: Effect | None = None


def effect_candidates(observations: Observations, effects: Sequence[Effect]) -> tuple[list[Candidate], dict[str, str]]:
    """Candidates of those effects that these readings could show, and why the others could not.

    Args:
        observations: the readings.
        effects: the catalogue.

    Returns:
        Candidates, and for each other effect's id the reason.
    """
    found, excluded = [], {}
    n_setups = len(np.unique(observations.readings.setup))
    for effect in effects:
        why = effect.why_not(observations)
        if why is None:
            blocks = tuple(
                Block(shape, effect.columns(observations, shape)) for shape in effect.shape_grid(observations)
            )
            blocks = tuple(block for block in blocks if _acts(effect, block, observations))
            if blocks:
                # Each coefficient of a setup is told by the readings of that setup alone.
                sample = len(observations) // n_setups if effect.setup_level else len(observations)
                found.append(Candidate(effect.id, blocks, len(effect.shapes), sample, effect))
                continue
            why = "no reading depends on it"
        excluded[effect.id] = why
    return found, excluded


def _acts(effect: Effect, block: Block, observations: Observations) -> bool:
    """Whether the largest plausible size would change any reading by more than a trace of its uncertainty."""
    if not np.isfinite(block.columns).all():
        return False
    limits = [max(abs(c.low), abs(c.high)) for c in effect.coefficients_for(observations, block.shape)]
    largest = np.abs(block.columns).max(axis=1) * np.array(limits)
    return bool(largest.max(initial=0.0) > _TRACE * observations.session.sigma)


def stack(candidates: Sequence[Candidate], n: int) -> tuple[Array, list[list[slice]]]:
    """All columns below each other, and where each candidate's blocks are."""
    places: list[list[slice]] = []
    columns, first = [np.zeros((0, n))], 0
    for candidate in candidates:
        mine = []
        for block in candidate.blocks:
            mine.append(slice(first, first + len(block.columns)))
            first += len(block.columns)
            columns.append(block.columns)
        places.append(mine)
    return np.concatenate(columns), places
