# SPDX-License-Identifier: Apache-2.0
"""The answer of an identification, for people and for programs (contract `mtcal-result/1`)."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Literal

import numpy as np

from machine_tool_calibration.arrays import Array, groups, means_of, rms, unsigned
from machine_tool_calibration.coverage import K
from machine_tool_calibration.estimation.solve import Solution
from machine_tool_calibration.json_types import plain
from machine_tool_calibration.model.fit import Fit, JointFit
from machine_tool_calibration.model.model import Kind, NotDetermined, Parameter
from machine_tool_calibration.model.observations import ACROSS
from machine_tool_calibration.model.widening import BESIDE
from machine_tool_calibration.session.catalogue import spec_of
from machine_tool_calibration.session.checks.places import misplaced
from machine_tool_calibration.session.checks.suspicion import suspicions
from machine_tool_calibration.session.provenance import Provenance, provenance
from machine_tool_calibration.session.session import Session
from machine_tool_calibration.words import Said, say


@dataclass(frozen=True)
class Estimate:
    """A parameter with its standard uncertainty (k = 1)."""

    name: str  # of the unknown
    value: float  # in the unit
    standard_uncertainty: float  # in the unit
    unit: str  # SI
    owner: str = ""  # of what it is (`Parameter.owner`)
    # of a value of an error motion's table, at which position of its axis, m or rad; None of others
    position: float | None = None

    @staticmethod
    def of(parameter: Parameter, value: float, standard_uncertainty: float) -> Estimate:
        """Of an unknown that is counted from its reference."""
        published = float(parameter.reference + value)
        u, at = float(standard_uncertainty), parameter.at
        in_table = parameter.kind is Kind.MOTION and not parameter.session
        position = at if in_table and not isinstance(at, str) else None
        return Estimate(parameter.name, published, u, parameter.unit, parameter.owner, position)

    def with_variance(self, added: Mapping[str, float]) -> Estimate:
        """With what a budget adds to the variance of unknowns, by name."""
        if self.name not in added:
            return self
        return replace(self, standard_uncertainty=float(np.sqrt(self.standard_uncertainty**2 + added[self.name])))

    def document(self) -> dict[str, Any]:
        """As an entry of a document."""
        return {
            "name": self.name,
            "value": self.value,
            "standard_uncertainty": self.standard_uncertainty,
            "unit": self.unit,
            **({} if self.position is None else {"error_motion": self.owner, "position": self.position}),
        }


def determined_values(fit: Fit | Solution) -> tuple[Array, Array]:
    """(m,) values of a model's unknowns and (m,) their standard uncertainties; NaN where they are not determined."""
    u = np.sqrt(np.diag(fit.covariance).clip(0.0))
    return np.where(fit.determined, fit.theta, np.nan), np.where(fit.determined, u, np.nan)


def effect_estimates(fit: JointFit, effects: Sequence[str]) -> tuple[Estimate, ...]:
    """Coefficients of effects in a fit that the data determines, as `identify` publishes them."""
    published = fit.published
    uncertainty = np.sqrt(np.maximum(np.diag(published.covariance), 0.0))
    found = zip(fit.assembly.parameters, published.theta, uncertainty, published.determined, strict=True)
    return tuple(
        Estimate.of(p, value, u) for p, value, u, good in found if good and p.kind is Kind.EFFECT and p.owner in effects
    )


def effect_signal(joint: JointFit, name: str) -> tuple[Array, Array]:
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


@dataclass(frozen=True)
class Rejected:
    """A reading that was kept out."""

    row: int  # its number in the recording, from 0
    reason: str  # in words
    deviation: float | None = None  # from what all others predict, m; None where there is none, as of a missing reading

    def document(self) -> dict[str, Any]:
        """As an entry of a document."""
        own = {} if self.deviation is None else {"deviation": self.deviation}
        return {"row": self.row, "reason": self.reason, **own}


