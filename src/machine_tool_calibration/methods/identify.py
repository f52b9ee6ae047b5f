# SPDX-License-Identifier: Apache-2.0
"""From one session or several to the machine's errors: the one entry for nodes, commands and programs."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from machine_tool_calibration.arrays import rms
from machine_tool_calibration.effects.effect import Effect
from machine_tool_calibration.errors import ModelError
from machine_tool_calibration.estimation.reduction import single_blas
from machine_tool_calibration.json_types import plain
from machine_tool_calibration.methods.build import rejected_readings, suspicious_fits
from machine_tool_calibration.methods.fitted import (
    FitRequest,
    FittedSessions,
    WithoutGrossErrors,
    fit_sessions,
    gross_errors,
    refuse_impossible,
)
from machine_tool_calibration.methods.joint.agreement import Agreement, agreement
from machine_tool_calibration.methods.joint.model import CommonModels, common_models
from machine_tool_calibration.methods.joint.small_angles import PublishedAngles, published_angles
from machine_tool_calibration.model.fit import Fit, JointFit, fit_models
from machine_tool_calibration.model.model import MethodModel, NotDetermined
from machine_tool_calibration.model.result import Estimate, Identified, Rejected, Result, correlated_with
from machine_tool_calibration.residuals.gross_errors import Outlier
from machine_tool_calibration.session.session import Session


@dataclass(frozen=True, kw_only=True)
class JointResult(Identified):
    """Several sessions fitted together."""

    labels: tuple[str, ...]  # names of the sessions
    fit: JointFit  # of all of them
    # small angular errors that a step diagonal has as random functions, and all else with the mean over them; None
    # where there are none
    angles: PublishedAngles | None
    common: CommonModels  # the models and what they share
    agreement: Agreement  # whether the sessions agree
    model_names: tuple[str, ...]  # variant of each session's model
    rejected: tuple[tuple[Rejected, ...], ...]  # readings kept out, for each session
    observations: tuple[int, ...]  # readings recorded in each session

    @cached_property
    def fits(self) -> tuple[Fit, ...]:
        """The fit as each session sees it."""
        return self.fit.fits

    @property
    def parameters(self) -> list[Estimate]:
        """The unknowns that the data determines; those of an instrument carry the session's label."""
        solution = self.fit.published
        sigma = np.sqrt(np.diag(solution.covariance).clip(0.0))
        found = zip(self.fit.assembly.parameters, solution.theta, sigma, solution.determined, strict=True)
        return [self.estimate(p, value, u) for p, value, u, good in found if good]

    @property
    def not_determined(self) -> list[NotDetermined]:
        """What no session determines, with the reason."""
        left_out = (entry for model in self.common.models for entry in model.left_out)
        out = {entry.name: entry.why for entry in left_out if entry.effect in self.effects}
        names = [p.name for p in self.fit.assembly.parameters]
        solution = self.fit.solution
        points = any(fit.part.n_points for fit in self.fit.fits)
        for k in np.flatnonzero(~solution.determined):
            out[names[k]] = correlated_with(solution.undetermined, names, int(k), points)
        if self.angles is not None:
            out |= {entry.name: entry.why for entry in self.angles.not_determined}
        out |= {entry.name: entry.why for entry in self.error_map.not_determined}
        return [NotDetermined(name, why) for name, why in out.items()]

    def document(self) -> dict[str, Any]:
        """The result as a JSON document: that of a single session, with the sessions and their agreement."""
        sessions = zip(self.labels, self.fits, self.model_names, self.observations, strict=True)
        return {
            "format": "mtcal-result/1",
            "method": "joint",
            "observations": sum(self.observations),
            "used": self.fit.assembly.problem.n_readings,
            "rejected": [
                {"session": label, **r.document()}
                for label, rejected in zip(self.labels, self.rejected, strict=True)
                for r in rejected
            ],
            "sessions": [
                {
                    "label": label,
                    "method": fit.model.observations.session.method,
                    "model": name,
                    "observations": count,
                    "used": len(fit.model.observations),
                    "rms_residual": rms(fit.residuals),
                }
                for label, fit, name, count in sessions
            ],
            "agreement": plain(asdict(self.agreement)),
            "not_determined": [{"name": n.name, "why": n.why} for n in self.not_determined],
            "datum": self.common.datum,
            "suspicious": suspicious_fits(self.fits, self.labels),
            "provenance": self.provenance.document(),
            **self.fit_document(),
        }


