# SPDX-License-Identifier: Apache-2.0
"""What dominates the uncertainty of a measurement's map, and which further measurement makes it smaller.

Beside the scatter of the readings two things weigh on a map that a fit of the readings alone does not show:

- angular errors, which a step diagonal can hardly distinguish from straightness;
- time: a drift of the reading, where every position is reached at one time only.

Angular errors are put into the model as what they are before any reading: unknowns of an expected size; what the
readings leave of them is their share of the uncertainty. A drift is not in a method's model unless a diagnosis puts it
there: its share is what one of the expected size would do to the map, or of the size that the readings leave possible,
where that is far smaller. A further measurement is judged by what would be left of all three.
"""

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

from machine_tool_calibration.effects.effect_terms import effect_term
from machine_tool_calibration.effects.linear_drift import LinearDrift
from machine_tool_calibration.errors import CalibrationError
from machine_tool_calibration.methods.build import build_model, error_map
from machine_tool_calibration.methods.step_diagonal.model import StepDiagonalModel
from machine_tool_calibration.model.fit import declared, fit_models
from machine_tool_calibration.model.model import Constraint, MethodModel
from machine_tool_calibration.model.result import ErrorMap
from machine_tool_calibration.planning.options import Option, Proposal, further_options
from machine_tool_calibration.residuals.sums import residual_sums
from machine_tool_calibration.session.session import Session

ANGULAR = 5e-6
"""Root mean square of a usual machining centre's angular errors, rad."""

DRIFT = 1e-9
"""Rate at which a reading drifts if the air warms by 1 K per hour, m/s: 3.6 um an hour, a third of a metre of steel."""

_FAR_LESS = 0.1  # share of the expected drift below which what the readings say of a steady one counts in its place
_WORTHWHILE = 0.9  # a remedy leaves less than this of what the same measurement once more would leave
_MOST_REMEDIES = 3


@dataclass(frozen=True, kw_only=True)
class Remedy(Proposal):
    """A further measurement that makes what dominates smaller."""

    uncertainty: float  # root mean square standard uncertainty of the map's coordinates with it, m


@dataclass(frozen=True)
class Dominant:
    """What makes up the uncertainty of a map."""

    cause: Literal["readings", "angular errors", "time"]  # what has the largest share of the variance
    uncertainty: float  # root mean square standard uncertainty of the map's coordinates, m
    shares: dict[str, float]  # of its variance, by cause
    angular: float  # size of the angular errors that was assumed, rad; 0 where the model has none
    drift: float  # rate that was assumed, or that the readings leave possible, m/s; 0 where no time was recorded
    again: float | None = None  # the uncertainty after the same measurement once more, m; None if not asked for
    # measurements that are clearly better than that, the best first; none where the readings' own scatter dominates
    remedies: tuple[Remedy, ...] = ()
    scatter: float = 1.0  # of the readings, over that declared

    def document(self) -> dict[str, Any]:
        """For programs."""
        return {
            "cause": self.cause,
            "uncertainty": self.uncertainty,
            "shares": self.shares,
            "assumed": {"angular": self.angular, "drift": self.drift},
            "uncertainty_again": self.again,
            "measure": [
                {key: getattr(r, key) for key in ("kind", "measure", "uncertainty", "seconds")}
                | {"besides": r.aside or None}
                for r in self.remedies
            ],
        }


def dominant(
    session: Session, *, model: str | None = None, angular: float = ANGULAR, drift: float = DRIFT
) -> Dominant | None:
    """What dominates the uncertainty of a planned session's map, and what would make it smaller; None without a map.

    Only the geometry matters. Expected are `angular`, the root mean square of the machine's angular errors, rad, and
    `drift`, the rate of the reading's drift, m/s.
    """
    try:
        found = _shares(session, build_model(session, model)[0], angular, drift)
    except CalibrationError:
        return None
    if found is None or found.cause == "readings":
        return found
    return with_remedies(found, further_options(session), lambda extended: build_model(extended, model)[0])


