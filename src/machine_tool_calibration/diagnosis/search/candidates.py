# SPDX-License-Identifier: Apache-2.0
"""Columns of everything that may be missing: effects of the catalogue, and structures without a cause."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.diagnosis.search.laws import law_tolerance
from machine_tool_calibration.effects.effect import Coefficient, Effect, Shape
from machine_tool_calibration.effects.effect_terms import explained
from machine_tool_calibration.model.fit import JointFit
from machine_tool_calibration.residuals.pool import Pool
from machine_tool_calibration.words import Said

# Change of a reading, in standard uncertainties, below which an effect does not act.
_TRACE = 0.01
# Sets of nonlinear coefficients of one effect, in one session and in several, beyond which so many are searched.
_MOST_SHAPES, _MOST_OF_SEVERAL, _SEARCHED = 300, 48, 48
# Standard uncertainties between a fitted nonlinear coefficient and the grid's from which the grid is too coarse.
_BETWEEN = 2.0


@dataclass(frozen=True)
class ShapedColumns:
    """A candidate at one set of nonlinear coefficients."""

    shape: tuple[float, ...]  # these coefficients
    columns: Array  # (k, n) change of each reading of all sessions per unit of each linear coefficient
    coefficients: tuple[Coefficient, ...] = ()  # the linear ones; empty for a structure of any size
    law: Array | None = None  # (j, n) by what it may differ from its law, m per standard deviation
    law_unit: float = 1.0  # one over the scale of its coefficients for which that is so
    equally: int = 0  # sets of nonlinear coefficients that are as probable, where not all of them are tried

    @property
    def every(self) -> Array:
        """(k + j, n) its columns, and below them those of its law."""
        return self.columns if self.law is None else np.concatenate([self.columns, self.law])

    def leading(self, count: int) -> ShapedColumns:
        """Its first columns alone."""
        return replace(self, columns=self.columns[:count], coefficients=self.coefficients[:count], law=None)


@dataclass(frozen=True)
class Candidate:
    """Something that may be missing."""

    name: str  # an effect's id, or the name of a structure
    shapes: tuple[ShapedColumns, ...]  # one for each set of nonlinear coefficients that is tried
    effect: Effect | None = None  # the effect; None for a structure without a cause
    # number of sets of nonlinear coefficients over which the prior is spread at least: more than are tried where the
    # others were ruled out beforehand
    equally: int = 0
    # of a structure, on what the residuals depend and how; a wave or a step has its place put in
    dependence: tuple[str, Said] | None = None

    @classmethod
    def of_structure(cls, covariate: str, how: Said, shapes: tuple[ShapedColumns, ...], equally: int = 0) -> Candidate:
        """One without a cause."""
        return cls(f"{covariate}: {how}", shapes, equally=equally, dependence=(covariate, how))

    @property
    def nonlinear(self) -> tuple[Shape, ...]:
        """Its nonlinear coefficients."""
        return () if self.effect is None else self.effect.shapes

    @property
    def contains(self) -> tuple[str, ...]:
        """Ids of effects that are a special case of it."""
        return () if self.effect is None else self.effect.contains

    @property
    def kind(self) -> str:
        """What it has in common with those that differ from it by their axis alone, as backlash_x from backlash_y."""
        first, _, last = self.name.rpartition("_")
        return first if last in tuple("xyzabc") else self.name

    @property
    def is_seldom(self) -> bool:
        """Whether it is an effect beside which others are usual."""
        return self.effect is not None and self.effect.seldom

    @property
    def decays(self) -> bool:
        """Whether it has a time constant."""
        return any(shape.unit == "s" for shape in self.nonlinear)

    @property
    def takes_time(self) -> bool:
        """Whether it is an effect that changes with the time."""
        return self.effect is not None and "time" in self.effect.needs

    @property
    def drifts(self) -> bool:
        """Whether it goes on with the time, without a time constant."""
        return self.takes_time and not self.decays

    @property
    def reverses(self) -> bool:
        """Whether it is an effect of the direction of approach."""
        effect = self.effect
        return effect is not None and any(name.startswith("dir_") for name in (*effect.needs, *effect.covariates))

    def among(self, shaped: ShapedColumns) -> int:
        """Sets of nonlinear coefficients over which the prior is spread, where each is as probable as this one."""
        return shaped.equally or max(self.equally, len(self.shapes))

    @property
    def count(self) -> int:
        """The same for the most probable set."""
        return min(map(self.among, self.shapes))


def effect_candidates(pool: Pool, effects: Sequence[Effect]) -> tuple[list[Candidate], dict[str, str]]:
    """Candidates of those effects that these readings could show, and by its id why each of the others could not."""
    found, excluded, spare = [], {}, pool.fit.solution.degrees_of_freedom
    for effect in effects:
        reasons = [effect.why_not(o) for o in pool.observations]
        acting = [o for o, reason in zip(pool.observations, reasons, strict=True) if reason is None]
        grid = sorted({shape for observations in acting for shape in effect.shape_grid(observations)})
        shaped = [shaped_at(pool, effect, shape) for shape in _strongest(pool, effect, grid, len(acting))]
        showing = [s for s in shaped if _acts(pool, s)]
        checked = tuple(s for s in showing if len(s.columns) < spare)
        if checked:
            found.append(Candidate(effect.id, checked, effect, equally=len(grid) if len(grid) > len(shaped) else 0))
        elif showing:
            excluded[effect.id] = "too few readings: it would leave none that check it"
        else:
            excluded[effect.id] = "no reading depends on it" if acting else str(reasons[0])
    return found, excluded


def in_the_model(pool: Pool, effects: Sequence[Effect]) -> list[Candidate]:
    """Effects that the model has already, of which nothing is tried."""
    acting = (e for e in effects if any(e.why_not(o) is None for o in pool.observations))
    return [Candidate(effect.id, (), effect) for effect in acting]


def between_the_grid(
    pool: Pool, candidates: Sequence[Candidate], used: Mapping[str, tuple[float, ...]], fit: JointFit
) -> list[Candidate] | None:
    """The candidates with what a fit says of their nonlinear coefficients, where the readings tell these that well.

    A strong warm-up at a time constant that is a fifth wrong leaves what looks like a drift. None where the grid's
    values are as good; of these the `used` ones, none of them discrete, explain the readings best, for effects that are
    in the fit.
    """
    place = {parameter.name: k for k, parameter in enumerate(fit.assembly.parameters)}
    out, finer = [], False
    for candidate in candidates:
        # A coefficient that the readings do not bound is none of the fit's unknowns.
        at = [place.get(f"{candidate.name}.{shape.name}", -1) for shape in candidate.nonlinear]
        if candidate.effect is not None and candidate.name in used and min(at) >= 0:
            reference = np.array([fit.assembly.parameters[k].reference for k in at])
            found = reference + fit.solution.theta[at]
            distance = np.abs(found - used[candidate.name])
            if (distance > _BETWEEN * fit.birge_ratio * np.sqrt(np.diag(fit.solution.covariance)[at])).any():
                more = shaped_at(pool, candidate.effect, tuple(found.tolist()))
                candidate = replace(candidate, shapes=(*candidate.shapes, more), equally=candidate.count)
                finer = True
        out.append(candidate)
    return out if finer else None


def to_some_percent(pool: Pool, candidate: Candidate, signal: Array, scale: float) -> Candidate:
    """An effect whose law holds to its tolerance only; its signal (n,), m, is that at a scale of its coefficients."""
    assert candidate.effect is not None
    law = law_tolerance(pool, signal, candidate.effect.tolerance)
    return replace(candidate, shapes=tuple(replace(s, law=law, law_unit=1.0 / scale) for s in candidate.shapes))


def _strongest(pool: Pool, effect: Effect, grid: Sequence[tuple[float, ...]], sessions: int) -> list[tuple[float, ...]]:
    """Nonlinear coefficients that are searched: of very many those that explain most of the residuals by themselves."""
    if len(grid) <= (_MOST_SHAPES if sessions == 1 else _MOST_OF_SEVERAL):
        return list(grid)
    gains = explained(pool.fit, effect, grid)[0]
    return [grid[k] for k in sorted(np.argsort(gains)[-_SEARCHED:])]


def shaped_at(pool: Pool, effect: Effect, shape: tuple[float, ...]) -> ShapedColumns:
    """An effect at given nonlinear coefficients, in every session in which it can act.

    The machine's coefficients are the same in all sessions, those of a setup each session's own.
    """
    acting = [k for k, o in enumerate(pool.observations) if effect.why_not(o) is None]
    columns = [effect.columns(pool.observations[k], shape) for k in acting]
    named = [effect.coefficients_for(pool.observations[k], shape) for k in acting]
    if not acting:
        return ShapedColumns(shape, np.zeros((0, len(pool))))
    equally = max(effect.equally(pool.observations[k], shape) for k in acting)
    if effect.setup_level or len({len(c) for c in columns}) > 1:
        of_each = [pool.only(own, pool.pieces[k]) for k, own in zip(acting, columns, strict=True)]
        return ShapedColumns(shape, np.concatenate(of_each), tuple(c for own in named for c in own), equally=equally)
    together = np.zeros((len(columns[0]), len(pool)))
    for k, own in zip(acting, columns, strict=True):
        together[:, pool.pieces[k]] = own
    return ShapedColumns(shape, together, tuple(named[0]), equally=equally)


def _acts(pool: Pool, shaped: ShapedColumns) -> bool:
    """Whether the largest plausible size would change any reading by more than a trace of its uncertainty."""
    if not np.isfinite(shaped.columns).all():
        return False
    limits = np.array([max(abs(c.low), abs(c.high)) for c in shaped.coefficients])
    largest = (np.abs(shaped.columns) / pool.sigma).max(axis=1, initial=0.0) * limits
    return bool(largest.max(initial=0.0) > _TRACE)
