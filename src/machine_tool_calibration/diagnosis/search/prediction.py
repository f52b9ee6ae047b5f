# SPDX-License-Identifier: Apache-2.0
"""Whether an effect predicts readings that were not used to find it.

Setups, blocks of places, and cycles are left out in turn. An effect that is real makes the readings that were left out
more probable, given the others: log p(left out | others) is the difference of the evidence with and without them, so
that what the effect adds to it is by how much its Bayes factor grows when they come in. An effect that only bends
around the readings at hand loses there what it seems to win.
"""

import itertools
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from machine_tool_calibration.arrays import IntArray, groups
from machine_tool_calibration.diagnosis.search.candidates import ShapedColumns, shaped_at
from machine_tool_calibration.diagnosis.search.effect_search import EffectSearch
from machine_tool_calibration.diagnosis.search.evidence import Block, batches, columns_of, gram_of, table
from machine_tool_calibration.errors import CalibrationError
from machine_tool_calibration.estimation import priors
from machine_tool_calibration.estimation.marginal import marginal_at
from machine_tool_calibration.model.fit import JointFit, fit_models
from machine_tool_calibration.residuals.pool import Pool
from machine_tool_calibration.session.session import Session
from machine_tool_calibration.words import say

# Parts into which setups and places are divided at most.
_PARTS = 4
# Effects that are held against readings left out: more are not distinguished that way.
_MOST_EFFECTS = 6
# Variance of the noise over that declared below which the residuals are rounding.
_LEAST_NOISE = 1e-12
_BY_PLACES = say("part.places")


@dataclass(frozen=True)
class Prediction:
    """An effect on readings that were left out."""

    what: str  # setups, blocks of places, or cycles
    # for each part, by how much the effect, as determined by the others, raises the logarithm of its likelihood; of the
    # parts that could be left out
    log_gains: tuple[float, ...]
    readings: int  # in these parts
    needed: int = 0  # parts that could not be left out, as the others do not determine the model

    @property
    def gain(self) -> float:
        """Share by which the mean square of what is predicted wrongly falls.

        The noise is that of the readings beside what was found: what is left of them is one variance each.
        """
        gained = 2.0 * sum(self.log_gains)
        return float(gained / (max(self.readings, 1) + max(gained, 0.0)))

    @property
    def speaks_against(self) -> bool:
        """Whether the parts that were left out are predicted worse with the effect than without.

        All together clearly, or one of them clearly while the others do not make up for it. An effect may act at some
        places alone; what half the setups or cycles do not show is none of the machine.
        """
        gains = np.array(self.log_gains)
        if gains.min() >= -priors.CONTRADICTING:
            return bool(gains.sum() < -priors.CONTRADICTING)
        if self.what == _BY_PLACES:
            return bool(gains.sum() < priors.CONTRADICTING)
        return bool(gains.sum() < -priors.CONTRADICTING or 2 * int((gains < 0).sum()) >= len(gains))


def predictions(
    sessions: Sequence[Session], search: EffectSearch, fit_of: Callable[[tuple[Session, ...]], JointFit]
) -> dict[str, tuple[Prediction, ...]]:
    """Every effect that a search in all readings accepted on setups, blocks of places and cycles that were left out.

    `fit_of` fits the model, without further effects, to parts of the sessions.
    """
    names = search.accepted[:_MOST_EFFECTS]
    if not names:
        return {}
    found = [search.of(name) for name in names]
    every = search.pool
    shaped = [shaped_at(every, f.candidate.effect, f.shape) for f in found if f.candidate.effect is not None]
    whole = _log_factors(every, every, shaped, search)
    out: dict[str, list[Prediction]] = {name: [] for name in names}
    # Readings that were taken together are not held against common mistakes by parts.
    sessions = [session.trusted for session in sessions]
    for what, parts in _divisions(sessions):
        gains, readings, needed = [], 0, 0
        for k in range(1 + max(int(part.max(initial=-1)) for part in parts)):
            left = tuple(s.with_readings(s.readings.select(part != k)) for s, part in zip(sessions, parts, strict=True))
            try:
                gains.append(whole - _log_factors(Pool(_drawn_as(fit_of(left), every.fit)), every, shaped, search))
            except (CalibrationError, np.linalg.LinAlgError):
                needed += 1
                continue
            readings += sum(int((part == k).sum()) for part in parts)
        if len(gains) < 2:
            continue
        for name, own in zip(names, np.array(gains).T, strict=True):
            out[name].append(Prediction(what, tuple(own.tolist()), readings, needed))
    return {name: tuple(own) for name, own in out.items() if own}


