"""Likelihoods of many candidates on many data sets, with the spread between runs refitted for each.

Everything is calculated from inner products after the model was projected off, so that the number of readings
does not matter. The variances of the spread are tried on a grid: for each of its points one small factorisation
serves all candidates and all data sets.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from machine_tool_calibration.arrays import Array, IntArray
from machine_tool_calibration.estimation.projection import Projected

__all__ = [
    "Data",
    "Likelihoods",
    "Reduced",
    "directions",
    "observed",
    "reduce",
    "scan",
    "simulate",
    "spread_price",
    "spread_ratios",
    "weighted_products",
]

# Variances of the spread's coefficients that are tried, in units of the readings' variance.
_RATIOS = (0.0, 0.01, 0.03, 0.1, 0.2, 0.5, 1.0, 3.0, 10.0, 30.0, 100.0)
# Shares of its variance without a candidate that a family may keep once the candidate is added.
_SHARES = (0.0, 0.03, 0.1, 0.25, 0.5, 1.0)
# A direction of a candidate with less than this share of its squared norm outside the model is absorbed
# (1 % of the norm).
ABSORBED = 1e-4
_ROUNDING = 1e-11


@dataclass(frozen=True)
class Reduced:
    """Inner products of candidates and spread with the model projected off.

    Attributes:
        gram: (k + u, k + u) of [candidates, spread].
        squares: (k + u,) squared norms before.
        n_candidates: k.
        family: (u,) family of each spread column.
        dimension: degrees of freedom of the residuals.
        usual: variance of the spread that is usual, in units of the readings' variance. Larger ones are ever less
            likely (a half-normal prior): a large spread is itself something that the model lacks.
        root: (k + u, r) such that root root^T is the matrix over the norms before.
    """

    gram: Array
    squares: Array
    n_candidates: int
    family: IntArray
    dimension: int
    usual: float
    root: Array


@dataclass(frozen=True)
class Data:
    """Data sets, as far as they matter.

    Attributes:
        products: (k + u, b) inner products of the columns with each data set.
        squares: (b,) squared norm of each data set.
    """

    products: Array
    squares: Array


@dataclass(frozen=True)
class Likelihoods:
    """Twice the largest log-likelihoods, without and with each block.

    Attributes:
        null: (b,) without any candidate.
        null_ratio: (b, f) variances of the spread there.
        null_variance: (b,) variance of the readings in units of the declared one.
        block: (blocks, b) with each block.
        rank: (blocks,) unknowns that each block adds; 0 if it is absorbed.
        ratio: (blocks, b) index of the best variances, into `ratios`.
        ratios: list of the variances tried.
    """

    null: Array
    null_ratio: Array
    null_variance: Array
    block: Array
    rank: IntArray
    ratio: IntArray
    ratios: list[tuple[float, ...]]


def reduce(projected: Projected, family: IntArray, dimension: int, usual: float) -> Reduced:
    """Inner products of candidates and, last, spread columns, without the rounding that would make them indefinite.

    Args:
        projected: of [candidates, spread], see `model.fit.screen`.
        family: (u,) family of each spread column.
        dimension: degrees of freedom of the residuals.
        usual: see `Reduced`.
    """
    gram = projected.gram[:-1, :-1]
    scale = np.sqrt(np.maximum(projected.squares[:-1], np.finfo(float).tiny))
    values, vectors = np.linalg.eigh(gram / np.outer(scale, scale))
    vectors = vectors[:, values > _ROUNDING] * np.sqrt(values[values > _ROUNDING])
    clean = vectors @ vectors.T * np.outer(scale, scale)
    return Reduced(clean, projected.squares[:-1], len(gram) - len(family), family, dimension, usual, vectors)


def observed(gram_with_residual: Array) -> Data:
    """The measured data set: the last column of a projected Gram matrix."""
    return Data(gram_with_residual[:-1, -1:].copy(), gram_with_residual[-1:, -1].copy())


def directions(reduced: Reduced, block: slice) -> Array:
    """(k, r) combinations of a block's columns, orthonormal outside the model, without what the model absorbs."""
    inner = reduced.gram[block, block]
    scale = np.sqrt(np.maximum(reduced.squares[block], np.finfo(float).tiny))
    scaled = inner / np.outer(scale, scale)
    values, vectors = np.linalg.eigh((scaled + scaled.T) / 2)
    keep = values > ABSORBED
    return np.asarray(vectors[:, keep] / np.sqrt(values[keep]) / scale[:, None])


