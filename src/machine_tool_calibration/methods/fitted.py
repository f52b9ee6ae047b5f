# SPDX-License-Identifier: Apache-2.0
"""From one session, or several of one machine, to fitted models: the same for identifying, comparing and diagnosing.

Refused is what no machine has: errors of centimetres, and instruments that do not stand where they are stated to stand.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from types import MappingProxyType

import numpy as np

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.effects.catalogue import catalogue, find_effects
from machine_tool_calibration.effects.effect import Effect
from machine_tool_calibration.effects.effect_terms import add_effects
from machine_tool_calibration.errors import ModelError, did_you_mean, suspected
from machine_tool_calibration.methods.build import build_model, error_map, sharing_variant
from machine_tool_calibration.methods.joint.map import joint_map
from machine_tool_calibration.methods.joint.model import CommonModels, common_models, with_effects
from machine_tool_calibration.methods.joint.small_angles import published_angles, random_of, with_estimated_angles
from machine_tool_calibration.model.fit import JointFit, declared, fit_models
from machine_tool_calibration.model.model import MethodModel
from machine_tool_calibration.model.result import ErrorMap, effect_signal, map_rms
from machine_tool_calibration.model.widening import BESIDE, Alternatives
from machine_tool_calibration.residuals.gross_errors import Outlier, find_outliers, without
from machine_tool_calibration.session.catalogue import spec_of
from machine_tool_calibration.session.checks.places import refuse_misplaced
from machine_tool_calibration.session.provenance import Provenance, provenance
from machine_tool_calibration.session.session import Session

Built = tuple[MethodModel, str]
"""A session's model, and the name of its variant."""


@dataclass(frozen=True)
class FitRequest:
    """One session, or several of one machine, and the model to fit to them."""

    sessions: tuple[Session, ...]  # the measurements
    # names of several, all different; None for a single one, whose name is dropped
    labels: tuple[str, ...] | None = None
    # variant of the methods that have it, which for one session its method must; the default if None
    model: str | None = None
    effects: tuple[str, ...] = ()  # ids of physical effects in the model, in every session in which they can act
    own: tuple[Effect, ...] = ()  # the user's own effects, beside the catalogue
    # use all readings; otherwise those that stand out of all others of their session are set aside
    keep_all: bool = False
    # by effect in the model, which others it may as well be, and which may be there `BESIDE` all of them, each with its
    # probability: that widens the uncertainty
    alternatives: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    # models of its sessions without effects, by session and variant, as far as they were made: of this choice and of
    # those with other effects
    made: dict[tuple[int, str | None], tuple[Session, Built]] = field(default_factory=dict, repr=False, compare=False)

    def __post_init__(self) -> None:
        if not isinstance(self.model, str | None):
            raise ModelError(f"a model must be a name, not {self.model!r}")
        several = self.labels is not None and len(self.sessions) > 1
        object.__setattr__(self, "labels", tuple(self.labels or ()) if several else None)
        for name in ("sessions", "effects", "own"):
            object.__setattr__(self, name, tuple(getattr(self, name)))

    @classmethod
    def of(cls, subject: Session | FitRequest) -> FitRequest:
        """A session with its method's default model, or what was chosen already."""
        return cls((subject,)) if isinstance(subject, Session) else subject

    def adding(
        self, effects: Sequence[str], alternatives: Mapping[str, Mapping[str, float]] = MappingProxyType({})
    ) -> FitRequest:
        """With further effects in the model, and what these may be instead; what is beside all is known anew."""
        before = {effect: others for effect, others in self.alternatives.items() if effect != BESIDE}
        return replace(self, effects=(*self.effects, *effects), alternatives={**before, **alternatives})

    @property
    def model_of(self) -> tuple[tuple[str, ...], Mapping[str, Mapping[str, float]]]:
        """What distinguishes the models on a way: the effects, and what the uncertainty contains beside them."""
        return self.effects, self.alternatives

    def instead(self, at: int, session: Session) -> FitRequest:
        """With another session in the place of one."""
        return replace(self, sessions=(*self.sessions[:at], session, *self.sessions[at + 1 :]), made=dict(self.made))

    @property
    def present(self) -> list[Effect]:
        """The effects in the model; a ModelError if one of them is unknown."""
        return find_effects(self.effects, self.own)

    @property
    def known(self) -> dict[str, Effect]:
        """All effects by id: the catalogue, those of what was recorded, and the user's own."""
        return catalogue(self.own, list(dict.fromkeys(name for s in self.sessions for name in s.readings.columns)))

    @property
    def absent(self) -> list[Effect]:
        """All that may be added to the model."""
        present = {"", *self.effects}
        return [e for e in self.known.values() if e.id not in present and e.beside in present]

    def base(self, session: Session) -> Built:
        """The model of one of the sessions, or of a part of it, without effects; and the name of its variant."""
        variant = self.model if len(self.sessions) == 1 else sharing_variant(session, self.model)
        if not any(session is own for own in self.sessions):
            return build_model(session, variant)
        of, built = self.made.get(key := (id(session), variant), (None, None))
        if of is not session or built is None:
            built = build_model(session, variant)
            self.made[key] = session, built
        return built

    def finished(self, base: Built) -> Built:
        """The same as far as it is the session's alone: with the effects, unless several sessions share them."""
        model, name = base
        return (add_effects(model, self.present) if len(self.sessions) == 1 else model), name


