# SPDX-License-Identifier: Apache-2.0
"""How well a model fits its readings, and where it fails.

This describes and draws; whether something is missing, and what, is for `diagnose` to say.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import special

from machine_tool_calibration.arrays import Array, BoolArray, rms
from machine_tool_calibration.errors import ModelError, did_you_mean
from machine_tool_calibration.estimation.reduction import single_blas
from machine_tool_calibration.methods.fitted import FitRequest, fit_sessions, gross_errors
from machine_tool_calibration.methods.identify import JointResult, fitted_sessions
from machine_tool_calibration.model.fit import Fit, JointFit
from machine_tool_calibration.model.result import Result
from machine_tool_calibration.residuals.covariates import bins, covariates, rank_covariates, sensed
from machine_tool_calibration.residuals.leverage import leverage
from machine_tool_calibration.residuals.noise import FEWEST_REPEATS, Noise, noise_of
from machine_tool_calibration.residuals.sums import residual_sums
from machine_tool_calibration.session.provenance import Provenance, provenance
from machine_tool_calibration.session.session import Session

__all__ = ["Approach", "Comparison", "JointComparison", "Overall", "Region", "Share", "Trend", "compare"]

# A reading with less than this share of itself in its residual cannot be judged.
_SEEN = 0.02
# Readings that the model leaves of a part below which its scatter cannot be judged.
_LEAST_LEFT = 0.5
# Half the change of a reading per displacement of an axis, m/m (C: m/rad), from which the axis counts as sensed.
_SENSED = 5e-7
# Products of readings and values of a label beyond which these are not told apart.
_MOST_COMPARED = 2e7
_POSITIONS = ("x", "y", "z", "c")
_WORST = 10

_Uncertain = tuple[float | None, float | None]
"""A value and its standard uncertainty; None where the model takes it up."""


@dataclass(frozen=True)
class Overall:
    """The whole fit.

    Attributes:
        readings: number of readings.
        rms: root mean square of measured minus predicted, m.
        reduced_chi_square: weighted sum of squares over the degrees of freedom.
        degrees_of_freedom: readings minus unknowns.
        p_value: chance of so large a sum of squares if the model is right and the declared uncertainty too.
        noise: declared, and from repeats.
    """

    readings: int
    rms: float
    reduced_chi_square: float
    degrees_of_freedom: int
    p_value: float
    noise: Noise

    @property
    def ratio(self) -> float:
        """How many times the declared uncertainty the readings scatter about the model."""
        return float(np.sqrt(self.reduced_chi_square))


@dataclass(frozen=True)
class Share:
    """A part of the readings: a setup, one repeat of it, a target.

    Attributes:
        name: of the part.
        readings: how many.
        rms: of their residuals, m.
        reduced_chi_square: sum of squares over what is left of these readings by the model; None where nothing is.
        share: of the whole sum of squares.
        mean: of the residuals, m, with its standard uncertainty; None where the model takes it up.
        slope: of the residuals over time, m/s, likewise.
        worst_row: the reading with the largest studentized residual.
    """

    name: str
    readings: int
    rms: float
    reduced_chi_square: float | None
    share: float
    mean: float | None = None
    mean_u: float | None = None
    slope: float | None = None
    slope_u: float | None = None
    worst_row: int | None = None

    @property
    def ratio(self) -> float | None:
        """Scatter of these residuals over the declared uncertainty."""
        return None if self.reduced_chi_square is None else self.reduced_chi_square**0.5


@dataclass(frozen=True)
class Region:
    """Readings whose axis stands between two values, m or rad."""

    axis: str
    low: float
    high: float
    fit: Share


@dataclass(frozen=True)
class Approach:
    """Difference between the two directions of approach of an axis.

    Attributes:
        axis: x, y, z or c.
        forward: readings after a move in positive direction.
        backward: the others.
        difference: mean residual after positive moves minus that after negative ones, m; None if the model takes it up.
        displacement: that difference as a displacement of the axis, if it were added to the model, m (C: rad): minus
            twice the half width b of a backlash; None where the model takes it up.
        p_value: chance of so large a displacement (or difference, without it) by chance.
    """

    axis: str
    forward: int
    backward: int
    difference: float | None
    difference_u: float | None
    displacement: float | None
    displacement_u: float | None
    p_value: float | None


@dataclass(frozen=True)
class Trend:
    """How the residuals change with a covariate.

    Attributes:
        covariate: its name.
        span: range that it covers, in its unit.
        slope: of the residuals, m per unit, with its standard uncertainty; None if the model takes it up.
        added: slope that the model would find if it were added, m per unit; the residuals' own is smaller, as the
            model's other unknowns took their part.
        p_value: chance of so large a slope by chance.
    """

    covariate: str
    span: float
    slope: float | None
    slope_u: float | None
    added: float | None
    added_u: float | None
    p_value: float | None


@dataclass(frozen=True)
class Comparison:
    """A model against its readings.

    Uncertainties are those of the declared noise, or of the scatter about the model where that is larger; they allow
    for what the model took up.

    Attributes:
        fit: the fitted model.
        effects: ids of effects that are in it.
        overall: the whole fit.
        setups: worst first.
        runs: each repeat of each setup, worst first.
        labels: by text column (target, point), its values, worst first.
        regions: bins of each axis position.
        approaches: for each axis that was approached from both sides.
        trends: over time, temperatures and every other covariate, most significant first.
        ranked: covariates, in the order in which their running mean follows the residuals, with the share it takes.
        outliers: rows of the readings that do not belong to the rest, which an identification sets aside; none where
            a fit was given, which holds those that it was made of.
        worst: indices of the readings with the largest studentized residuals.
        residual: (n,) measured minus predicted, m.
        studentized: (n,) residuals over their own standard uncertainty, as declared; NaN where the model has a
            reading for itself.
        covariates: (n,) each, SI.
        variant: of the method's model; empty where it is not known.
    """

    fit: Fit
    effects: tuple[str, ...]
    overall: Overall
    setups: tuple[Share, ...]
    runs: tuple[Share, ...]
    labels: Mapping[str, tuple[Share, ...]]
    regions: tuple[Region, ...]
    approaches: tuple[Approach, ...]
    trends: tuple[Trend, ...]
    ranked: tuple[tuple[str, float], ...]
    outliers: tuple[int, ...]
    worst: tuple[int, ...]
    residual: Array
    studentized: Array
    covariates: Mapping[str, Array]
    variant: str = ""

    @property
    def provenance(self) -> Provenance:
        """What it was made from."""
        return provenance([self.fit.model.observations.session], model=self.variant, effects=self.effects)

    def covariate(self, name: str) -> Array:
        """(n,) the covariate of that name.

        Raises:
            ModelError: there is none, or it does not vary.
        """
        if name not in self.covariates:
            hint = did_you_mean(name, self.covariates) or f"; there are {', '.join(self.covariates)}"
            raise ModelError(f"there is no covariate {name!r} that varies{hint}")
        return self.covariates[name]


@dataclass(frozen=True)
class JointComparison:
    """The model of several sessions of one machine against the readings of each.

    Attributes:
        joint: the fit.
        labels: names of the sessions.
        sessions: for each its readings against the common model; its own reduced chi-square is its sum of squares over
            what is left of its readings, and its shares are of its own sum of squares.
    """

    joint: JointFit
    labels: tuple[str, ...]
    sessions: tuple[Comparison, ...]

    @property
    def effects(self) -> tuple[str, ...]:
        """Ids of effects in the model."""
        return self.sessions[0].effects

    @property
    def provenance(self) -> Provenance:
        """What it was made from."""
        model = ", ".join(dict.fromkeys(one.variant for one in self.sessions))
        return provenance(self.measured_sessions, self.labels, model=model, effects=self.effects)

    @property
    def measured_sessions(self) -> list[Session]:
        """What was measured, in the order of the labels."""
        return [one.fit.model.observations.session for one in self.sessions]

    @property
    def readings(self) -> int:
        """Readings of all sessions."""
        return sum(one.overall.readings for one in self.sessions)

    @property
    def rms(self) -> float:
        """Root mean square of measured minus predicted over all readings, m."""
        return rms(np.concatenate([one.residual for one in self.sessions]))

    @property
    def parts(self) -> tuple[tuple[str, Share], ...]:
        """Sessions as shares of all readings, each with its label as name too, worst first."""
        every = ((label, one.overall, weight) for label, one, weight in self._weighted)
        own = [(label, Share(label, o.readings, o.rms, o.reduced_chi_square, weight)) for label, o, weight in every]
        return tuple(sorted(own, key=lambda entry: _misfit(entry[1])))

    @property
    def setups(self) -> tuple[tuple[str, Share], ...]:
        """Setups of all sessions with the session's label, worst first; shares of the sum of squares of all."""
        every = ((label, share, weight) for label, one, weight in self._weighted for share in one.setups)
        own = [(label, replace(share, share=weight * share.share)) for label, share, weight in every]
        return tuple(sorted(own, key=lambda entry: _misfit(entry[1])))

    @property
    def worst(self) -> tuple[tuple[str, Comparison, int], ...]:
        """Readings with the largest studentized residuals: label, the session's comparison and index in it."""
        own = [(label, one, k) for label, one, _ in self._weighted for k in one.worst]
        own.sort(key=lambda entry: -abs(float(np.nan_to_num(entry[1].studentized[entry[2]]))))
        return tuple(own[: len(self.sessions[0].worst)])

    @property
    def _weighted(self) -> list[tuple[str, Comparison, float]]:
        """Labels, comparisons, and their shares of the sum of squares of all."""
        squares = np.array([np.sum((one.residual / one.fit.model.sigma) ** 2) for one in self.sessions])
        weights = squares / (squares.sum() or 1.0)
        return list(zip(self.labels, self.sessions, weights.tolist(), strict=True))