def fitted_sessions(result: Result | JointResult) -> FittedSessions:
    """The fit behind a result, of which the map can be had again for other readings."""
    if isinstance(result, JointResult):
        return FittedSessions(result.fit, result.common, result.model_names, result.effects)
    return FittedSessions(result.joint, None, (result.model_name,), result.effects)


def identify_sessions(chosen: FitRequest, set_aside: Sequence[Sequence[Outlier]] = ()) -> Result | JointResult:
    """Identify one machine from one session, or from several of the same or of different methods.

    Gross errors of each session that was `set_aside` from it beforehand, with all others kept, are told as rejected. A
    ModelError as for `identify` and `joint_models`; a session that contradicts itself; or too few readings.
    """
    if len(chosen.sessions) == 1:
        return _identified(chosen, set_aside)
    gone = set_aside or [()] * len(chosen.sessions)
    observations = tuple(len(one.readings) + len(own) for one, own in zip(chosen.sessions, gone, strict=True))
    rejected, chosen, fitted = _fitted(chosen, gone)
    joint, common = fitted.joint, fitted.common
    names = joint.assembly.labels
    assert common is not None and names is not None
    angles = published_angles(joint, common.angles)
    agreed = agreement(joint, common, names, _spread(common))
    if angles is not None:
        agreed = replace(agreed, statement=angles.hiding(agreed.statement))
    refuse_impossible(fitted)
    return JointResult(
        labels=names,
        fit=joint,
        angles=angles,
        common=common,
        error_map=fitted.error_map,
        agreement=agreed,
        effects=chosen.effects,
        model_name=fitted.model_name,
        model_names=fitted.model_names,
        rejected=rejected,
        observations=observations,
    )


def _fitted(
    chosen: FitRequest, gone: Sequence[Sequence[Outlier]]
) -> tuple[tuple[tuple[Rejected, ...], ...], FitRequest, FittedSessions]:
    """The readings of each session that are kept out, what is chosen without them, and the fit to it."""
    found = (
        [WithoutGrossErrors(list(own), session) for session, own in zip(chosen.sessions, gone, strict=True)]
        if chosen.keep_all
        else gross_errors(chosen)
    )
    rejected = tuple(
        rejected_readings(session) + tuple(Rejected(o.row, o.reason, o.deviation) for o in own.outliers)
        for session, own in zip(chosen.sessions, found, strict=True)
    )
    chosen = replace(chosen, sessions=tuple(own.session for own in found))
    return rejected, chosen, fit_sessions(chosen, [own.built for own in found])


def _spread(common: CommonModels) -> float:
    """Reduced chi-square of the sessions fitted one by one, with the datum that each needs alone."""
    total, dof = 0.0, 0
    for model in common.models:
        alone: MethodModel = common_models([model], [""]).models[0]
        try:
            solution = fit_models([alone]).solution
        except ModelError:
            continue
        total, dof = total + solution.chi_square, dof + solution.degrees_of_freedom
    return total / dof if dof else 1.0


def identify(
    session: Session,
    *,
    model: str | None = None,
    effects: Sequence[str] = (),
    own: Sequence[Effect] = (),
    keep_all: bool = False,
) -> Result:
    """Identify the machine's errors from one session by a variant of its method, such as `free`; by default its first.

    With physical effects by their ids, and the user's `own` beside the catalogue. Readings that stand out of all others
    are set aside, unless `keep_all`. A ModelError: the data does not allow the model, an effect is unknown or needs
    what was not recorded, or what is identified cannot be.
    """
    return _identified(FitRequest((session,), None, model, tuple(effects), tuple(own), keep_all))


@single_blas()
def _identified(chosen: FitRequest, set_aside: Sequence[Sequence[Outlier]] = ()) -> Result:
    (session,), gone = chosen.sessions, set_aside or [()]
    (rejected,), chosen, fitted = _fitted(chosen, gone)
    refuse_impossible(fitted)
    return Result(
        fit=fitted.joint.fits[0],
        error_map=fitted.error_map,
        effects=chosen.effects,
        model_name=fitted.model_name,
        rejected=rejected,
        observations=len(session.readings) + len(gone[0]),
    )