@dataclass(frozen=True)
class ErrorMap:
    """The machine's errors with their standard uncertainties; NaN is a value that the data does not determine."""

    # what the contract names for the method: arrays, each `name` with its `name_u`; ids as lists of text
    content: Mapping[str, Any]
    points: Array  # (n, 3) where the position error is given, m
    error: Array  # (n, 3) position error, m; NaN in a direction that was not measured
    uncertainty: Array  # (n, 3)
    covariance: Array | None = None  # (n, 3, 3) of the position error, m^2, or None
    not_determined: tuple[NotDetermined, ...] = ()  # parts of the map that the data does not determine
    # unknowns that the map's datum moves, as found in it: value (without reference) and standard uncertainty by name.
    # The solver's datum is another one.
    in_datum: Mapping[str, tuple[float, float]] = field(default_factory=dict)

    @property
    def determined(self) -> int:
        """How many coordinates of the position errors the data determines."""
        return int(np.isfinite(self.uncertainty).sum())

    @property
    def largest_expanded(self) -> float:
        """Largest expanded uncertainty (k = 2) of one of them, m; infinite if there is none."""
        return K * float(np.nanmax(self.uncertainty)) if self.determined else float("inf")


def map_change(before: ErrorMap, after: ErrorMap) -> float | None:
    """RMS length of the change of the position errors that both maps determine, m.

    A map may hold a point several times, once for every state of an effect there (approached from either side); each is
    compared with what the other map says of the same place.
    """
    old = before.error
    if not np.array_equal(before.points, after.points):
        places, wanted = (np.round(one.points * 1e9) for one in (before, after))
        mean = np.column_stack([means_of(groups(*places.T), error) for error in before.error.T])
        at = dict(zip(map(tuple, places.tolist()), mean, strict=True))
        old = np.array([at.get(tuple(p), np.full(3, np.nan)) for p in wanted.tolist()]).reshape(-1, 3)
    return map_rms(after.error - old)


def map_rms(values: Array) -> float | None:
    """RMS length of (n, 3) vectors at the points where any of their coordinates is determined."""
    known = np.isfinite(values)
    points = known.any(axis=1)
    if not points.any():
        return None
    return float(np.sqrt(np.sum(np.where(known, values, 0.0) ** 2) / points.sum()))


@dataclass(frozen=True, kw_only=True)
class Identified(ABC):
    """What models of one session or of several together say of the machine."""

    error_map: ErrorMap  # the machine's errors
    model_name: str  # variant of the model, such as free or rigid_body; of several sessions each once
    effects: tuple[str, ...]  # ids of the effects that were added
    # what a budget adds to the variance of unknowns, by name; None where the uncertainty is what the readings show,
    # without instrument and temperature
    variance_added: Mapping[str, float] | None = None

    @property
    @abstractmethod
    def fits(self) -> tuple[Fit, ...]:
        """The fit as each session sees it."""

    @property
    @abstractmethod
    def parameters(self) -> list[Estimate]:
        """The unknowns that the data determines."""

    @property
    @abstractmethod
    def not_determined(self) -> list[NotDetermined]:
        """What the data cannot determine, with the reason."""

    def estimate(self, parameter: Parameter, value: float, standard_uncertainty: float) -> Estimate:
        """Of an unknown as the fit has it, with what a budget adds."""
        return Estimate.of(parameter, value, standard_uncertainty).with_variance(self.variance_added or {})

    def sizes(self, effects: Sequence[str]) -> tuple[Estimate, ...]:
        """Coefficients of effects in the model, with what a budget adds."""
        return tuple(own.with_variance(self.variance_added or {}) for own in effect_estimates(self.joint, effects))

    @property
    def joint(self) -> JointFit:
        """The fit."""
        return self.fits[0].joint

    @property
    def alternatives(self) -> dict[str, dict[str, float]]:
        """By effect, which others it may as well be, each with its probability; the uncertainties contain that.

        By no name (`BESIDE`), which may be there beside all of them.
        """
        known = self.joint.alternatives
        every = {} if known is None else {name: known.of(name) for name in (*self.effects, BESIDE)}
        return {name: others for name, others in every.items() if others}

    @property
    def rms_residual(self) -> float:
        """Root mean square of measured minus predicted, m."""
        return rms(np.concatenate([fit.residuals for fit in self.fits]))

    @property
    def provenance(self) -> Provenance:
        """What it was made from."""
        sessions = [fit.model.observations.session for fit in self.fits]
        return provenance(sessions, self.joint.assembly.labels, model=self.model_name, effects=self.effects)

    def fit_document(self) -> dict[str, Any]:
        """What is published of the fit and of the machine, as the contract's JSON document has it."""
        marginal = self.joint.marginal
        return {
            "rms_residual": self.rms_residual,
            "reduced_chi_square": self.joint.reduced_chi_square,
            "degrees_of_freedom": self.joint.solution.degrees_of_freedom,
            "p_value": self.joint.p_value,
            "effects": list(self.effects),
            "alternatives": self.alternatives,
            "spread": [size.document() for size in marginal.sizes],
            "scatter_factor": marginal.scatter,
            "memory_factor": marginal.memory_factor,
            "uncertainty": "identification" if self.variance_added is None else "budget",
            "parameters": [estimate.document() for estimate in self.parameters],
            "error_map": plain(self.error_map.content),
        }