@dataclass(frozen=True)
class WithoutGrossErrors:
    """A session without the readings that do not belong to the rest."""

    outliers: list[Outlier]  # these readings, the largest first
    session: Session  # it, with these as lost ones
    built: Built | None = None  # see `FitRequest`; None where it is yet to be made of what was left

    @property
    def rows(self) -> tuple[int, ...]:
        """Rows of these readings, in order."""
        return tuple(sorted(outlier.row for outlier in self.outliers))


@dataclass(frozen=True)
class FittedSessions:
    """Models of one or several sessions, fitted."""

    joint: JointFit  # the fit, with a member for each session
    common: CommonModels | None  # what the models of several sessions share; None for one
    model_names: tuple[str, ...]  # variant of each session's model
    effects: tuple[str, ...]  # ids of the effects that were added

    @property
    def model_name(self) -> str:
        """Variants of the sessions' models, each once."""
        return ", ".join(dict.fromkeys(self.model_names))

    @property
    def provenance(self) -> Provenance:
        """What they were made from."""
        sessions = [fit.model.observations.session for fit in self.joint.fits]
        return provenance(sessions, self.joint.assembly.labels, model=self.model_name, effects=self.effects)

    @cached_property
    def error_map(self) -> ErrorMap:
        """The machine's errors from all readings."""
        return self.map_of(self.joint)

    @cached_property
    def at_reference(self) -> FittedSessions:
        """The same without what an effect adds to the map by time, temperature and the like, each at its zero.

        Deviations that are read directly are mapped in each state in which they were read, and no other measurement
        meets the same ones.
        """
        assembly = self.joint.assembly
        gone = {name for name in self.effects if _of_state(name)}
        models = tuple(
            replace(model, terms=tuple(replace(t, field=None) if t.name in gone else t for t in model.terms))
            for model in assembly.models
        )
        return replace(self, joint=replace(self.joint, assembly=replace(assembly, models=models))) if gone else self

    @cached_property
    def limited_by_runs(self) -> bool:
        """Whether most of the map's variance comes from what runs, mountings or setups differ by."""
        marginal = self.joint.marginal
        if not any(size.high for size in marginal.sizes):
            return False
        alone = self.map_of(declared(self.joint, marginal.scatter**2 * self.joint.solution.covariance))
        own, whole = map_rms(alone.uncertainty), map_rms(self.error_map.uncertainty)
        return own is not None and whole is not None and own**2 < 0.5 * whole**2

    def map_of(self, joint: JointFit) -> ErrorMap:
        """The machine's errors by another fit of the same models, such as those of `changed`."""
        if self.common is None:
            return error_map(joint.fits[0])
        return joint_map(joint, self.common, published_angles(joint, self.common.angles))


def _of_state(name: str) -> bool:
    try:
        (effect,) = find_effects([name])
    except ModelError:
        return True  # one of the user's own, of which the columns are not known here
    return effect.of_state


def fit_sessions(subject: Session | FitRequest, built: Sequence[Built | None] = ()) -> FittedSessions:
    """Fit one session by itself, or several of one machine together; `built` has the models of all, if made before.

    A ModelError as for `joint_models`; also an effect that is unknown or cannot act, or too few readings.
    """
    chosen = FitRequest.of(subject)
    if len(chosen.sessions) == 1:
        ((model, name),) = _all_built(chosen, built)
        joint = _with_alternatives(fit_models([model]), chosen)
        return FittedSessions(joint, None, (name,), chosen.effects)
    common, names = joint_models(chosen, built)
    joint = _with_alternatives(fit_models(common.models, chosen.labels, random_of(common.angles)), chosen)
    return FittedSessions(joint, common, names, chosen.effects)


