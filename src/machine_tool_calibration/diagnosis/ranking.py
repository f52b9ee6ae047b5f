"""Candidates in the order of their probability, with size, plausibility and what looks alike."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.diagnosis.candidates import Candidate
from machine_tool_calibration.diagnosis.likelihood import Data, Reduced, directions, weighted_products
from machine_tool_calibration.diagnosis.significance import Search
from machine_tool_calibration.effects.effect import Coefficient
from machine_tool_calibration.model.observations import Observations

__all__ = ["Ranked", "Size", "against_chance", "alias_groups", "rank_candidates"]

# Cosine from which two candidates count as look-alikes.
_ALIKE = 0.9
# Handicap of a size that does not occur, in the logarithm of the p-value.
_IMPLAUSIBLE = float(np.log(1e3))


@dataclass(frozen=True)
class Size:
    """Predicted coefficient of a candidate."""

    coefficient: Coefficient
    value: float
    standard_uncertainty: float

    @property
    def possible(self) -> bool:
        """Whether its sign can be, given its uncertainty: no backlash is negative."""
        return self.coefficient.low != 0 or self.value > -2.0 * self.standard_uncertainty

    @property
    def plausible(self) -> bool:
        """Whether it is of a size that occurs, given its uncertainty."""
        margin = 2.0 * self.standard_uncertainty
        return self.coefficient.low <= self.value + margin and self.value - margin <= self.coefficient.high


@dataclass(frozen=True)
class Ranked:
    """A candidate after the search.

    Attributes:
        candidate: what it is.
        shape: its best nonlinear coefficients.
        sizes: its linear coefficients.
        statistic: likelihood ratio, twice the logarithm.
        rank: unknowns that it adds; 0 if the model absorbs it.
        p_value: by itself.
        log_p_value: its natural logarithm, where the number itself would vanish.
        family_p_value: paid for the whole search.
        bic_gain: by how much the Bayesian information criterion falls when it is added.
        probability: its weight among all candidates and none.
        rms_after: root mean square of the residuals with it, m.
        possible: whether all coefficients have a possible sign.
        plausible: whether all coefficients are of a size that occurs.
        columns: (k, n) at these nonlinear coefficients.
        information: (k, k) inner products of its columns outside model and spread, for the smallest detectable size.
        place: where its columns are among all.
        signal: (k,) coefficients of what it explains.
    """

    candidate: Candidate
    shape: tuple[float, ...]
    columns: Array
    sizes: tuple[Size, ...]
    statistic: float
    rank: int
    p_value: float
    log_p_value: float
    family_p_value: float
    bic_gain: float
    probability: float
    rms_after: float
    possible: bool
    plausible: bool
    information: Array
    place: slice
    signal: Array


def rank_candidates(
    candidates: Sequence[Candidate],
    places: Sequence[Sequence[slice]],
    search: Search,
    reduced: Reduced,
    data: Data,
    observations: Observations,
    n_readings: int,
) -> tuple[Ranked, ...]:
    """All candidates, the most probable first; absorbed ones last."""
    out = []
    for k, candidate in enumerate(candidates):
        block = candidate.blocks[search.block[k]]
        place = places[k][search.block[k]]
        index = sum(len(p) for p in places[:k]) + int(search.block[k])
        ratio = search.likelihoods.ratios[search.likelihoods.ratio[index, 0]]
        rank = int(search.rank[k])
        basis = directions(reduced, place)
        sizes: tuple[Size, ...] = ()
        signal = np.zeros(len(block.columns))
        information = np.zeros((len(block.columns),) * 2)
        rms_after = float(np.sqrt(data.squares[0] / n_readings)) * observations.session.sigma
        if rank:
            inner, right, squares = weighted_products(reduced, place, data, ratio)
            information = inner
            small = basis.T @ inner @ basis
            coefficient = np.linalg.solve(small, basis.T @ right)
            variance = max(float(squares - (basis.T @ right) @ coefficient) / reduced.dimension, 1e-300)
            signal = basis @ coefficient
            spread = np.sqrt(np.maximum(np.diag(basis @ np.linalg.inv(small) @ basis.T) * variance, 0.0))
            plain = data.products[place, 0]
            unweighted = basis @ (basis.T @ plain)
            rms_after = (
                float(np.sqrt(max(data.squares[0] - plain @ unweighted, 0.0) / n_readings)) * observations.session.sigma
            )
            if candidate.effect is not None:
                named = candidate.effect.coefficients_for(observations, block.shape)
                sizes = tuple(Size(c, float(v), float(u)) for c, v, u in zip(named, signal, spread, strict=True))
        unknowns = rank + candidate.shapes
        gain = float(search.statistic[k]) - unknowns * np.log(max(candidate.sample, 2)) if rank else -np.inf
        out.append(
            Ranked(
                candidate=candidate,
                shape=block.shape,
                columns=block.columns,
                sizes=sizes,
                statistic=float(search.statistic[k]) if rank else 0.0,
                rank=rank,
                p_value=float(search.p_value[k]),
                log_p_value=float(search.log_p_value[k]),
                family_p_value=float(search.family_p_value[k]),
                bic_gain=gain,
                probability=0.0,
                rms_after=rms_after,
                possible=all(size.possible for size in sizes),
                plausible=all(size.plausible for size in sizes),
                information=information,
                place=place,
                signal=signal,
            )
        )
    return _with_probabilities(out)


def _with_probabilities(ranked: list[Ranked]) -> tuple[Ranked, ...]:
    """Weights from the largest Bayes factor that a p-value allows, 1 / (-e p ln p) (Sellke, Bayarri and Berger 2001).

    The p-values are those of the simulated null: they know how many coefficients a candidate has and how much the
    spread between setups can do in its place, which an information criterion does not. "None of these" has the weight
    1; an impossible sign has none, and a size that does not occur a thousand times less.
    """
    log_weight = np.array([_log_weight(r) for r in ranked])
    possible = np.array([bool(r.possible and r.rank) for r in ranked])
    top = max(float(log_weight.max(initial=0.0)), 0.0)
    weights = np.where(possible, np.exp(log_weight - top), 0.0)
    total = float(weights.sum() + np.exp(-top))
    filled = [replace(r, probability=float(w / total)) for r, w in zip(ranked, weights, strict=True)]
    # Candidates with the same columns keep the catalogue's order, whatever the last bits say.
    return tuple(sorted(filled, key=lambda r: (not (r.possible and r.rank), round(_log_p(r), 6))))


def against_chance(ranked: Ranked) -> float:
    """Probability of a candidate against none alone, whatever other candidates could do."""
    return float(1.0 / (1.0 + np.exp(-_log_weight(ranked))))


def _log_weight(ranked: Ranked) -> float:
    log_p = _log_p(ranked)
    return float(-1.0 - log_p - np.log(-log_p)) if log_p < -1.0 else 0.0


def _log_p(ranked: Ranked) -> float:
    """Logarithm of the p-value, with a handicap for a size that does not occur."""
    if not (ranked.possible and ranked.rank):
        return 0.0
    return min(ranked.log_p_value + (0.0 if ranked.plausible else _IMPLAUSIBLE), 0.0)


def alias_groups(ranked: Sequence[Ranked], reduced: Reduced) -> tuple[tuple[str, ...], ...]:
    """Candidates that this data cannot tell apart: the first of each group is its most probable member.

    Two candidates are alike if one reproduces at least 0.9 (cosine) of the other's signal outside the model.
    """
    left = [r for r in ranked if r.rank]
    groups = []
    while left:
        head, rest = left[0], left[1:]
        alike = [r for r in rest if max(_cosine(head, r, reduced), _cosine(r, head, reduced)) >= _ALIKE]
        if alike:
            groups.append((head.candidate.name, *(r.candidate.name for r in alike)))
        names = {r.candidate.name for r in alike}
        left = [r for r in rest if r.candidate.name not in names]
    return tuple(groups)


def _cosine(one: Ranked, other: Ranked, reduced: Reduced) -> float:
    """Share of one candidate's fitted signal that the other's columns reproduce."""
    own = float(one.signal @ reduced.gram[one.place, one.place] @ one.signal)
    if own <= 0:
        return 0.0
    basis = directions(reduced, other.place)
    seen = basis.T @ reduced.gram[other.place, one.place] @ one.signal
    return float(np.sqrt(min(float(seen @ seen) / own, 1.0)))