@dataclass(frozen=True, kw_only=True)
class Result(Identified):
    """A fitted model and what it says of the machine."""

    fit: Fit  # the fit
    rejected: tuple[Rejected, ...]  # readings that were kept out
    observations: int  # number of readings recorded

    @property
    def fits(self) -> tuple[Fit, ...]:
        """The only session's."""
        return (self.fit,)

    @property
    def parameters(self) -> list[Estimate]:
        """The unknowns that the data determines, in the datum of the map, but for the map's own points."""
        fit, moved = self.fit, self.error_map.in_datum
        pairs = zip(fit.theta, np.sqrt(np.diag(fit.covariance)), strict=True)
        found = zip(fit.model.parameters, pairs, fit.determined, strict=True)
        own = ((p, pair) for p, pair, good in found if good and p.kind is not Kind.POINTS)
        return [self.estimate(p, *moved.get(p.name, pair)) for p, pair in own]

    @property
    def not_determined(self) -> list[NotDetermined]:
        """What the data cannot determine, with the reason; a table without any value determined is named as a whole."""
        fit = self.fit
        names = [p.name for p in fit.model.parameters]
        unread = _of_unread_setups(fit)
        whole = _whole_terms(fit) | unread
        out = list(fit.model.left_out) + list(self.error_map.not_determined)
        for k in np.flatnonzero(~fit.determined):
            own = _why_unread(fit, unread[names[k]]) if names[k] in unread else fit.model.why_not_determined(names[k])
            why = own or correlated_with(fit.undetermined, names, int(k), fit.part.n_points > 0)
            name = whole.get(names[k], names[k])
            if name == names[k] or all(entry.name != name for entry in out):
                out.append(NotDetermined(name, why))
        return out + _lost_places(fit.model.observations.session)

    def document(self) -> dict[str, Any]:
        """The result as the contract's JSON document; what is not determined is null."""
        session = self.fit.model.observations.session
        return {
            "format": "mtcal-result/1",
            "method": session.method,
            "model": self.model_name,
            "observations": self.observations,
            "used": len(self.fit.model.observations),
            "rejected": [r.document() for r in self.rejected],
            "not_determined": [{"name": n.name, "why": n.why} for n in self.not_determined],
            "datum": self.fit.model.datum,
            "suspicious": [*suspicions([session]), *(p.words for p in misplaced(session, self.error_map.content))],
            "provenance": self.provenance.document(),
            **self.fit_document(),
        }


def _why_unread(fit: Fit, setup: str) -> Said:
    recorded = fit.model.observations.session.as_recorded
    measured = recorded.setup_ids.index(setup) in recorded.readings.setup
    return say("undetermined.none_left" if measured else "undetermined.not_measured")


def _lost_places(session: Session) -> list[NotDetermined]:
    """Places at which all deviations in a direction are missing or were set aside, so that no map has them."""
    readings = session.readings
    if not spec_of(session).reads_machine or "gx" not in readings.columns:
        return []
    direction = unsigned(np.column_stack([readings.column(name) for name in ("gx", "gy", "gz")]))
    spot, kept = groups(*np.round(1e9 * readings.position().T)), np.isfinite(readings.displacement)
    place = groups(spot, *np.round(1e6 * direction.T))
    left = np.bincount(place, kept)
    first = np.sort(np.unique(place, return_index=True)[1][left == 0])
    lost = [k for k in first if not np.any(kept & (spot == spot[k]) & (np.abs(direction @ direction[k]) > ACROSS))]
    where = (", ".join(f"{1e3 * v:.6g}" for v in at) for at in readings.position()[lost])
    along = (", ".join(f"{v:.3g}" for v in at) for at in direction[lost])
    why = say("undetermined.none_left")
    return [NotDetermined(f"deviation along ({g}) at ({at}) mm", why) for g, at in zip(along, where, strict=True)]