def _drawn_as(part: JointFit, whole: JointFit) -> JointFit:
    """The fit of a part of the readings, with what the models draw from all of them."""
    mine = part.assembly.models
    models = [model.drawn_as(every) for model, every in zip(mine, whole.assembly.models, strict=True)]
    if all(model is own for model, own in zip(models, mine, strict=True)):
        return part
    return fit_models(models, part.assembly.labels, part.random)


def _log_factors(pool: Pool, every: Pool, shaped: Sequence[ShapedColumns], search: EffectSearch) -> np.ndarray:
    """(effects,) logarithm of the Bayes factor of each beside the others.

    The noise and what does not reproduce have the same size for all readings and for a part of them, and each pass, run
    or mounting the same functions: only so do the two compare. Where the noise were estimated from a part, one that
    something else spoils would speak against every effect of which the others are sure; and a single cycle, in which
    nothing tells passes from what the direction does, would speak for what all cycles together share with the passes.
    The `pool` is of all readings or a part; the effects' columns and the search are of `every` reading.
    """
    columns, family, names = every.spread
    # Structures without a cause stand beside every effect: what they leave out would count against it.
    further = search.without_cause
    columns = np.concatenate([*(s.columns for s in shaped), further, columns])[:, _rows(pool, every)]
    gram = replace(gram_of(pool, pool.screen(columns)), family=family, sizes=every.sizes)
    gram = gram.with_memory(search.memory).with_noise(max(search.variance, _LEAST_NOISE))
    ends = np.cumsum([0, *(len(s.columns) for s in shaped)]).tolist()
    places = [slice(first, end) for first, end in itertools.pairwise(ends)]
    blocks = [Block.of(0, place, s, np.zeros(len(s.columns))) for s, place in zip(shaped, places, strict=True)]
    sizes = dict(search.spread)
    known = ends[-1] + np.arange(len(further))
    base = marginal_at(gram, [[sizes.get(name, 0.0) for name in names]]).with_columns(known, search.expected)
    out = np.zeros(len(blocks))
    for j, block in enumerate(blocks):
        others = [o for o in blocks if o is not block]
        unit = np.concatenate([np.zeros(0), *(o.unit for o in others)])
        factor = float(table(batches(gram, [block]), base.with_columns(columns_of(others), unit), 1).log_factors[0])
        # Readings on which the effect does not show say nothing of it.
        out[j] = factor if np.isfinite(factor) else 0.0
    return out


def _rows(part: Pool, whole: Pool) -> IntArray:
    """(m,) place of each reading of a part among all."""
    out = []
    for own, every, piece in zip(part.observations, whole.observations, whole.pieces, strict=True):
        order = np.argsort(every.readings.row)
        out.append(piece.start + order[np.searchsorted(every.readings.row, own.readings.row, sorter=order)])
    return np.concatenate(out)


def _divisions(sessions: Sequence[Session]) -> Iterator[tuple[str, list[IntArray]]]:
    """Ways to divide the readings, with the part of each reading of each session."""
    setups = [groups(s.readings.setup) for s in sessions]
    if max(int(part.max(initial=0)) for part in setups) >= 2:
        yield say("head.setups"), [part % min(_PARTS, int(part.max(initial=0)) + 1) for part in setups]
    position = np.concatenate([s.readings.position() for s in sessions])
    columns = sessions[0].readings.columns
    angle = next((columns[axis] for axis in "abc" if axis in columns), None)
    place = _zones(position, angle if len(sessions) == 1 else None)
    if place is not None:
        yield _BY_PLACES, np.split(place, np.cumsum([len(s.readings) for s in sessions])[:-1])
    cycles = [groups(s.readings.repeat) for s in sessions]
    if max(int(part.max(initial=0)) for part in cycles) >= 1:
        yield say("part.cycles"), [part % _PARTS for part in cycles]


def _zones(position: np.ndarray, angle: np.ndarray | None) -> IntArray | None:
    """Blocks of places: halves along the two axes that were moved farthest, or quarters of one; None without places."""
    columns = [*position.T] if angle is None or np.ptp(position, axis=0).max(initial=0.0) > 0 else [angle]
    extent = [float(np.ptp(values)) if len(values) else 0.0 for values in columns]
    moved = [k for k in np.argsort(extent)[::-1] if extent[k] > 0][:2]
    if not moved:
        return None
    if len(moved) == 1:
        edges = np.unique(np.quantile(columns[moved[0]], [0.25, 0.5, 0.75]))
        part = np.searchsorted(edges, columns[moved[0]], side="right")
    else:
        halves = [columns[k] > np.median(columns[k]) for k in moved]
        part = 2 * halves[0].astype(np.int64) + halves[1]
    part = groups(part)
    return part if part.max() >= 1 else None
