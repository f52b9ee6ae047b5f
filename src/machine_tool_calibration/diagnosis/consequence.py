# SPDX-License-Identifier: Apache-2.0
"""What adding an effect does to the residuals and to the machine's map."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from machine_tool_calibration.arrays import Array, rms
from machine_tool_calibration.diagnosis.diagnose import Diagnosis
from machine_tool_calibration.diagnosis.search.findings import Finding
from machine_tool_calibration.errors import ModelError
from machine_tool_calibration.estimation.reduction import single_blas
from machine_tool_calibration.methods.fitted import FittedSessions, fit_sessions
from machine_tool_calibration.model.fit import JointFit
from machine_tool_calibration.model.model import Kind
from machine_tool_calibration.model.result import ErrorMap, Estimate
from machine_tool_calibration.residuals.pool import Pool

__all__ = ["Consequence", "before_and_after", "consequences", "effect_estimates", "map_change", "map_rms"]

# How many of the best candidates are added in full, each by itself.
_MOST = 4
# Uncertainty over size of an effect's share in the readings, above which it is not stated.
_TOLD = 0.3


@dataclass(frozen=True)
class Consequence:
    """An effect added to the model.

    Attributes:
        effect: its id.
        parameters: its coefficients, with the names under which an identification publishes them.
        signal_rms: RMS of what it changes in the readings, m; None where the data tell only a part of that from the
            model's own unknowns.
        signal_largest: the largest of these changes, m; None likewise.
        rms_before: RMS residual without it, m.
        rms_after: RMS residual with it, m.
        map_change_rms: RMS length by which the position errors of the map's points change, m; None where the method's
            map has none in common.
        explained: (n,) what it takes out of the residual of each reading, m.
    """

    effect: str
    parameters: tuple[Estimate, ...]
    signal_rms: float | None
    signal_largest: float | None
    rms_before: float
    rms_after: float
    map_change_rms: float | None
    explained: Array


@single_blas()
def consequences(diagnosis: Diagnosis, most: int = _MOST) -> dict[str, Consequence]:
    """What each of the best candidates would change; of those accepted, what each did change, in their order.

    The coefficients of accepted effects are those with all of them in the model.

    Args:
        diagnosis: the candidates.
        most: how many candidates beside those accepted.

    Returns:
        By id; without a candidate that cannot be fitted.
    """
    out = {}
    accepted, fitted = diagnosis.accepted, diagnosis.fitted
    for name, before, after in zip(accepted, fitted[:-1], fitted[1:], strict=True):
        out[name] = _consequence(name, before, after, fitted[-1].joint)
    for name in [f.name for f in diagnosis.ranked if f.rank and f.name not in accepted][:most]:
        try:
            alone = fit_sessions(diagnosis.searched.adding([name]))
        except ModelError:
            continue
        out[name] = _consequence(name, fitted[0], alone, alone.joint)
    return out


def before_and_after(diagnosis: Diagnosis, found: Finding, changes: Mapping[str, Consequence]) -> tuple[float, float]:
    """RMS residual without and with a candidate, m: of a full fit where there is one, else of the screening."""
    if found.name in changes:
        return changes[found.name].rms_before, changes[found.name].rms_after
    return rms(Pool(diagnosis.fits[0]).residuals), found.rms_after


def _consequence(name: str, before: FittedSessions, after: FittedSessions, final: JointFit) -> Consequence:
    signal, uncertainty = _signal(final, name)
    old, new = Pool(before.joint).residuals, Pool(after.joint).residuals
    told = rms(uncertainty) < _TOLD * rms(signal)
    return Consequence(
        effect=name,
        parameters=effect_estimates(final, [name]),
        signal_rms=rms(signal) if told else None,
        signal_largest=float(np.abs(signal).max(initial=0.0)) if told else None,
        rms_before=rms(old),
        rms_after=rms(new),
        map_change_rms=map_change(before.error_map, after.error_map),
        explained=old - new,
    )


def effect_estimates(fit: JointFit, effects: Sequence[str]) -> tuple[Estimate, ...]:
    """Coefficients of effects in a fit that the data determines, as `identify` publishes them."""
    published = fit.published
    uncertainty = np.sqrt(np.maximum(np.diag(published.covariance), 0.0))
    found = zip(fit.assembly.parameters, published.theta, uncertainty, published.determined, strict=True)
    return tuple(
        Estimate.of(p, value, u) for p, value, u, good in found if good and p.kind is Kind.EFFECT and p.owner in effects
    )


def _signal(joint: JointFit, name: str) -> tuple[Array, Array]:
    """(n,) what an effect of the model changes in the readings, and its standard uncertainty, m."""
    value, variance = [], []
    for fit in joint.fits:
        own, square = np.zeros(len(fit.model.observations)), np.zeros(len(fit.model.observations))
        first = len(fit.model.own)
        for term in fit.model.terms:
            place = slice(first, first + len(term.parameters))
            first += len(term.parameters)
            if term.name != name or term.parameters[0].kind is not Kind.EFFECT:
                continue
            # Unknowns that count from a reference are nonlinear coefficients, whose share the other columns hold.
            linear = np.array([p.reference == 0.0 for p in term.parameters])
            columns = term.columns[linear]
            inner = fit.covariance[place, place][np.ix_(linear, linear)]
            own, square = fit.theta[place][linear] @ columns, np.einsum("kn,kl,ln->n", columns, inner, columns)
        value.append(own)
        variance.append(square)
    return np.concatenate(value), np.sqrt(np.maximum(np.concatenate(variance), 0.0))


def map_change(before: ErrorMap, after: ErrorMap) -> float | None:
    """RMS length of the change of the position errors that both maps determine, m.

    A map may hold a point several times, once for every state of an effect there (approached from either side); each is
    compared with what the other map says of the same place.
    """
    old = before.error
    if not np.array_equal(before.points, after.points):
        places, number = np.unique(np.round(before.points * 1e9), axis=0, return_inverse=True)
        count = np.bincount(number.reshape(-1))
        mean = np.stack([np.bincount(number.reshape(-1), e) for e in before.error.T], axis=1) / count[:, None]
        at = {tuple(place): value for place, value in zip(places.tolist(), mean, strict=True)}
        nothing = np.full(3, np.nan)
        old = np.array([at.get(tuple(p), nothing) for p in np.round(after.points * 1e9).tolist()]).reshape(-1, 3)
    return map_rms(after.error - old)


def map_rms(values: Array) -> float | None:
    """RMS length of (n, 3) vectors at the points where any of their coordinates is determined."""
    known = np.isfinite(values)
    points = known.any(axis=1)
    if not points.any():
        return None
    return float(np.sqrt(np.sum(np.where(known, values, 0.0) ** 2) / points.sum()))
