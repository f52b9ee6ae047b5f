# SPDX-License-Identifier: Apache-2.0
"""How well a model fits its readings, and where it fails.

This describes and draws; whether something is missing, and what, is for `diagnose` to say.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import special

from machine_tool_calibration.arrays import Array, BoolArray, rms
from machine_tool_calibration.diagnosis.comparison import (
    Approach,
    Comparison,
    JointComparison,
    Overall,
    Region,
    Share,
    Trend,
)
from machine_tool_calibration.estimation.reduction import single_blas
from machine_tool_calibration.methods.fitted import Chosen, fit_sessions, gross_errors
from machine_tool_calibration.methods.identify import JointResult, fitted_sessions
from machine_tool_calibration.model.fit import Fit, screen
from machine_tool_calibration.model.result import Result
from machine_tool_calibration.residuals.covariates import bins, covariates, rank_covariates, sensed
from machine_tool_calibration.residuals.leverage import leverage
from machine_tool_calibration.residuals.noise import FEWEST_REPEATS, Noise, noise_of, same_place
from machine_tool_calibration.session.session import Session

__all__ = ["Sums", "compare", "residual_sums"]


# Sums of one pass: few enough for the memory of large sessions.
_BATCH = 64
# Share of its variance that the model leaves a sum, below which the sum says nothing.
_LEFT = 1e-6


@dataclass(frozen=True)
class Sums:
    """Sums w.r of the residuals r.

    Attributes:
        value: (k,) the sums; NaN where the model takes everything up, so that they are zero whatever was read.
        uncertainty: (k,) their standard uncertainties if the readings have the declared one.
        added: (k,) coefficient of w that the model would find if w were added to it, per unit of w.
        added_uncertainty: (k,) its standard uncertainty.
    """

    value: Array
    uncertainty: Array
    added: Array
    added_uncertainty: Array


def residual_sums(fit: Fit, weights: Array) -> Sums:
    """Sums of the residuals of a fit.

    The residuals of a fitted model are smaller than the readings' errors and go together; with M the projector off the
    model, the variance of w.r is w' V^1/2 M V^1/2 w and not sigma^2 w'w.

    Args:
        fit: of a single session.
        weights: (k, n).
    """
    variance = fit.model.sigma**2
    # Columns V w, so that their product with the weighted residuals is w.r.
    value, own, raw = _screened(fit, weights, variance)
    seen = own > _LEFT * np.maximum(raw, np.finfo(float).tiny)
    value, own = np.where(seen, value, np.nan), np.where(seen, own, np.nan)
    # w as a column of the model: the sum with weights V^-1 w over that sum's variance; the same w only where V is even.
    if float(np.ptp(variance)) <= 1e-9 * float(variance.max()):
        return Sums(value, np.sqrt(own), value / own * variance[0], variance[0] / np.sqrt(own))
    product, inner, _ = _screened(fit, weights, np.ones(1))
    inner = np.where(seen, inner, np.nan)
    return Sums(value, np.sqrt(own), product / inner, 1.0 / np.sqrt(inner))


def _screened(fit: Fit, weights: Array, scale: Array) -> tuple[Array, Array, Array]:
    """Of each column: its product with the residuals, its square outside the model, and its square."""
    out = np.empty((3, len(weights)))
    for first in range(0, len(weights), _BATCH):
        pick = slice(first, first + _BATCH)
        sums = screen(fit, weights[pick] * scale)
        out[:, pick] = sums.gram[:-1, -1], np.diag(sums.gram)[:-1], sums.squares[:-1]
    return out[0], out[1], out[2]


# A reading with less than this share of itself in its residual cannot be judged.
_SEEN = 0.02
# Readings that the model leaves of a part below which its scatter cannot be judged.
_LEAST_LEFT = 0.5
_POSITIONS = ("x", "y", "z", "c")
_WORST = 10


@single_blas()
def compare(subject: Session | Chosen | Fit | Result | JointResult) -> Comparison | JointComparison:
    """Hold a model against its readings; that of several sessions of one machine against the readings of each.

    Args:
        subject: measurements, to which the model is fitted; or a fit or result: one session's share in a fit of several
            is held against that session's readings.

    Raises:
        ModelError: the data does not allow the model.
    """
    if isinstance(subject, Fit):
        return _Look(subject).comparison((), (), "")
    if isinstance(subject, Session | Chosen):
        chosen = Chosen.of(subject)
        fitted = fit_sessions(chosen)
        apart = [tuple(sorted(outlier.row for outlier in own.outliers)) for own in gross_errors(chosen)]
    else:
        fitted = fitted_sessions(subject)
        apart = [() for _ in fitted.model_names]
    triples = zip(fitted.joint.fits, apart, fitted.model_names, strict=True)
    each = tuple(_Look(fit).comparison(fitted.effects, rows, variant) for fit, rows, variant in triples)
    labels = fitted.joint.assembly.labels
    return each[0] if labels is None else JointComparison(fitted.joint, labels, each)


class _Look:
    """What all parts of a comparison need."""

    def __init__(self, fit: Fit) -> None:
        self.fit = fit
        self.observations = fit.model.observations
        self.readings = self.observations.readings
        self.n = len(self.readings)
        self.residual = fit.residuals
        self.normal = self.residual / fit.model.sigma
        self.free = 1.0 - leverage(fit)
        self.alone = len(fit.joint.assembly.models) == 1
        self.dof = fit.solution.degrees_of_freedom
        with np.errstate(divide="ignore", invalid="ignore"):
            self.studentized = np.where(self.free > _SEEN, self.normal / np.sqrt(self.free), np.nan)
        # Where the readings scatter more than declared, all that is calculated from them does too.
        self.factor = max(1.0, float(np.sqrt(fit.joint.reduced_chi_square)))
        self.covariates = covariates(self.observations)

    def comparison(self, effects: tuple[str, ...], outliers: tuple[int, ...], variant: str) -> Comparison:
        readings, fit = self.readings, self.fit
        ids = self.observations.session.setup_ids
        setups = {ids[s]: readings.setup == s for s in np.unique(readings.setup)}
        runs = {
            f"{ids[s]}, repeat {r}": (readings.setup == s) & (readings.repeat == r)
            for s, r in np.unique(np.stack([readings.setup, readings.repeat]), axis=1).T
        }
        regions = self._regions()
        # All at once: each pass over the readings costs as much as many sums.
        shares = self._shares([*setups.items(), *runs.items(), *(part for _, part in regions)], sums=True)
        first, last = len(setups), len(setups) + len(runs)
        order = np.argsort(-np.nan_to_num(np.abs(self.studentized)), kind="stable")
        return Comparison(
            fit=fit,
            effects=effects,
            variant=variant,
            overall=self._overall() if self.alone else self._share_of_all(),
            setups=_worst_first(shares[:first]),
            runs=_worst_first(shares[first:last]),
            labels={name: self._labels(values) for name, values in readings.labels.items()},
            regions=tuple(
                Region(axis, float(self.covariates[axis][mask].min()), float(self.covariates[axis][mask].max()), share)
                for (axis, (_, mask)), share in zip(regions, shares[last:], strict=True)
            ),
            approaches=self._approaches(),
            trends=self._trends(),
            ranked=tuple(rank_covariates(self.covariates, np.nan_to_num(self.studentized))),
            outliers=outliers,
            worst=tuple(int(k) for k in order[: min(_WORST, self.n)]),
            residual=self.residual,
            studentized=self.studentized,
            covariates=self.covariates,
        )

    def _overall(self) -> Overall:
        fit = self.fit
        noise = noise_of(fit)
        return Overall(self.n, rms(self.residual), fit.joint.reduced_chi_square, self.dof, fit.joint.p_value, noise)

    def _share_of_all(self) -> Overall:
        """One of several sessions: its sum of squares over what is left of its own readings by the common model."""
        left = float(self.free.sum())
        squares = float(np.sum(self.normal**2))
        p = float(special.chdtrc(left, squares)) if left > _LEAST_LEFT else 1.0
        place = same_place(self.observations)
        count = np.bincount(place)
        mean = np.bincount(place, weights=self.normal) / count
        repeats = int((count - 1).sum())
        declared = self.observations.session.sigma
        scatter = None
        if repeats >= FEWEST_REPEATS:
            scatter = declared * float(np.sqrt(np.sum((self.normal - mean[place]) ** 2) / repeats))
        noise = Noise(declared, scatter, repeats, p, None)
        return Overall(self.n, rms(self.residual), squares / left if left > _LEAST_LEFT else 1.0, round(left), p, noise)

    def _shares(self, parts: Sequence[tuple[str, BoolArray]], *, sums: bool) -> list[Share]:
        means = slopes = None
        time = self.readings.columns.get("time")
        if sums:
            weights = [mask / max(int(mask.sum()), 1) for _, mask in parts]
            if time is not None and np.isfinite(time).all():
                weights += [_slope_weights(time, mask) for _, mask in parts]
            found = self._sums(weights)
            means, slopes = found[: len(parts)], found[len(parts) :]
        total = float(np.sum(self.normal**2))
        out = []
        for k, (name, mask) in enumerate(parts):
            squares, left = float(np.sum(self.normal[mask] ** 2)), float(np.sum(self.free[mask]))
            where = np.flatnonzero(mask)
            worst = where[int(np.argmax(np.nan_to_num(np.abs(self.studentized[where]))))]
            out.append(
                Share(
                    name,
                    len(where),
                    rms(self.residual[mask]),
                    squares / left if left > _LEAST_LEFT else None,
                    squares / total if total > 0 else 0.0,
                    *(means[k] if means else (None, None)),
                    *(slopes[k] if slopes else (None, None)),
                    worst_row=int(self.readings.row[worst]),
                )
            )
        return out

    def _sums(self, weights: Sequence[Array]) -> list[tuple[float | None, float | None]]:
        """Value and standard uncertainty of each sum of residuals."""
        sums = residual_sums(self.fit, np.array(weights, dtype=float).reshape(-1, self.n))
        return [(_number(v), _number(self.factor * u)) for v, u in zip(sums.value, sums.uncertainty, strict=True)]

    def _labels(self, values: np.ndarray) -> tuple[Share, ...]:
        names, number = np.unique(values.astype(str), return_inverse=True)
        if len(names) * self.n > 20_000_000:
            return ()
        return _worst_first(self._shares([(str(n), number == k) for k, n in enumerate(names)], sums=False))

    def _regions(self) -> list[tuple[str, tuple[str, BoolArray]]]:
        """Parts of the readings, each after the axis that stands between two values in it."""
        out = []
        for axis in _POSITIONS:
            values = self.covariates.get(axis)
            if values is None or not np.isfinite(values).all():
                continue
            number = bins(values, 10)
            out += [(axis, (f"{axis} {k}", number == k)) for k in np.unique(number)]
        return out

    def _approaches(self) -> tuple[Approach, ...]:
        found = []
        for axis in _POSITIONS:
            sign = np.sign(self.readings.columns.get(f"dir_{axis}", np.zeros(self.n)))
            forward, backward = int((sign > 0).sum()), int((sign < 0).sum())
            if not forward or not backward:
                continue
            weights = np.where(sign > 0, 1.0 / forward, np.where(sign < 0, -1.0 / backward, 0.0))
            found.append((axis, forward, backward, weights, sign * sensed(self.observations, axis) / 2))
        if not found:
            return ()
        sums = residual_sums(self.fit, np.array([w for *_, mean, along in found for w in (mean, along)]))
        value, u, added, added_u = (
            [_number(x) for x in values]
            for values in (sums.value, self.factor * sums.uncertainty, sums.added, self.factor * sums.added_uncertainty)
        )
        out = []
        for k, (axis, forward, backward, _, along) in enumerate(found):
            moved, moved_u = None, None
            if np.abs(along).max() > 5e-7:
                moved, moved_u = added[2 * k + 1], added_u[2 * k + 1]
            p = self._p(moved, moved_u) if moved is not None else self._p(value[2 * k], u[2 * k])
            out.append(Approach(axis, forward, backward, value[2 * k], u[2 * k], moved, moved_u, p))
        return tuple(out)

    def _trends(self) -> tuple[Trend, ...]:
        chosen = {
            name: values
            for name, values in self.covariates.items()
            if np.isfinite(values).all() and not name.startswith("dir_") and name not in ("order", "repeat")
        }
        if not chosen:
            return ()
        centred = np.array([values - values.mean() for values in chosen.values()])
        squares = np.einsum("kn,kn->k", centred, centred)
        sums = residual_sums(self.fit, centred)
        out = []
        for k, (name, values) in enumerate(chosen.items()):
            slope, u = _number(sums.value[k] / squares[k]), _number(self.factor * sums.uncertainty[k] / squares[k])
            added, added_u = _number(sums.added[k]), _number(self.factor * sums.added_uncertainty[k])
            out.append(Trend(name, float(np.ptp(values)), slope, u, added, added_u, self._p(slope, u)))
        return tuple(sorted(out, key=lambda t: 2.0 if t.p_value is None else t.p_value))

    def _p(self, value: float | None, uncertainty: float | None) -> float | None:
        """Chance of a value so far from zero; Student's where the scatter was taken from the residuals."""
        if value is None or not uncertainty:
            return None
        ratio = abs(value) / uncertainty
        return float(2 * (special.stdtr(self.dof, -ratio) if self.factor > 1.0 else special.ndtr(-ratio)))


def _slope_weights(values: Array, mask: BoolArray) -> Array:
    """(n,) weights whose sum with the residuals is their slope over the values, among some of the readings."""
    out = np.zeros(len(values))
    centred = values[mask] - values[mask].mean()
    squares = float(centred @ centred)
    if squares > 0:
        out[mask] = centred / squares
    return out


def _worst_first(shares: Sequence[Share]) -> tuple[Share, ...]:
    return tuple(sorted(shares, key=lambda s: -(s.reduced_chi_square or 0.0)))


def _number(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None
