# SPDX-License-Identifier: Apache-2.0
"""From one session, or several of one machine, to fitted models: the same for identifying, comparing and diagnosing."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

from machine_tool_calibration.effects.catalogue import find_effects
from machine_tool_calibration.effects.effect import Effect
from machine_tool_calibration.effects.effect_terms import add_effects
from machine_tool_calibration.errors import ModelError, did_you_mean
from machine_tool_calibration.methods.build import build_model, sharing_variant
from machine_tool_calibration.methods.joint.effects import with_effects
from machine_tool_calibration.methods.joint.map import joint_map
from machine_tool_calibration.methods.joint.model import CommonModels, common_models
from machine_tool_calibration.methods.joint.small_angles import random_of, settled, stated
from machine_tool_calibration.model.fit import JointFit, fit_models
from machine_tool_calibration.model.model import MethodModel
from machine_tool_calibration.model.result import ErrorMap
from machine_tool_calibration.session.provenance import Provenance, provenance
from machine_tool_calibration.session.session import Session

__all__ = ["FittedSessions", "fit_sessions", "joint_models"]


@dataclass(frozen=True)
class FittedSessions:
    """Models of one or several sessions, fitted.

    Attributes:
        joint: the fit, with a member for each session.
        common: what the models of several sessions share; None for one.
        model_names: variant of each session's model.
        effects: ids of the effects that were added.
    """

    joint: JointFit
    common: CommonModels | None
    model_names: tuple[str, ...]
    effects: tuple[str, ...]

    @property
    def provenance(self) -> Provenance:
        """What they were made from."""
        sessions = [fit.model.observations.session for fit in self.joint.fits]
        model = ", ".join(dict.fromkeys(self.model_names))
        return provenance(sessions, self.joint.assembly.labels, model=model, effects=self.effects)

    @cached_property
    def error_map(self) -> ErrorMap:
        """The machine's errors from all readings."""
        return self.map_of(self.joint)

    def map_of(self, joint: JointFit) -> ErrorMap:
        """The machine's errors by another fit of the same models, such as a restated one (`model.restated`)."""
        if self.common is None:
            fit = joint.fits[0]
            return fit.model.error_map(fit)
        return joint_map(joint, self.common, stated(joint, self.common.angles))


def fit_sessions(
    sessions: Sequence[Session],
    labels: Sequence[str] | None = None,
    *,
    model: str | None = None,
    effects: Sequence[str] = (),
    own: Sequence[Effect] = (),
    built: tuple[MethodModel, str] | None = None,
) -> FittedSessions:
    """Fit one session by itself, or several of one machine together.

    Args:
        sessions: the measurements.
        labels: names of several, all different; not needed for one.
        model: variant of the methods that have it; for one session, its method must.
        effects: ids of physical effects to add, in every session in which they can act.
        own: the user's own effects, beside the catalogue.
        built: the model of a single session with these effects in it, and its variant's name, where it was made before.

    Raises:
        ModelError: as for `joint_models`; an effect is unknown or cannot act; or there are too few readings.
    """
    found = find_effects(effects, own)
    if len(sessions) == 1:
        if built is None:
            base, name = build_model(sessions[0], model)
            built = add_effects(base, found), name
        return FittedSessions(fit_models([built[0]]), None, (built[1],), tuple(effects))
    common, names = joint_models(sessions, labels or (), model=model, effects=found)
    return FittedSessions(fit_models(common.models, labels, random_of(common.angles)), common, names, tuple(effects))


def joint_models(
    sessions: Sequence[Session], labels: Sequence[str], *, model: str | None = None, effects: Sequence[Effect] = ()
) -> tuple[CommonModels, tuple[str, ...]]:
    """The models of several sessions of one machine, with the same unknowns of the machine.

    Args:
        sessions: the measurements.
        labels: their names, all different.
        model: variant of the methods that have it; otherwise the one with tables of the machine's errors.
        effects: added to every session in which they can act.

    Raises:
        ModelError: fewer than two sessions, labels that repeat, a model that no session has, different machines, or an
            effect that acts in none.
    """
    if len(sessions) < 2:
        raise ModelError("several sessions are needed to fit them together")
    if len(labels) != len(sessions) or len(set(labels)) < len(labels):
        raise ModelError("each session needs a label of its own")
    known = list(dict.fromkeys(name for session in sessions for name in session.spec.models))
    if model is not None and model not in known:
        hint = did_you_mean(model, known)
        raise ModelError(f"none of the sessions has a model {model!r}{hint}; known are {', '.join(known)}")
    pairs = [build_model(session, sharing_variant(session, model)) for session in sessions]
    built, names = [base for base, _ in pairs], [name for _, name in pairs]
    common = common_models(built, labels)
    common = replace(common, models=settled(common.models, labels, common.angles))
    if not effects:
        return common, tuple(names)
    common = with_effects(common, labels, effects)
    return replace(common, models=settled(common.models, labels, common.angles)), tuple(names)
