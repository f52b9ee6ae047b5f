# SPDX-License-Identifier: Apache-2.0
"""One map over several sets of effects that the readings do not distinguish.

Look-alikes explain the same readings and may move the map differently. The published map is then the mean over the sets
with their probabilities, and its uncertainty holds the difference between them as well (law of total variance).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.errors import ModelError
from machine_tool_calibration.methods.fitted import FitRequest, FittedSessions, fit_sessions
from machine_tool_calibration.model.result import EffectSet, ErrorMap

__all__ = ["averaged_map"]

# Largest share of its variance by which the uncertainty of a map grows, below which one set says all.
_NOTHING = 0.02


def averaged_map(fitted: FittedSessions, chosen: FitRequest) -> tuple[ErrorMap, tuple[EffectSet, ...]]:
    """The mean over sets of effects; one with which there is no map, or one that says less, is left out.

    Args:
        fitted: with the effects in the model.
        chosen: the model, and the sets with their probabilities, that of the model's own among them.

    Returns:
        The map and the sets it is over; the best one and no sets where nothing depends on it.
    """
    best = fitted.error_map
    bases = [chosen.base(session) for session in chosen.sessions] if len(chosen.sets) > 1 else []
    found: list[tuple[EffectSet, ErrorMap]] = []
    for one in chosen.sets:
        if set(one.effects) == set(chosen.effects):
            found.insert(0, (one, best))
            continue
        try:
            tried = replace(chosen, effects=one.effects)
            other = fit_sessions(tried, [tried.finished(base) for base in bases]).error_map
        except ModelError:
            continue
        if other.error.shape == best.error.shape and not (np.isfinite(best.error) & ~np.isfinite(other.error)).any():
            found.append((one, other))
    if len(found) < 2 or found[0][1] is not best:
        return best, ()
    weights = np.array([one.probability for one, _ in found])
    weights = weights / weights.sum()
    maps = [other for _, other in found]
    mean, between = _mean([m.error for m in maps], weights)
    grown = np.sqrt(_mean([m.uncertainty**2 for m in maps], weights)[0] + between)
    if not np.nanmax(grown**2 / np.maximum(best.uncertainty**2, 1e-300), initial=0.0) > 1.0 + _NOTHING:
        return best, ()
    covariance = best.covariance
    if covariance is not None and all(m.covariance is not None for m in maps):
        every = [m.covariance for m in maps if m.covariance is not None]
        off = [m.error - mean for m in maps]
        covariance = np.tensordot(weights, np.array(every), axes=1) + np.einsum("k,kni,knj->nij", weights, off, off)
    content = _content([m.content for m in maps], weights)
    over = tuple(EffectSet(one.effects, float(w)) for (one, _), w in zip(found, weights, strict=True))
    return replace(best, content=content, error=mean, uncertainty=grown, covariance=covariance), over


def _mean(values: Sequence[Array], weights: Array) -> tuple[Array, Array]:
    """Mean and variance between the sets."""
    stacked = np.array(values, dtype=float)
    mean = np.tensordot(weights, stacked, axes=1)
    return mean, np.tensordot(weights, (stacked - mean) ** 2, axes=1)


def _content(contents: Sequence[Mapping[str, Any]], weights: Array) -> dict[str, Any]:
    """Every array `name` that has its `name_u`, averaged; all else is the first map's."""
    out = dict(contents[0])
    for name in contents[0]:
        u = f"{name}_u"
        if u not in contents[0] or not all(name in c and u in c for c in contents):
            continue
        if len({np.shape(c[name]) for c in contents}) > 1:
            continue
        mean, between = _mean([c[name] for c in contents], weights)
        variance = _mean([np.asarray(c[u], dtype=float) ** 2 for c in contents], weights)[0] + between
        out[name], out[u] = mean, np.sqrt(variance)
        if np.ndim(contents[0][name]) == 0:
            out[name], out[u] = float(mean), float(out[u])
    return out
