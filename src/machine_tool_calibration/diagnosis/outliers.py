"""Single readings that do not belong to the rest: a chip under the probe, a broken beam."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np
from scipy import stats

from machine_tool_calibration.arrays import BoolArray
from machine_tool_calibration.diagnosis.leverage import leverage
from machine_tool_calibration.model.fit import Fit, fit_models
from machine_tool_calibration.model.model import MethodModel
from machine_tool_calibration.session.session import Session

__all__ = ["Outlier", "find_outliers"]

# Chance that a clean session has any reading called an outlier.
_LEVEL = 0.01
# Not more than this share of the readings: beyond, they are no longer isolated.
_MOST = 0.08
# A reading with less than this share of itself in its residual cannot be judged.
_SEEN = 0.02
# Where the tails of direct deviations are looked at, and the degrees of freedom of Student's distribution tried there.
_SHOULDERS = (0.8, 0.9, 0.95)
_DOFS = (4.0, 6.0, 10.0, 20.0, 1000.0)


@dataclass(frozen=True)
class Outlier:
    """A reading that was set aside.

    Attributes:
        row: its number in the recording.
        studentized: its residual, from a fit without it, over that residual's standard uncertainty.
        deviation: that residual, m.
    """

    row: int
    studentized: float
    deviation: float


def find_outliers(session: Session, build: Callable[[Session], MethodModel]) -> tuple[list[Outlier], Session, Fit]:
    """Set aside, one after the other, readings that stand out of all others.

    The scale is that of the bulk of the residuals: where an effect is missing all residuals are large, and none
    stands out. The worst one is removed and the model fitted again, as it also pulls at its neighbours.

    Args:
        session: the measurement.
        build: makes the model of a session.

    Returns:
        Outliers in the order of removal, the session without them, and its fit.
    """
    whole = session
    first = fit = fit_models([build(session)]).fits[0]
    found: list[Outlier] = []
    most = int(_MOST * len(session.readings))
    while len(found) < most:
        studentized, deviation, limit = _studentized(fit)
        # Several at once while they are far out, so that many chips do not need as many fits.
        order = np.argsort(-np.abs(studentized))
        worst = order[0]
        if abs(studentized[worst]) < limit:
            break
        far = [int(worst)] + [
            int(k)
            for k in order[1 : 1 + most // 4]
            if abs(studentized[k]) > max(2.0 * limit, 0.7 * abs(studentized[worst]))
        ]
        rows = fit.model.observations.readings.row
        found += [Outlier(int(rows[k]), float(studentized[k]), float(deviation[k])) for k in far]
        session = _without(whole, found)
        fit = fit_models([build(session)]).fits[0]
    kept = _without_innocent(whole, found, build)
    if _clustered(whole, kept):
        return [], whole, first
    if len(kept) < len(found):
        session = _without(whole, kept)
        fit = fit_models([build(session)]).fits[0]
    return kept, session, fit


def _without(session: Session, outliers: Iterable[Outlier]) -> Session:
    readings = session.readings
    return session.with_readings(readings.select(~np.isin(readings.row, [o.row for o in outliers])))


def _without_innocent(whole: Session, found: list[Outlier], build: Callable[[Session], MethodModel]) -> list[Outlier]:
    """Those that still stand out when they are put back alone: what a bad neighbour pulled away is put back."""
    kept = list(found)
    for suspect in found:
        others = [o for o in kept if o is not suspect]
        fit = fit_models([build(_without(whole, others))]).fits[0]
        studentized, deviation, limit = _studentized(fit)
        at = int(np.flatnonzero(fit.model.observations.readings.row == suspect.row)[0])
        if abs(studentized[at]) < limit:
            kept = others
        else:
            # Now it is held against all that are sound.
            now = Outlier(suspect.row, float(studentized[at]), float(deviation[at]))
            kept[kept.index(suspect)] = now
    return kept


def _clustered(session: Session, found: list[Outlier]) -> bool:
    """Whether most of them are neighbours in their run: then they are no chips but something that lasts."""
    readings = session.readings
    flagged = np.isin(readings.row, [o.row for o in found])
    beside = np.zeros(len(readings), dtype=bool)
    # Deviations of a place along x and along y stand beside each other, and are two runs.
    senses = [np.round(readings.columns[name], 6) for name in ("gx", "gy", "gz") if name in readings.columns]
    run = np.unique(np.stack([readings.setup, *senses]), axis=1, return_inverse=True)[1].reshape(-1)
    for s in np.unique(run):
        mine = np.flatnonzero(run == s)
        beside[mine[1:]] |= flagged[mine[:-1]]
        beside[mine[:-1]] |= flagged[mine[1:]]
    return len(found) > 2 and 2 * int((flagged & beside).sum()) >= len(found)


def _studentized(fit: Fit) -> tuple[np.ndarray, np.ndarray, float]:
    """Residuals over what the bulk of them says is their size, the deviations that they stand for, and the limit."""
    sigma = fit.model.sigma
    free = 1.0 - leverage(fit)
    judged: BoolArray = free > _SEEN
    normal = np.zeros(len(free))
    normal[judged] = fit.residuals[judged] / (sigma[judged] * np.sqrt(free[judged]))
    bulk = float(np.median(np.abs(normal[judged]))) / stats.norm.ppf(0.75) if judged.any() else 1.0
    # The bulk's size is itself uncertain where few degrees of freedom are left.
    dof = max(fit.solution.degrees_of_freedom * 0.37, 4.0)
    limit = float(stats.t.isf(_LEVEL / max(int(judged.sum()), 1) / 2, dof))
    if fit.model.observations.session.method == "direct" and judged.any():
        limit = max(limit, _limit_of_tails(np.abs(normal[judged]) / max(bulk, 1e-12)))
    deviation = np.zeros(len(free))
    deviation[judged] = fit.residuals[judged] / free[judged]
    return normal / max(bulk, 1e-12), deviation, max(limit, 4.5)


def _limit_of_tails(size: np.ndarray) -> float:
    """Limit for residuals that scatter with longer tails than noise does, as holes do that a drill made.

    Student's distribution with as many degrees of freedom as the shoulders of the residuals ask for; readings further
    out than the shoulders have no say.

    Args:
        size: absolute residuals over the bulk's standard deviation.
    """
    shoulder = np.array([np.quantile(size, q) for q in _SHOULDERS])
    probability = (1 + np.array(_SHOULDERS)) / 2
    misfit = []
    for dof in _DOFS:
        expected = stats.t.ppf(probability, dof) / stats.t.ppf(0.75, dof) * stats.norm.ppf(0.75)
        misfit.append(float(np.sum(np.log(shoulder / expected) ** 2)))
    dof = _DOFS[int(np.argmin(misfit))]
    return float(stats.t.isf(_LEVEL / len(size) / 2, dof) / stats.t.ppf(0.75, dof) * stats.norm.ppf(0.75))
