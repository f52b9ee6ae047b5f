"""Two effects at once: where neither leads by itself, or a third one looks like their sum."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.diagnosis.likelihood import (
    ABSORBED,
    Data,
    Likelihoods,
    Reduced,
    directions,
    spread_price,
    weighted_products,
)
from machine_tool_calibration.diagnosis.ranking import Ranked
from machine_tool_calibration.diagnosis.significance import search

__all__ = ["Pair", "best_pair"]


@dataclass(frozen=True)
class Pair:
    """Two effects, fitted together to what the first model leaves.

    Attributes:
        names: of the two, the one that does more by itself first.
        gain: by how much the Bayesian information criterion falls.
        family_p_value: chance of such a likelihood ratio if nothing is missing, paid for all pairs.
        others: the gain of every pair.
    """

    names: tuple[str, str]
    gain: float
    family_p_value: float
    others: dict[frozenset[str], float]


def best_pair(
    ranked: Sequence[Ranked],
    reduced: Reduced,
    data: Data,
    likelihoods: Likelihoods,
    rng: np.random.Generator,
    sets: int,
) -> Pair | None:
    """The two effects that together explain most, each at the nonlinear coefficients that are best for it alone.

    Args:
        ranked: all candidates.
        reduced: inner products of candidates and spread.
        data: the measured data set.
        likelihoods: of the single candidates.
        rng: source of random numbers.
        sets: simulated data sets in which nothing is missing.

    Returns:
        None if there are fewer than two candidates.
    """
    mine = sorted((r for r in ranked if r.rank and r.possible), key=lambda r: -r.bic_gain)
    gains = _gains(mine, reduced, data, likelihoods)
    if not gains:
        return None
    i, j = max(gains, key=lambda key: gains[key])
    # One candidate that holds the columns of both.
    places = [np.arange(reduced.n_candidates)[mine[k].place] for k in (i, j)]
    columns = np.concatenate([*places, np.arange(reduced.n_candidates, len(reduced.gram))])
    both = slice(0, len(places[0]) + len(places[1]))
    chance = search(
        replace(
            reduced,
            gram=reduced.gram[np.ix_(columns, columns)],
            squares=reduced.squares[columns],
            root=reduced.root[columns],
            n_candidates=both.stop,
        ),
        [[both]],
        Data(data.products[columns], data.squares),
        rng,
        sets=sets,
    )
    tries = len(gains) * len(mine[i].candidate.blocks) * len(mine[j].candidate.blocks)
    paid = float(min(np.exp(chance.log_p_value[0] + np.log(tries)), 1.0))
    names = [r.candidate.name for r in mine]
    others = {frozenset((names[a], names[b])): gain for (a, b), gain in gains.items()}
    return Pair((names[i], names[j]), gains[i, j], paid, others)


def _gains(
    mine: Sequence[Ranked], reduced: Reduced, data: Data, likelihoods: Likelihoods
) -> dict[tuple[int, int], float]:
    """By how much the information criterion falls with every two candidates."""
    bases = [directions(reduced, r.place) for r in mine]
    costs = [(r.rank + r.candidate.shapes) * float(np.log(max(r.candidate.sample, 2))) for r in mine]
    best: dict[tuple[int, int], float] = {}
    n = reduced.dimension
    for ratio in likelihoods.ratios:
        inner, right, squares = weighted_products(reduced, slice(0, reduced.n_candidates), data, ratio)
        price = spread_price(reduced, ratio)
        halves = [(b.T @ inner[r.place, r.place] @ b, b.T @ right[r.place]) for r, b in zip(mine, bases, strict=True)]
        for i, j in combinations(range(len(mine)), 2):
            across = bases[i].T @ inner[mine[i].place, mine[j].place] @ bases[j]
            explained = _explained(halves[i], halves[j], across)
            value = -n * float(np.log(max(squares - explained, 1e-12 * squares, 1e-300) / n)) - price
            best[i, j] = max(best.get((i, j), -np.inf), value)
    null = float(likelihoods.null[0])
    return {(i, j): value - null - costs[i] - costs[j] for (i, j), value in best.items()}


def _explained(one: tuple[Array, Array], other: tuple[Array, Array], across: Array) -> float:
    """Sum of squares that two groups of columns explain together."""
    inner = np.block([[one[0], across], [across.T, other[0]]])
    scale = np.sqrt(np.diag(inner))
    values, vectors = np.linalg.eigh(inner / np.outer(scale, scale))
    along = vectors.T @ (np.concatenate([one[1], other[1]]) / scale)
    keep = values > ABSORBED
    return float(np.sum(along[keep] ** 2 / values[keep]))
