# SPDX-License-Identifier: Apache-2.0
"""How well a model fits its readings, and where it fails: a table of the readings, and statistics of its groups.

This describes and draws; whether something is missing, and what, is for `diagnose` to say.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd
from scipy import special

from machine_tool_calibration.arrays import Array, rms
from machine_tool_calibration.errors import ModelError, did_you_mean
from machine_tool_calibration.estimation import priors
from machine_tool_calibration.estimation.reduction import single_blas
from machine_tool_calibration.methods.fitted import FitRequest, fit_sessions, gross_errors
from machine_tool_calibration.methods.identify import JointResult, fitted_sessions
from machine_tool_calibration.model.fit import Fit, JointFit
from machine_tool_calibration.model.result import Result
from machine_tool_calibration.residuals.covariates import LEAST_SENSITIVITY, bins, covariates, rank_covariates, sensed
from machine_tool_calibration.residuals.leverage import leverage
from machine_tool_calibration.residuals.noise import Noise, noise_of
from machine_tool_calibration.residuals.sums import Sums, residual_sums
from machine_tool_calibration.session.provenance import Provenance, provenance
from machine_tool_calibration.session.session import Session

if TYPE_CHECKING:
    from pandas.core.groupby import DataFrameGroupBy

# Readings that the model leaves of a part below which its scatter cannot be judged.
_LEAST_LEFT = 0.5
# Products of readings and values of a label beyond which these are not distinguished.
_MOST_COMPARED = 2e7
_POSITIONS = ("x", "y", "z", "a", "b", "c")
_WORST = 10
_PART = [
    "name", "readings", "rms", "reduced_chi_square", "share", "mean", "mean_u", "slope", "slope_u", "worst_row",
]  # fmt: skip


def one_below_the_other(labels: Sequence[str], frames: Sequence[pd.DataFrame]) -> pd.DataFrame:
    """Tables of several sessions as one, with the session's label in the first column; that of one as it is."""
    if len(frames) == 1:
        return frames[0]
    named = zip(labels, frames, strict=True)
    return pd.concat([frame.assign(session=label)[["session", *frame]] for label, frame in named], ignore_index=True)


@dataclass(frozen=True)
class Overall:
    """The whole fit."""

    readings: int  # number of readings
    rms_residual: float  # root mean square of measured minus predicted, m
    reduced_chi_square: float  # weighted sum of squares over the degrees of freedom
    degrees_of_freedom: int  # readings minus unknowns
    p_value: float  # probability of so large a sum of squares if the model is right and the declared uncertainty too

    @property
    def ratio(self) -> float:
        """How many times the declared uncertainty the readings scatter about the model."""
        return float(np.sqrt(self.reduced_chi_square))


