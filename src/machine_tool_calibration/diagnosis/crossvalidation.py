"""Whether an effect predicts readings that were not used to fit it.

Readings are held out in folds: whole setups where the model has no points of its own, otherwise whole points with
all their readings (leaving out one of four stations would leave no redundancy to predict with). In a held-out fold
only what a user frees in service is fitted again: unknowns that no other reading sees, and the points' own.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from machine_tool_calibration.arrays import Array, IntArray
from machine_tool_calibration.estimation.elimination import reduced_gram
from machine_tool_calibration.estimation.solve import solve_normal
from machine_tool_calibration.model.fit import Fit
from machine_tool_calibration.model.model import assemble
from machine_tool_calibration.model.terms import Parameter, Term

__all__ = ["CrossValidation", "cross_validate"]

_FOLDS = 8


@dataclass(frozen=True)
class CrossValidation:
    """Loss on held-out readings, weighted sum of squares.

    Attributes:
        null: (folds,) without any candidate.
        candidate: (candidates, folds) with each.
        nested: (folds,) with the candidate, or none, that the other folds chose.
        readings: (folds,) how many were held out.
    """

    null: Array
    candidate: Array
    nested: Array
    readings: IntArray

    def gain(self, index: int) -> float:
        """Share of the held-out loss that a candidate takes away."""
        return float(1.0 - self.candidate[index].sum() / self.null.sum()) if self.null.sum() > 0 else 0.0

    def agrees(self, index: int) -> bool:
        """Whether the held-out readings do not speak against a candidate: no loss beyond two standard errors."""
        share = (self.null - self.candidate[index]) / max(float(self.null.sum()), 1e-300)
        error = float(np.std(share, ddof=1) * np.sqrt(len(share)))
        return float(share.sum()) > -2.0 * error

    @property
    def nested_gain(self) -> float:
        """The same when the choice is made again in every fold."""
        return float(1.0 - self.nested.sum() / self.null.sum()) if self.null.sum() > 0 else 0.0

    @property
    def nested_gain_uncertainty(self) -> float:
        """Standard error of the nested gain, from its scatter between folds."""
        share = (self.null - self.nested) / self.null.sum()
        return float(np.std(share, ddof=1) * np.sqrt(len(share))) if len(share) > 1 else float("inf")


def cross_validate(fit: Fit, blocks: Sequence[Array], penalty: float) -> CrossValidation | None:
    """Hold out every fold once.

    Args:
        fit: of a single session, without the candidates.
        blocks: columns of each candidate, (k, n).
        penalty: what a further unknown must gain in the weighted sum of squares to be chosen.

    Returns:
        The losses; None where there are fewer than three folds.
    """
    grams, counts = _fold_grams(fit, blocks)
    if len(grams) < 3:
        return None
    total = np.sum(grams, axis=0)
    m = len(fit.solution.theta)
    constraints = np.pad(fit.joint.assembly.problem.constraints, ((0, 0), (0, total.shape[0] - 1 - m)))
    sizes = [len(block) for block in blocks]
    starts = m + np.concatenate([[0], np.cumsum(sizes)]).astype(int)
    choices = [np.arange(m)] + [np.r_[0:m, starts[k] : starts[k + 1]] for k in range(len(blocks))]
    losses = np.zeros((len(choices), len(grams)))
    nested = np.zeros(len(grams))
    for f, held in enumerate(grams):
        train = total - held
        scores = []
        for k, pick in enumerate(choices):
            loss, training = _loss(train, held, pick, constraints)
            losses[k, f] = loss
            scores.append(training + penalty * (len(pick) - m))
        nested[f] = losses[int(np.argmin(scores)), f]
    return CrossValidation(losses[0], losses[1:], nested, np.array(counts, dtype=np.int64))


def _loss(train: Array, held: Array, pick: IntArray, constraints: Array) -> tuple[float, float]:
    """Loss of the held-out readings at the others' estimate, and the others' own sum of squares."""
    inner = train[np.ix_(pick, pick)]
    rows = constraints[:, pick]
    normal = solve_normal(
        inner, train[pick, -1], rows, np.zeros(len(rows)), np.maximum(np.diag(train + held)[pick], 1e-300)
    )
    step = normal.step
    left = held[pick, -1] - held[np.ix_(pick, pick)] @ step
    loss = float(held[-1, -1] - held[pick, -1] @ step - left @ step)
    training = float(train[-1, -1] - normal.gain)
    free = normal.undetermined
    if free.shape[1]:
        own = free.T @ held[np.ix_(pick, pick)] @ free
        right = free.T @ left
        loss -= float(right @ np.linalg.pinv(own, rcond=1e-9, hermitian=True) @ right)
    return max(loss, 0.0), training


def _fold_grams(fit: Fit, blocks: Sequence[Array]) -> tuple[list[Array], list[int]]:
    columns = np.concatenate([np.zeros((0, len(fit.model.observations))), *blocks])
    names = tuple(Parameter(f"candidate column {j}", "1") for j in range(len(columns)))
    assembly = assemble([fit.model.with_terms([Term("candidates", names, columns)])])
    part = assembly.problem.parts[0]
    size = assembly.problem.size
    theta = np.concatenate([fit.solution.theta, np.zeros(len(columns))])
    local = fit.solution.local[fit.index]
    grams, counts = [], []
    folds: list[list[tuple[int, slice]]] = []
    if part.dimension:
        for f in range(_FOLDS):
            ends = [(len(group.points) * np.array([f, f + 1])) // _FOLDS for group in part.groups]
            folds.append([(g, slice(int(first), int(last))) for g, (first, last) in enumerate(ends)])
    else:
        folds = [[(g, slice(None))] for g in range(len(part.groups))]
    for fold in folds:
        total = np.zeros((size + 1, size + 1))
        count = 0
        for g, chunk in fold:
            layout = part.groups[g]
            if not layout.rows[:, chunk].size:
                continue
            value = reduced_gram(part.rows(g, chunk, theta, local), layout.place)
            index = np.append(part.columns(g), size)
            np.add.at(total, (index[:, None], index[None, :]), value)
            count += int((layout.rows[:, chunk] >= 0).sum())
        if count:
            grams.append(total)
            counts.append(count)
    return grams, counts