@single_blas()
def compare(subject: Session | FitRequest | Fit | Result | JointResult) -> Comparison | JointComparison:
    """Hold a model against its readings; that of several sessions of one machine against the readings of each.

    Args:
        subject: measurements, to which the model is fitted; or a fit or result: one session's share in a fit of several
            is held against that session's readings.

    Raises:
        ModelError: the data does not allow the model.
    """
    if isinstance(subject, Fit):
        return _Residuals(subject).comparison((), (), "")
    if isinstance(subject, Session | FitRequest):
        chosen = FitRequest.of(subject)
        fitted = fit_sessions(chosen)
        aside = [tuple(sorted(outlier.row for outlier in own.outliers)) for own in gross_errors(chosen)]
    else:
        fitted = fitted_sessions(subject)
        aside = [() for _ in fitted.model_names]
    triples = zip(fitted.joint.fits, aside, fitted.model_names, strict=True)
    each = tuple(_Residuals(fit).comparison(fitted.effects, rows, variant) for fit, rows, variant in triples)
    labels = fitted.joint.assembly.labels
    return each[0] if labels is None else JointComparison(fitted.joint, labels, each)


class _Residuals:
    """Those of a session's readings, and what all parts of a comparison need of them."""

    def __init__(self, fit: Fit) -> None:
        self.fit = fit
        self.observations = fit.model.observations
        self.readings = self.observations.readings
        self.n = len(self.readings)
        self.residual = fit.residuals
        self.normal = self.residual / fit.model.sigma
        self.free = 1.0 - leverage(fit)
        with np.errstate(divide="ignore", invalid="ignore"):
            self.studentized = np.where(self.free > _SEEN, self.normal / np.sqrt(self.free), np.nan)
        # Where the readings scatter more than declared, all that is calculated from them does too.
        self.factor = max(1.0, float(np.sqrt(fit.joint.reduced_chi_square)))
        self.covariates = covariates(self.observations)

    def comparison(self, effects: tuple[str, ...], outliers: tuple[int, ...], variant: str) -> Comparison:
        readings, ids = self.readings, self.observations.session.setup_ids
        setups = [(ids[s], readings.setup == s) for s in np.unique(readings.setup)]
        runs = [
            (f"{ids[s]}, repeat {r}", (readings.setup == s) & (readings.repeat == r))
            for s, r in np.unique(np.stack([readings.setup, readings.repeat]), axis=1).T
        ]
        regions = self._regions()
        # All at once: each pass over the readings costs as much as many sums.
        shares = self._shares([*setups, *runs, *((f"{axis} {k}", mask) for axis, k, mask in regions)], sums=True)
        first, last = len(setups), len(setups) + len(runs)
        order = np.argsort(-np.nan_to_num(np.abs(self.studentized)), kind="stable")
        return Comparison(
            fit=self.fit,
            effects=effects,
            variant=variant,
            overall=self._overall(),
            setups=_worst_first(shares[:first]),
            runs=_worst_first(shares[first:last]),
            labels={name: self._labels(values) for name, values in readings.labels.items()},
            regions=tuple(
                Region(axis, float(self.covariates[axis][mask].min()), float(self.covariates[axis][mask].max()), share)
                for (axis, _, mask), share in zip(regions, shares[last:], strict=True)
            ),
            approaches=self._approaches(),
            trends=self._trends(),
            ranked=tuple(rank_covariates(self.covariates, np.nan_to_num(self.studentized))),
            outliers=outliers,
            worst=tuple(order[:_WORST].tolist()),
            residual=self.residual,
            studentized=self.studentized,
            covariates=self.covariates,
        )

    def _overall(self) -> Overall:
        """Of one of several sessions: its sum of squares over what is left of its own readings by the common model."""
        joint, size = self.fit.joint, rms(self.residual)
        if len(joint.assembly.models) == 1:
            dof = joint.solution.degrees_of_freedom
            return Overall(self.n, size, joint.reduced_chi_square, dof, joint.p_value, noise_of(self.fit))
        left, squares = float(self.free.sum()), float(np.sum(self.normal**2))
        seen = left > _LEAST_LEFT
        p = float(special.chdtrc(left, squares)) if seen else 1.0
        place = self.observations.place
        count = np.bincount(place)
        repeats = int((count - 1).sum())
        declared, scatter = self.observations.session.sigma, None
        if repeats >= FEWEST_REPEATS:
            within = self.normal - (np.bincount(place, weights=self.normal) / count)[place]
            scatter = declared * float(np.sqrt(np.sum(within**2) / repeats))
        noise = Noise(declared, scatter, repeats, p, None)
        return Overall(self.n, size, squares / left if seen else 1.0, round(left), p, noise)

    def _shares(self, parts: Sequence[tuple[str, BoolArray]], *, sums: bool) -> list[Share]:
        """Of parts of the readings, with or without the mean and the slope over time of each."""
        found: list[_Uncertain] = []
        time = self.readings.columns.get("time")
        if sums:
            weights = [mask / max(int(mask.sum()), 1) for _, mask in parts]
            if time is not None and np.isfinite(time).all():
                weights += [_slope_weights(time, mask) for _, mask in parts]
            result = residual_sums(self.fit, np.array(weights).reshape(-1, self.n))
            found = self._uncertain(result.value, result.uncertainty)
        found += [(None, None)] * (2 * len(parts) - len(found))
        total = float(np.sum(self.normal**2))
        out = []
        for (name, mask), mean, slope in zip(parts, found[: len(parts)], found[len(parts) :], strict=True):
            squares, left = float(np.sum(self.normal[mask] ** 2)), float(np.sum(self.free[mask]))
            reduced = squares / left if left > _LEAST_LEFT else None
            share = squares / total if total > 0 else 0.0
            where = np.flatnonzero(mask)
            worst = int(self.readings.row[where[np.argmax(np.nan_to_num(np.abs(self.studentized[where])))]])
            out.append(Share(name, len(where), rms(self.residual[mask]), reduced, share, *mean, *slope, worst))
        return out

    def _labels(self, values: np.ndarray) -> tuple[Share, ...]:
        names, number = np.unique(values.astype(str), return_inverse=True)
        if len(names) * self.n > _MOST_COMPARED:
            return ()
        return _worst_first(self._shares([(str(n), number == k) for k, n in enumerate(names)], sums=False))

    def _regions(self) -> list[tuple[str, int, BoolArray]]:
        """Readings with the axis between two values: the axis, the number of its region, and which they are."""
        out = []
        for axis in _POSITIONS:
            values = self.covariates.get(axis)
            if values is not None and np.isfinite(values).all():
                number = bins(values, 10)
                out += [(axis, int(k), number == k) for k in np.unique(number)]
        return out

    def _approaches(self) -> tuple[Approach, ...]:
        found, weights = [], []
        for axis in _POSITIONS:
            sign = np.sign(self.readings.columns.get(f"dir_{axis}", np.zeros(self.n)))
            forward, backward = int((sign > 0).sum()), int((sign < 0).sum())
            if forward and backward:
                along = sign * sensed(self.observations, axis) / 2
                found.append((axis, forward, backward, bool(np.abs(along).max() > _SENSED)))
                weights += [np.where(sign > 0, 1.0 / forward, np.where(sign < 0, -1.0 / backward, 0.0)), along]
        if not found:
            return ()
        sums = residual_sums(self.fit, np.array(weights))
        differences = self._uncertain(sums.value, sums.uncertainty)[::2]
        displacements = self._uncertain(sums.added, sums.added_uncertainty)[1::2]
        out = []
        for (axis, forward, backward, seen), difference, added in zip(found, differences, displacements, strict=True):
            displacement = added if seen else (None, None)
            p = self._p(*(difference if displacement[0] is None else displacement))
            out.append(Approach(axis, forward, backward, *difference, *displacement, p))
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
        slopes = self._uncertain(sums.value / squares, sums.uncertainty / squares)
        added = self._uncertain(sums.added, sums.added_uncertainty)
        out = [
            Trend(name, float(np.ptp(values)), *slope, *more, self._p(*slope))
            for (name, values), slope, more in zip(chosen.items(), slopes, added, strict=True)
        ]
        return tuple(sorted(out, key=lambda t: 2.0 if t.p_value is None else t.p_value))

    def _uncertain(self, values: Array, uncertainties: Array) -> list[_Uncertain]:
        """Values with their standard uncertainties, by the scatter about the model; None for what it takes up."""
        pairs = zip(values.tolist(), (self.factor * uncertainties).tolist(), strict=True)
        return [(v if np.isfinite(v) else None, u if np.isfinite(u) else None) for v, u in pairs]

    def _p(self, value: float | None, uncertainty: float | None) -> float | None:
        """Chance of a value so far from zero; Student's where the scatter was taken from the residuals."""
        if value is None or not uncertainty:
            return None
        ratio, freedom = abs(value) / uncertainty, self.fit.solution.degrees_of_freedom
        return float(2 * (special.stdtr(freedom, -ratio) if self.factor > 1.0 else special.ndtr(-ratio)))


def _slope_weights(values: Array, mask: BoolArray) -> Array:
    """(n,) weights whose sum with the residuals is their slope over the values, among some of the readings."""
    centred = np.where(mask, values - values[mask].mean(), 0.0)
    return np.asarray(centred / (float(centred @ centred) or 1.0))


def _worst_first(shares: Sequence[Share]) -> tuple[Share, ...]:
    return tuple(sorted(shares, key=_misfit))


def _misfit(share: Share) -> float:
    return -(share.reduced_chi_square or 0.0)