@dataclass(frozen=True, eq=False)
class Comparison:
    """A model against the readings of a session.

    The columns of its tables are described where people ask for them, at the attributes of the public `Comparison`.
    Uncertainties are those of the declared noise, or of the scatter about the model where that is larger, of lines and
    approaches with these in it; they allow for what the model took up. NaN stands where the model takes a figure up.
    """

    fit: Fit  # the fitted model
    effects: tuple[str, ...]  # ids of effects that are in it
    variant: str  # of the method's model
    outliers: tuple[int, ...]  # rows of readings that do not belong to the rest
    overall: Overall  # the whole fit
    noise: Noise  # declared, and from repeats
    residuals: pd.DataFrame  # the readings, as `residual_table` gives them
    covariates: Mapping[str, Array]  # what varies from reading to reading, by name
    # covariates with the share of the residuals' variance that a running mean over them follows
    ranked: Sequence[tuple[str, float]]
    # worst first; reduced chi-squares are sums of squares over what the model leaves of these readings
    setups: pd.DataFrame
    runs: pd.DataFrame  # each repeat of each setup, likewise
    regions: pd.DataFrame  # bins of each axis position
    texts: Mapping[str, pd.DataFrame]  # by text column (target, point), its values as setups are
    # axes that were approached from both sides; without a displacement the p-value is of the difference
    approaches: pd.DataFrame
    # straight lines over covariates, the most significant first; the slope that the model would find is larger than
    # that of the residuals, as its other unknowns took their part
    trends: pd.DataFrame
    counted: bool = True  # whether the outliers are in all this; not where the model allows no fit with them

    labels = None
    """Of the sessions, of which this is the only one."""

    @property
    def sessions(self) -> tuple[Comparison, ...]:
        """Itself alone."""
        return (self,)

    @property
    def session(self) -> Session:
        """What was measured."""
        return self.fit.model.observations.session

    @property
    def parts(self) -> pd.DataFrame:
        """The setups."""
        return self.setups

    @property
    def worst(self) -> pd.DataFrame:
        """The readings with the largest studentized residuals."""
        return _largest(self.residuals)

    @cached_property
    def provenance(self) -> Provenance:
        """What it was made from."""
        return provenance([self.session], model=self.variant, effects=self.effects)

    def covariate(self, name: str) -> Array:
        """(n,) the covariate of that name. A ModelError: there is none, or it does not vary."""
        if name not in self.covariates:
            hint = did_you_mean(name, self.covariates) or f"; there are {', '.join(self.covariates)}"
            raise ModelError(f"there is no covariate {name!r} that varies{hint}")
        return self.covariates[name]


@dataclass(frozen=True, eq=False)
class JointComparison:
    """The model of several sessions of one machine against the readings of each."""

    joint: JointFit  # the fit
    labels: tuple[str, ...]  # names of the sessions
    # for each its readings against the common model; its own reduced chi-square is its sum of squares over what is left
    # of its readings, and its shares are of its own sum of squares
    sessions: tuple[Comparison, ...]

    @property
    def effects(self) -> tuple[str, ...]:
        """Ids of effects in the model."""
        return self.sessions[0].effects

    @cached_property
    def provenance(self) -> Provenance:
        """What it was made from."""
        model = ", ".join(dict.fromkeys(one.variant for one in self.sessions))
        return provenance([one.session for one in self.sessions], self.labels, model=model, effects=self.effects)

    @property
    def outliers(self) -> tuple[int, ...]:
        """Rows of the readings that do not belong to the rest, session after session."""
        return tuple(row for one in self.sessions for row in one.outliers)

    @property
    def overall(self) -> Overall:
        """The whole fit."""
        return _overall(self.joint, np.concatenate([one.fit.residuals for one in self.sessions]))

    @property
    def residuals(self) -> pd.DataFrame:
        """The readings of all sessions; NaN for what one of them did not record."""
        return one_below_the_other(self.labels, [one.residuals for one in self.sessions])

    @property
    def parts(self) -> pd.DataFrame:
        """Sessions as parts of all readings, worst first."""
        every = pd.DataFrame([vars(one.overall) for one in self.sessions])
        every = every.rename(columns={"rms_residual": "rms"}).assign(name=self.labels, share=self._weights)
        return _worst_first(every.reindex(columns=_PART))

    @property
    def setups(self) -> pd.DataFrame:
        """Setups of all sessions, worst first; shares of the sum of squares of all."""
        pairs = zip(self.sessions, self._weights.tolist(), strict=True)
        own = [one.setups.assign(share=weight * one.setups["share"]) for one, weight in pairs]
        return _worst_first(one_below_the_other(self.labels, own))

    @property
    def worst(self) -> pd.DataFrame:
        """Readings with the largest studentized residuals."""
        return _largest(one_below_the_other(self.labels, [one.worst for one in self.sessions]))

    @property
    def _weights(self) -> Array:
        """Shares of the sessions in the sum of squares of all."""
        squares = np.array([np.sum((one.fit.residuals / one.fit.model.sigma) ** 2) for one in self.sessions])
        return np.asarray(squares / (squares.sum() or 1.0))