def _shares(
    session: Session, built: MethodModel, angular: float, drift: float, scatter: float = 1.0
) -> Dominant | None:
    """What dominates, of a session and its model."""
    angles = isinstance(built, StepDiagonalModel) and built.spread is not None
    drift = drift if LinearDrift().why_not(built.observations) is None else 0.0
    readings = _uncertainty(build_model(session, "translations")[0] if angles else built, 0.0, 0.0, scatter)
    still = _uncertainty(built, angular, 0.0, scatter) if angles else readings
    whole = _uncertainty(built, angular, drift, scatter) if drift else still
    if not np.isfinite(readings + still + whole):
        return None
    shares = {
        "readings": min(readings**2 / whole**2, 1.0),
        "angular errors": max(still**2 - readings**2, 0.0) / whole**2,
        "time": max(whole**2 - still**2, 0.0) / whole**2,
    }
    cause = max(("readings", "angular errors", "time"), key=lambda name: shares[name])
    return Dominant(cause, whole, shares, angular if angles else 0.0, drift, scatter=scatter)  # type: ignore[arg-type]


def with_remedies(found: Dominant, options: Sequence[Option], build: Callable[[Session], MethodModel]) -> Dominant:
    """With those of the further measurements that are worth it, by the models of the session with each."""
    known = []
    for option in options:
        with suppress(CalibrationError):
            after = _uncertainty(build(option.session), found.angular, found.drift, found.scatter)
            known += [(option, after)] if np.isfinite(after) else []
    again = next((after for option, after in known if option.kind == "again"), found.uncertainty)
    better = sorted((t for t in known if t[1] < _WORTHWHILE * again), key=lambda t: t[1])
    remedies = tuple(Remedy(uncertainty=after, **o.proposal) for o, after in better[:_MOST_REMEDIES])
    return replace(found, again=again, remedies=remedies)


def limits_of(session: Session, built: MethodModel, scatter: float = 1.0) -> Dominant | None:
    """What dominates in a measured session, with what it says of angular errors and warming; no remedies yet.

    Its readings scatter so many times as much as declared: of step diagonals that may be angular errors.
    """
    scatter = 1.0 if isinstance(built, StepDiagonalModel) else scatter
    try:
        return _shares(session, built, angular_size(built), _drift(session, built), scatter)
    except CalibrationError:
        return None


def _drift(session: Session, built: MethodModel) -> float:
    """Rate of a drift, m/s, as the air warmed; what the readings bound it by, where that is far less."""
    expected = DRIFT * max(_warming(session), 1.0)
    if LinearDrift().why_not(built.observations) is not None:
        return expected
    fit = fit_models([built])
    sums = residual_sums(fit.fits[0], LinearDrift().columns(built.observations))
    told = float(np.hypot(sums.added, fit.birge_ratio * sums.added_uncertainty)[0])
    return told if told < _FAR_LESS * expected else expected


def angular_size(model: MethodModel) -> float:
    """What the readings of a model say of the size of the machine's angular errors, rad; what is usual if nothing."""
    spread = model.spread if isinstance(model, StepDiagonalModel) else None
    return ANGULAR if spread is None else spread.size


def _warming(session: Session) -> float:
    """Largest change of the air's temperature over the session's time, K per hour; 0 where it is not known."""
    columns = session.readings.columns
    air, time = columns.get("temperature_air"), columns.get("time")
    if air is None or time is None:
        return 0.0
    good = np.isfinite(air) & np.isfinite(time)
    hours = float(np.ptp(time[good])) / 3600.0 if good.any() else 0.0
    return float(np.ptp(air[good])) / hours if hours > 0 else 0.0


def _uncertainty(model: MethodModel, angular: float, drift: float, scatter: float) -> float:
    """RMS standard uncertainty of the map, m, with what a drift that the model lacks does to it; NaN without a map."""
    try:
        built = expecting(model, angular)
        still = _map(built)
        square = (scatter * still.uncertainty) ** 2
        if drift:
            term = effect_term(LinearDrift(), built.observations)
            held = Constraint({term.parameters[0].name: 1.0}, -drift)
            drifted = _map(replace(built.with_terms((term,)), constraints=(*built.constraints, held)))
            square = square + (drifted.error - still.error) ** 2
    except (CalibrationError, np.linalg.LinAlgError):
        return float("nan")
    # Neither what is not determined nor what the datum fixes.
    known = square[np.isfinite(square) & (still.uncertainty > 0)]
    return float(np.sqrt(np.mean(known))) if len(known) else float("nan")


def expecting(model: MethodModel, angular: float = ANGULAR) -> MethodModel:
    """A model with angular errors of an expected RMS, rad, whatever its readings (if taken) say of them."""
    return model.expecting(angular) if isinstance(model, StepDiagonalModel) else model


def _map(model: MethodModel) -> ErrorMap:
    # From where the readings are taken, and not from how they scatter: those of a further measurement are not there
    # yet, and angular errors that a model leaves out must not count as what does not reproduce.
    return error_map(declared(fit_models([model])).fits[0])