def correlated_with(undetermined: Array, names: Sequence[str], k: int, points: bool = False) -> str:
    """Why nothing determines the k-th unknown: which others may change with it without any reading changing.

    From the (m, r) directions of the unknowns that nothing fixes, and whether points have unknowns of their own, which
    are not among the names.
    """
    direction = undetermined @ undetermined[k]
    others = [names[j] for j in np.argsort(-np.abs(direction)) if j != k and abs(direction[j]) > 1e-6]
    if not others:
        return say("undetermined.with_points" if points else "undetermined.no_reading")
    key = "undetermined.with_others" if len(others) > 4 else "undetermined.with"
    return say(key, names=", ".join(others[:4]))


def _whole_terms(fit: Fit) -> dict[str, str]:
    """Name of the term for each parameter of a table of which no value is determined."""
    determined = dict(zip((p.name for p in fit.model.parameters), fit.determined, strict=True))
    return {
        parameter.name: term.name
        for term in fit.model.terms
        if len(term.parameters) > 1 and not any(determined[p.name] for p in term.parameters)
        for parameter in term.parameters
    }


def _of_unread_setups(fit: Fit) -> dict[str, str]:
    """Name of the setup for each parameter of one in which nothing was read."""
    observed = fit.model.observations
    read = {observed.session.setup_ids[k] for k in np.unique(observed.readings.setup)}
    unread = set(observed.session.setup_ids) - read
    return {parameter.name: parameter.owner for parameter in fit.model.parameters if parameter.owner in unread}


FitQuality = Literal["bad", "nearly", "well", "too well"]

# A right model with a right uncertainty is called bad once in a thousand measurements, and nearly fitting once in 20.
_BAD, _NEARLY = 1e-3, 0.05


def fit_quality(p_value: float | None) -> FitQuality:
    """How a model fits readings of that p-value; well where there is none, as nothing speaks against it."""
    if p_value is None or p_value != p_value:
        return "well"
    if p_value > 1.0 - _BAD:
        return "too well"
    return "bad" if p_value < _BAD else "nearly" if p_value < _NEARLY else "well"


# Scatter of the readings of one direction over that about a model, within which both are the same scatter.
_SAME = 1.1


def one_direction(content: Mapping[str, Any] | None) -> float | None:
    """The scatter, m, of readings of one place and direction by which a fit with a map of this content is judged.

    That of runs that are read directly (ISO 230-2), where the model leaves no less: the reversal between both
    directions is part of the result.
    """
    scatter = (content or {}).get("scatter") or {}
    own: float | None = scatter.get("one_direction")
    return own if own is not None and own < _SAME * scatter["found"] else None


def lacks_reversal(content: Mapping[str, Any]) -> bool:
    """Whether the directions of such runs differ by what the model has not: its map has one value for both."""
    own, points = one_direction(content), np.asarray(content.get("points", ()), dtype=float)
    one_value = len(np.unique(points, axis=0)) == len(points)
    return own is not None and one_value and bool(content["scatter"]["found"] > _SAME * own)


def beside_reversal(content: Mapping[str, Any]) -> float:
    """Share of a map's uncertainty that is scatter: a reversal that the model lacks is none, and both maps have it."""
    scatter = content.get("scatter")
    return scatter["one_direction"] / scatter["found"] if scatter and lacks_reversal(content) else 1.0


def scatter_p_value(p_value: float | None, content: Mapping[str, Any] | None) -> float | None:
    """The p-value of the scatter by which a fit with a map of this content is judged."""
    if content is None or one_direction(content) is None:
        return p_value
    return float(content["scatter"]["one_direction_p_value"])


def only_if_right(p_value: float | None, content: Mapping[str, Any] | None) -> bool:
    """Whether the readings speak against the model on which the uncertainty of a map with this content rests."""
    return fit_quality(p_value) == "bad" and one_direction(content) is None