@single_blas()
def compare(subject: Session | FitRequest | Fit | Result | JointResult) -> Comparison | JointComparison:
    """Hold a model against its readings; that of several sessions of one machine against the readings of each.

    To measurements the model is fitted; one session's share in a fit of several is held against that session's
    readings. Gross errors are among them, unless they allow no fit. A ModelError: the data does not allow the model.
    """
    if isinstance(subject, Fit):
        return _compared(subject, (), (), "")
    counted = True
    if isinstance(subject, Session | FitRequest):
        chosen = FitRequest.of(subject)
        found = gross_errors(chosen)
        aside = [own.rows for own in found]
        try:
            fitted = fit_sessions(chosen)
        except ModelError:
            if not any(aside):
                raise
            fitted, counted = fit_sessions(replace(chosen, sessions=tuple(own.session for own in found))), False
    else:
        fitted = fitted_sessions(subject)
        aside = [() for _ in fitted.model_names]
    triples = zip(fitted.joint.fits, aside, fitted.model_names, strict=True)
    each = tuple(_compared(fit, fitted.effects, rows, variant, counted) for fit, rows, variant in triples)
    labels = fitted.joint.assembly.labels
    return each[0] if labels is None else JointComparison(fitted.joint, labels, each)


def residual_table(fit: Fit) -> pd.DataFrame:
    """Every reading with what was predicted, one a row, in the order of the recording; SI.

    Columns: `row` of the recording (from 0), `setup`, `repeat`, the text columns; `position_x` … `direction_z` of what
    is sensed; `measured`, `predicted`, `residual` (measured minus predicted), `u_declared` (standard uncertainty), m;
    `leverage`, the share of a change of the reading that the prediction follows; `studentized`, the residual over its
    own standard uncertainty, NaN where the model has a reading for itself; all that was recorded, and the covariates.
    """
    observations = fit.model.observations
    readings, own, sigma = observations.readings, leverage(fit), fit.model.sigma
    ids = pd.Index(observations.session.setup_ids)
    with np.errstate(divide="ignore", invalid="ignore"):
        studentized = np.where(1.0 - own > priors.JUDGED, fit.residuals / sigma / np.sqrt(1.0 - own), np.nan)
    out: dict[str, Any] = {
        "row": readings.row,
        "setup": pd.Categorical.from_codes(readings.setup, ids).remove_unused_categories(),
        "repeat": readings.repeat,
        **readings.labels,
        **{f"position_{axis}": observations.position[:, j] for j, axis in enumerate("xyz")},
        **{f"direction_{axis}": observations.direction[:, j] for j, axis in enumerate("xyz")},
        "measured": readings.displacement,
        "predicted": fit.predicted,
        "residual": fit.residuals,
        "u_declared": fit.model.declared_sigma,
        "leverage": own,
        "studentized": studentized,
    }
    known = {**readings.columns, **covariates(observations)}
    return pd.DataFrame(out | {n.replace(" ", "_"): v for n, v in known.items() if n not in (*out, "order")})


def _compared(
    fit: Fit, effects: tuple[str, ...], outliers: tuple[int, ...], variant: str, counted: bool = True
) -> Comparison:
    readings, along, table = fit.model.observations.readings, covariates(fit.model.observations), residual_table(fit)
    normal = table["residual"] / table["u_declared"]
    each = table[["row", "setup", "repeat"]].assign(
        normal=normal,
        square=normal**2,
        residual_square=table["residual"] ** 2,
        free=1.0 - table["leverage"],
        size=table["studentized"].abs().fillna(0.0),
    )
    overall, noise = _whole(fit, each)
    parts = _parts(fit, each, along)
    by = parts["by"]
    return Comparison(
        fit=fit,
        effects=effects,
        variant=variant,
        outliers=outliers,
        overall=overall,
        noise=noise,
        residuals=table,
        covariates=along,
        ranked=rank_covariates(along, np.nan_to_num(table["studentized"].to_numpy())),
        setups=_worst_first(parts[by == "setup"][_PART]),
        runs=_worst_first(parts[by == "run"][_PART]),
        regions=parts[by.isin(_POSITIONS)].rename(columns={"by": "axis"}).reset_index(drop=True),
        texts={name: _of_text(each, values) for name, values in readings.labels.items()},
        approaches=_approaches(fit),
        trends=_trends(fit, along),
        counted=counted,
    )