def spread_ratios(reduced: Reduced, data: Data) -> list[tuple[float, ...]]:
    """Variances worth trying: those of the most likely null model of the first data set, and shares of them.

    The families describe the same spread in different ways, so that only the likelier one is used. A candidate can only
    take from the spread: nothing above the variance without a candidate is tried.
    """
    families = int(reduced.family.max(initial=-1)) + 1
    one = Data(data.products[:, :1], data.squares[:1])
    tries = [tuple(ratio if g == f else 0.0 for g in range(families)) for f in range(families) for ratio in _RATIOS]
    best = scan(reduced, [], one, tries or [()]).null_ratio[0]
    return [tuple(share * float(ratio) for ratio in best) for share in (_SHARES if best.any() else (0.0,))]


def scan(reduced: Reduced, blocks: Sequence[slice], data: Data, ratios: list[tuple[float, ...]]) -> Likelihoods:
    """Maximise the likelihood over the variances of the spread, for every block and data set.

    Args:
        reduced: inner products.
        blocks: where the columns of each block are.
        data: the data sets.
        ratios: variances to try, one for each family.
    """
    k = reduced.n_candidates
    families = int(reduced.family.max(initial=-1)) + 1
    bases = [directions(reduced, block) for block in blocks]
    rank = np.array([basis.shape[1] for basis in bases], dtype=np.int64)
    # From here on candidates are in their own orthonormal directions.
    joined = np.zeros((k, int(rank.sum())))
    places, first = [], 0
    for block, basis in zip(blocks, bases, strict=True):
        places.append(slice(first, first + basis.shape[1]))
        joined[block, places[-1]] = basis
        first += basis.shape[1]
    own = joined.T @ reduced.gram[:k, :k] @ joined
    cross = joined.T @ reduced.gram[:k, k:]
    own_data = joined.T @ data.products[:k]
    spread_data = data.products[k:]
    b = len(data.squares)
    n = reduced.dimension
    null = np.full(b, -np.inf)
    null_ratio = np.zeros((b, families))
    null_variance = np.ones(b)
    best = np.full((len(blocks), b), -np.inf)
    chosen = np.zeros((len(blocks), b), dtype=np.int64)
    for index, ratio in enumerate(ratios):
        used, s, lower = _core(reduced, ratio)
        if len(used):
            shrink = np.linalg.solve(lower, s[:, None] * np.column_stack([cross[:, used].T, spread_data[used]]))
            left, right = shrink[:, : len(own)], shrink[:, len(own) :]
            weighted, product_ = own - left.T @ left, own_data - left.T @ right
            squares = data.squares - np.einsum("ub,ub->b", right, right)
        else:
            weighted, product_, squares = own, own_data, data.squares
        squares = np.maximum(squares, 1e-300)
        price = _price(reduced, ratio, lower)
        value = -n * np.log(squares / n) - price
        better = value > null
        null[better], null_variance[better] = value[better], squares[better] / n
        null_ratio[better] = ratio
        for j, place in enumerate(places):
            if rank[j] == 0:
                best[j] = np.maximum(best[j], value)
                continue
            inner = weighted[place, place]
            right_side = product_[place]
            if rank[j] == 1:
                gain = right_side[0] ** 2 / inner[0, 0]
            else:
                half = np.linalg.solve(
                    np.linalg.cholesky(inner + 1e-12 * np.trace(inner) * np.eye(len(inner))), right_side
                )
                gain = np.einsum("rb,rb->b", half, half)
            value_j = -n * np.log(np.maximum(squares - gain, 1e-12 * squares) / n) - price
            better = value_j > best[j]
            best[j][better] = value_j[better]
            chosen[j][better] = index
    return Likelihoods(null, null_ratio, null_variance, best, rank, chosen, ratios)


