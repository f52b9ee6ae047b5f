# SPDX-License-Identifier: Apache-2.0
"""The columns of everything that is looked for, outside the model."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.diagnosis.search.candidates import Candidate, ShapedColumns
from machine_tool_calibration.diagnosis.search.evidence import Block, gram_of
from machine_tool_calibration.diagnosis.search.findings import basis_of
from machine_tool_calibration.estimation import priors
from machine_tool_calibration.estimation.marginal import Gram
from machine_tool_calibration.estimation.reduction import Projected
from machine_tool_calibration.residuals.pool import Pool

# Numbers of first coefficients of an effect that are tried alone.
_LEADING = (1, 2, 4)
# Share of a column's squares that its variation within the runs is at least explained for, and squares of a column of
# zeros.
_CONSTANT, _NONE = 1e-6, 1e-100
# Standard uncertainties by which a coefficient is surely beyond a limit.
_SURELY = 3.0


@dataclass(frozen=True)
class Columns:
    """Everything that is looked for, outside the model."""

    pool: Pool  # the readings
    candidates: list[Candidate]  # effects, then what has no cause
    effects: int  # how many effects there are
    # what the model leaves of all columns of all candidates, and of those of what does not reproduce
    projected: Projected
    gram: Gram  # inner products
    blocks: list[Block]  # of what the model does not absorb

    @property
    def place(self) -> dict[str, int]:
        """Number of each candidate, by name."""
        return {candidate.name: k for k, candidate in enumerate(self.candidates)}

    @property
    def seen(self) -> list[int]:
        """Numbers of the candidates that the model does not absorb."""
        return sorted({block.candidate for block in self.blocks})


def outside_the_model(pool: Pool, candidates: Sequence[Candidate], structures: Sequence[Candidate]) -> Columns:
    """Those of effects that are not in the model, and of functions of the covariates, as the model leaves them."""
    # As many functions as there are degrees of freedom leave nothing of anything, and are no pattern.
    dof = pool.fit.without_random.solution.degrees_of_freedom
    every = [*candidates, *(s for s in structures if len(s.shapes[0].columns) < dof)]
    columns = np.concatenate([np.zeros((0, len(pool))), *(s.every for c in every for s in c.shapes)])
    projected = pool.screen(np.concatenate([columns, pool.spread[0]]))
    gram, k = gram_of(pool, projected), len(columns)
    # What does not vary within the runs has rounding there.
    before = np.maximum(pool.within_runs(columns), np.maximum(_CONSTANT * projected.squares[:k], _NONE))
    blocks, plain, first = list[Block](), list[tuple[slice, Array]](), 0
    for c, candidate in enumerate(every):
        if c == len(candidates):
            own_places = (block.own for block in blocks if not block.shaped.shape and _may_be(block, gram))
            plain = [(place, basis_of(gram.inner[place, place])) for place in own_places]
        few = _few(candidate, candidates)
        for shaped in candidate.shapes:
            past = first + len(shaped.every)
            if c >= len(candidates) and _is_an_effect(plain, gram.inner, first, shaped):
                shaped, first = replace(shaped, columns=shaped.columns[1:]), first + 1
            # The first terms alone may be in the model already, as backlash is the first of lost motion: they have
            # their share of the probability, and nothing shows them.
            leading = [shaped.leading(count) for count in few if count < len(shaped.columns)]
            # A law may hold exactly, too.
            leading += [replace(shaped, law=None)] if shaped.law is not None else []
            for own in (*leading, shaped):
                place = slice(first, first + len(own.every))
                squares = before[place]
                if (
                    np.linalg.eigvalsh(gram.inner[place, place] / np.sqrt(np.outer(squares, squares)))[-1]
                    > priors.ABSORBED
                ):
                    share = -float(np.log(candidate.among(shaped) * (len(leading) + 1)))
                    blocks.append(Block.of(c, place, own, squares, share))
            first = past
    blocks = _without_repeated(blocks, gram, len(candidates))
    return Columns(pool, every, len(candidates), projected, gram, blocks)


def special_cases(columns: Columns) -> dict[int, frozenset[int]]:
    """Numbers of the effects that each contains, of those that contain any."""
    place = columns.place
    return {
        k: frozenset(place[n] for n in c.contains if n in place) for k, c in enumerate(columns.candidates) if c.contains
    }


def _few(candidate: Candidate, others: Sequence[Candidate]) -> list[int]:
    """Numbers of first columns that are tried alone: of a series, the further coefficients are often nothing.

    Not so few that they are one of the effects that it contains.
    """
    if candidate.effect is None or candidate.effect.setup_level:
        return []
    least, first = 1, candidate.shapes[0].columns
    for own in (other.shapes[0].columns for other in others if other.name in candidate.contains):
        if np.allclose(first[: len(own)], own, atol=1e-12):
            least = max(least, len(own) + 1)
    return [count for count in _LEADING if count >= least]


def _is_an_effect(plain: Sequence[tuple[slice, Array]], inner: Array, first: int, shaped: ShapedColumns) -> bool:
    """Whether the first function of a structure, a straight line, is what an effect does: then it is that effect.

    Beside a structure that holds it the effect would only have what is left, and the structure is in no model. Of the
    effects without nonlinear coefficients `plain` has places and bases among all columns, (K, K) `inner`; the
    structure's first column is the one at `first`.
    """
    if shaped.shape or len(shaped.columns) < 2:
        return False
    least = (1.0 - priors.ABSORBED) * inner[first, first]
    return least > 0.0 and any(np.sum((basis.T @ inner[place, first]) ** 2) > least for place, basis in plain)


def _may_be(block: Block, gram: Gram) -> bool:
    """Whether an effect of a size that occurs would do what the readings show along its columns."""
    k, basis = len(block.shaped.columns), basis_of(gram.inner[block.own, block.own])
    along = basis.T @ gram.data[block.own]
    scatter = np.sqrt(max(float(gram.squares - along @ along) / max(gram.dof - k, 1), 1.0))
    size, u = basis @ along, scatter * np.sqrt(np.sum(basis**2, axis=1))
    return bool(((size + _SURELY * u > block.low[:k]) & (size - _SURELY * u < block.high[:k])).all())


def _without_repeated(blocks: list[Block], gram: Gram, effects: int) -> list[Block]:
    """Without structures that lie in the span of an effect, one of the first so many candidates: they are it."""
    inner, mine = gram.inner, [block for block in blocks if block.candidate < effects and _may_be(block, gram)]
    free = [block for block in blocks if not block.shaped.coefficients]
    if not mine or not free:
        return blocks
    # Columns of all structures in their own orthonormal directions, side by side.
    bases = [basis_of(inner[block.place, block.place]) for block in free]
    rank = np.array([basis.shape[1] for basis in bases])
    ends = np.append(0, np.cumsum(rank))
    joined = np.concatenate([inner[:, b.place] @ basis for b, basis in zip(free, bases, strict=True)], axis=1)
    repeated = np.zeros(len(free), dtype=bool)
    for block in mine:
        basis = basis_of(inner[block.place, block.place])
        squares = np.sum((basis.T @ joined[block.place]) ** 2, axis=0)
        explained = np.diff(np.append(0.0, np.cumsum(squares))[ends])
        repeated |= (basis.shape[1] >= rank) & (explained >= priors.THE_SAME**2 * rank)
    others = [block for block in blocks if block.shaped.coefficients]
    return others + [block for block, known in zip(free, repeated, strict=True) if not known]