def _with_alternatives(joint: JointFit, chosen: FitRequest) -> JointFit:
    """The fit with what its effects may be instead, as far as the data allows these in their place."""
    differences = dict[tuple[str, str], Array]()
    asked = [(effect, other) for effect, others in chosen.alternatives.items() for other in others]
    for effect, other in asked:
        if effect not in (BESIDE, *chosen.effects) or other in chosen.effects:
            continue
        kept = (*chosen.effects, BESIDE) if effect == BESIDE else chosen.effects
        effects = tuple(other if name == effect else name for name in kept)
        find_effects([other], chosen.own)  # that it is unknown is not passed over
        try:
            instead = fit_sessions(replace(chosen, effects=effects, alternatives={})).joint
        except ModelError:
            continue
        own = 0.0 if effect == BESIDE else effect_signal(joint, effect)[0]
        differences[effect, other] = effect_signal(instead, other)[0] - own
    if not differences:
        return joint
    ends = np.cumsum([len(model.sigma) for model in joint.assembly.models])
    each = tuple(np.split(np.array(list(differences.values())), ends[:-1], axis=1))
    probability = np.array([chosen.alternatives[effect][other] for effect, other in differences])
    return replace(joint, alternatives=Alternatives(tuple(differences), each, probability))


def joint_models(chosen: FitRequest, built: Sequence[Built | None] = ()) -> tuple[CommonModels, tuple[str, ...]]:
    """The models of several sessions of one machine, with the same unknowns of the machine.

    Without a variant theirs are those with tables of the machine's errors. A ModelError says that labels are
    missing or repeat, no session has the model, the machines differ, or an effect acts in none.
    """
    effects, labels = chosen.present, chosen.labels or ()
    if len(labels) != len(chosen.sessions) or len(set(labels)) < len(labels):
        raise ModelError("each session needs a label of its own")
    known = list(dict.fromkeys(name for session in chosen.sessions for name in spec_of(session).together))
    if chosen.model is not None and chosen.model not in known:
        hint = did_you_mean(chosen.model, known)
        raise ModelError(f"none of the sessions has a model {chosen.model!r}{hint}; known are {', '.join(known)}")
    models, names = zip(*_all_built(chosen, built), strict=True)
    common = common_models(models, labels)
    common = replace(common, models=with_estimated_angles(common.models, labels, common.angles))
    if not effects:
        return common, names
    common = with_effects(common, labels, effects)
    return replace(common, models=with_estimated_angles(common.models, labels, common.angles)), names


def _all_built(chosen: FitRequest, built: Sequence[Built | None]) -> list[Built]:
    made = built or [None] * len(chosen.sessions)
    return [own or chosen.finished(chosen.base(session)) for session, own in zip(chosen.sessions, made, strict=True)]


def gross_errors(chosen: FitRequest) -> list[WithoutGrossErrors]:
    """The readings of each session that do not belong to the rest, and what is left.

    Of several, each by itself and without effects: where one is missing, all its residuals are large, and none stands
    out.
    """
    return [_without_gross_errors(chosen, session) for session in chosen.sessions]


def _without_gross_errors(chosen: FitRequest, session: Session) -> WithoutGrossErrors:
    made: list[Built] = []

    def build(part: Session) -> MethodModel:
        built = chosen.finished(chosen.base(part))
        made.extend([built] if part is session else [])
        return built[0]

    outliers = find_outliers(session, build, lambda part: chosen.base(part)[0])
    # Where nothing was set aside the model is that in which it was looked for.
    left = without(session, outliers, as_lost=True)
    return WithoutGrossErrors(outliers, left, made[0] if made and not outliers else None)


# Position error that no machine tool has, m, and by how many of its uncertainties it must be known.
_IMPOSSIBLE = 0.01
_KNOWN = 5.0


@suspected()
def refuse_impossible(fitted: FittedSessions) -> None:
    """Refuse what readings that contradict the geometry say of the machine, unless a session says `trust_units`.

    A ModelError names a position error of centimetres in the map of all sessions, or a station far from where its
    own session states it to be.
    """
    sessions = [fit.model.observations.session for fit in fitted.joint.fits]
    if not any(session.description.trust_units for session in sessions):
        labels = fitted.joint.assembly.labels
        _refuse_errors(sessions[0].source if len(sessions) == 1 else ", ".join(labels or ()), fitted.error_map)
    for session, fit in zip(sessions, fitted.joint.fits, strict=True):
        if spec_of(session).beam_from_pointer and not session.description.trust_units:
            own = fitted.error_map if len(sessions) == 1 else error_map(fit)
            refuse_misplaced(session, own.content)


def _refuse_errors(name: str, error_map: ErrorMap) -> None:
    size = np.abs(error_map.error)
    there = np.isfinite(size) & (size > _KNOWN * error_map.uncertainty) & (size > _IMPOSSIBLE)
    if there.any():
        k, j = np.argwhere(there)[int(np.argmax(size[there]))]
        place = ", ".join(f"{1e3 * v:.6g}" for v in error_map.points[k])
        raise ModelError(
            f"{name}: the position error along {'xyz'[j]} at ({place}) mm comes out as "
            f"{1e3 * size[k, j]:.3g} mm, which no machine has: check units, columns and signs, and where the "
            "instrument stood"
        )