def simulate(reduced: Reduced, ratio: Array, variance: float, count: int, rng: np.random.Generator) -> Data:
    """Data sets in which nothing is missing: noise and spread between runs, drawn from the fitted null model.

    Args:
        reduced: inner products.
        ratio: (f,) variances of the spread in units of the readings' variance.
        variance: variance of the readings in units of the declared one.
        count: number of data sets.
        rng: source of random numbers.
    """
    k = reduced.n_candidates
    size = len(reduced.gram)
    scale = np.sqrt(np.maximum(reduced.squares, np.finfo(float).tiny))
    root_matrix = reduced.root[:, -min(reduced.root.shape[1], reduced.dimension) :]
    rank = root_matrix.shape[1]
    draws = rng.standard_normal((rank, count))
    noise = scale[:, None] * (root_matrix @ draws)
    rest = rng.chisquare(reduced.dimension - rank, count) if reduced.dimension > rank else np.zeros(count)
    squares = np.einsum("rb,rb->b", draws, draws) + rest
    root = np.sqrt(ratio)[reduced.family] if len(ratio) else np.zeros(size - k)
    coefficients = root[:, None] * rng.standard_normal((size - k, count))
    moved = reduced.gram[:, k:] @ coefficients
    squares = (
        squares + 2 * np.einsum("ub,ub->b", coefficients, noise[k:]) + np.einsum("ub,ub->b", coefficients, moved[k:])
    )
    root_variance = np.sqrt(variance)
    return Data((noise + moved) * root_variance, squares * variance)


def spread_price(reduced: Reduced, ratio: tuple[float, ...]) -> float:
    """What spread of these variances costs a likelihood: twice its logarithm, beside the sum of squares."""
    return _price(reduced, ratio, _core(reduced, ratio)[2])


def _price(reduced: Reduced, ratio: tuple[float, ...], lower: Array) -> float:
    """Its determinant's part and the prior's."""
    return 2 * float(np.log(np.diag(lower)).sum()) + sum(ratio) / reduced.usual


def _core(reduced: Reduced, ratio: tuple[float, ...]) -> tuple[IntArray, Array, Array]:
    """Spread columns whose variance is not zero, the roots of these variances, and the factor of what they add."""
    root = np.sqrt(np.array(ratio))[reduced.family] if len(ratio) else np.zeros(0)
    used = np.flatnonzero(root > 0)
    s = np.asarray(root[used])
    place = reduced.n_candidates + used
    lower = np.linalg.cholesky(np.eye(len(s)) + reduced.gram[np.ix_(place, place)] * np.outer(s, s))
    return used.astype(np.int64), s, np.asarray(lower)


def weighted_products(
    reduced: Reduced, block: slice, data: Data, ratio: tuple[float, ...]
) -> tuple[Array, Array, float]:
    """Inner products of a block's columns and the first data set, weighted by the spread of the given variances.

    Returns:
        (k, k) of the columns, (k,) with the data, and the data's squared norm.
    """
    k = reduced.n_candidates
    inner, right, squares = reduced.gram[block, block], data.products[block, 0], float(data.squares[0])
    used, s, lower = _core(reduced, ratio)
    if len(used):
        left = np.linalg.solve(lower, s[:, None] * reduced.gram[k + used, block])
        own = np.linalg.solve(lower, s * data.products[k + used, 0])
        inner, right, squares = inner - left.T @ left, right - left.T @ own, squares - float(own @ own)
    return inner, right, squares
