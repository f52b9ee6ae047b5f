# SPDX-License-Identifier: Apache-2.0
"""Records of a comparison: how well a model fits its readings, and where it fails."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from machine_tool_calibration.arrays import Array, rms
from machine_tool_calibration.errors import ModelError, did_you_mean
from machine_tool_calibration.model.fit import Fit, JointFit
from machine_tool_calibration.residuals.noise import Noise
from machine_tool_calibration.session.provenance import Provenance, provenance
from machine_tool_calibration.session.session import Session

__all__ = ["Approach", "Comparison", "JointComparison", "Overall", "Region", "Share", "Trend"]


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

    @property
    def measured(self) -> Array:
        """(n,) the readings, m."""
        return self.fit.model.observations.readings.displacement

    @property
    def predicted(self) -> Array:
        """(n,) what the model expects, m."""
        return self.measured - self.residual

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
        own = [
            (label, Share(label, o.readings, o.rms, o.reduced_chi_square, share))
            for label, o, share in zip(self.labels, (one.overall for one in self.sessions), self._weights, strict=True)
        ]
        return tuple(sorted(own, key=_misfit))

    @property
    def setups(self) -> tuple[tuple[str, Share], ...]:
        """Setups of all sessions with the session's label, worst first; shares of the sum of squares of all."""
        own = [
            (label, replace(share, share=weight * share.share))
            for label, one, weight in zip(self.labels, self.sessions, self._weights, strict=True)
            for share in one.setups
        ]
        return tuple(sorted(own, key=_misfit))

    @property
    def worst(self) -> tuple[tuple[str, Comparison, int], ...]:
        """Readings with the largest studentized residuals: label, the session's comparison and index in it."""
        own = [(label, one, k) for label, one in zip(self.labels, self.sessions, strict=True) for k in one.worst]
        own.sort(key=lambda entry: -abs(float(np.nan_to_num(entry[1].studentized[entry[2]]))))
        return tuple(own[: len(self.sessions[0].worst)])

    @property
    def _weights(self) -> list[float]:
        squares = [float(np.sum((one.residual / one.fit.model.sigma) ** 2)) for one in self.sessions]
        total = sum(squares) or 1.0
        return [value / total for value in squares]


def _misfit(entry: tuple[str, Share]) -> float:
    return -(entry[1].reduced_chi_square or 0.0)