def _overall(joint: JointFit, residuals: Array) -> Overall:
    dof = joint.solution.degrees_of_freedom
    return Overall(len(residuals), rms(residuals), joint.reduced_chi_square, dof, joint.p_value)


def _whole(fit: Fit, each: pd.DataFrame) -> tuple[Overall, Noise]:
    """Of one of several sessions: its sum of squares over what is left of its own readings by the common model."""
    noise = noise_of(fit)
    if len(fit.joint.assembly.models) == 1:
        return _overall(fit.joint, fit.residuals), noise
    left, squares = float(each["free"].sum()), float(each["square"].sum())
    reduced = squares / left if left > _LEAST_LEFT else 1.0
    return Overall(len(each), rms(fit.residuals), reduced, round(left), noise.chi_square_p), noise


def _parts(fit: Fit, each: pd.DataFrame, along: Mapping[str, Array]) -> pd.DataFrame:
    """Setups, their repeats and the regions of the axes, with `by`, `low` and `high`."""
    where = {axis: along[axis] for axis in _POSITIONS if axis in along and np.isfinite(along[axis]).all()}
    keys: dict[str, Any] = {"setup": "setup", "run": ["setup", "repeat"]}
    keys |= {axis: bins(values, 10) for axis, values in where.items()}
    groups = {by: each.assign(at=where.get(by, np.nan)).groupby(key, observed=True) for by, key in keys.items()}
    tables = {by: _shares(each, own).assign(low=own["at"].min(), high=own["at"].max()) for by, own in groups.items()}
    for by, table in tables.items():
        table["name"] = table.index if by == "setup" else [f"{by} {k}" for k in table.index]
    tables["run"]["name"] = [f"{setup}, repeat {repeat}" for setup, repeat in tables["run"].index]
    parts = pd.concat([table.assign(by=by) for by, table in tables.items()], ignore_index=True)
    # All at once: each pass over the readings costs as much as many sums.
    member = np.concatenate([own.ngroup().to_numpy() == np.arange(own.ngroups)[:, None] for own in groups.values()])
    weights = member / member.sum(axis=1, keepdims=True)
    time = fit.model.observations.readings.columns.get("time")
    if time is not None and np.isfinite(time).all():
        centred = member * (time - (weights @ time)[:, None])
        squares = np.einsum("kn,kn->k", centred, centred)
        weights = np.concatenate([weights, centred / np.where(squares > 0.0, squares, 1.0)[:, None]])
    sums = residual_sums(fit, weights)
    for k, name in enumerate(("mean", "slope")[: len(weights) // len(parts)]):
        own = slice(k * len(parts), (k + 1) * len(parts))
        parts[name], parts[f"{name}_u"] = sums.value[own], fit.joint.birge_ratio * sums.uncertainty[own]
    return parts.reindex(columns=["by", "low", "high", *_PART])


def _shares(each: pd.DataFrame, groups: DataFrameGroupBy[Any, Any]) -> pd.DataFrame:
    """Statistics of groups of the readings."""
    squares, left = groups["square"].sum(), groups["free"].sum()
    return pd.DataFrame(
        {
            "readings": groups.size(),
            "rms": groups["residual_square"].mean() ** 0.5,
            "reduced_chi_square": (squares / left).where(left > _LEAST_LEFT),
            "share": squares / (each["square"].sum() or 1.0),
            "worst_row": each["row"].to_numpy()[groups["size"].idxmax()],
        }
    )


def _of_text(each: pd.DataFrame, values: np.ndarray) -> pd.DataFrame:
    groups = each.groupby(values.astype(str))
    if groups.ngroups * len(each) > _MOST_COMPARED:
        return pd.DataFrame(columns=_PART)
    return _worst_first(_shares(each, groups).rename_axis("name").reset_index().reindex(columns=_PART))


def _approaches(fit: Fit) -> pd.DataFrame:
    readings, found, weights = fit.model.observations.readings, [], []
    for axis in _POSITIONS:
        sign = np.sign(readings.columns.get(f"dir_{axis}", np.zeros(len(readings))))
        forward, backward = int((sign > 0).sum()), int((sign < 0).sum())
        if forward and backward:
            along = sign * sensed(fit.model.observations, axis) / 2
            found.append((axis, forward, backward, bool(np.abs(along).max() > LEAST_SENSITIVITY / 2)))
            weights += [np.where(sign > 0, 1.0 / forward, np.where(sign < 0, -1.0 / backward, 0.0)), along]
    out = pd.DataFrame(found, columns=["axis", "forward", "backward", "seen"])
    sums, seen = residual_sums(fit, np.reshape(weights, (-1, len(readings)))), out.pop("seen").astype(bool)
    scatter, p_value = _beside(fit, sums)
    out["difference"], out["difference_u"] = sums.value[::2], (scatter * sums.uncertainty)[::2]
    for name, values in (("", sums.added), ("_u", scatter * sums.added_uncertainty)):
        out[f"displacement{name}"] = np.where(seen, values[1::2], np.nan)
    out["p_value"] = np.where(out["displacement"].isna(), p_value[::2], p_value[1::2])
    return out


def _trends(fit: Fit, along: Mapping[str, Array]) -> pd.DataFrame:
    chosen = {
        name: values
        for name, values in along.items()
        if np.isfinite(values).all() and not name.startswith("dir_") and name not in ("order", "repeat")
    }
    centred = np.reshape([values - values.mean() for values in chosen.values()], (-1, len(fit.residuals)))
    squares = np.einsum("kn,kn->k", centred, centred)
    sums = residual_sums(fit, centred)
    scatter, p_value = _beside(fit, sums)
    out = pd.DataFrame({"covariate": [*chosen], "span": [float(np.ptp(values)) for values in chosen.values()]})
    out["slope"], out["slope_u"] = sums.value / squares, scatter * sums.uncertainty / squares
    out["added"], out["added_u"] = sums.added, scatter * sums.added_uncertainty
    out["p_value"] = p_value
    return out.sort_values("p_value", kind="stable", ignore_index=True)


def _beside(fit: Fit, sums: Sums) -> tuple[Array, Array]:
    """Of each sum the scatter of the readings with its column in the model, and the probability of so large a sum.

    The scatter is over the declared one, and at least that. Where readings scatter more about the model the
    probability is that of a t-test: the column takes one degree of freedom.
    """
    ratio, left = sums.value / sums.uncertainty, fit.solution.degrees_of_freedom - 1
    if not left or fit.joint.birge_ratio == 1.0:
        return np.ones(len(ratio)), 2.0 * special.ndtr(-np.abs(ratio))
    own = np.sqrt(np.maximum(fit.solution.chi_square - ratio**2, np.finfo(float).tiny) / left)
    return np.maximum(own, 1.0), 2.0 * special.stdtr(left, -np.abs(ratio) / own)


def _worst_first(parts: pd.DataFrame) -> pd.DataFrame:
    return parts.sort_values("reduced_chi_square", ascending=False, kind="stable", ignore_index=True)


def _largest(readings: pd.DataFrame) -> pd.DataFrame:
    size = readings["studentized"].abs().fillna(0.0)
    return readings.loc[size.sort_values(ascending=False, kind="stable").index[:_WORST]]
