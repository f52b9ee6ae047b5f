"""Effects found one after the other, each in what the model with the earlier ones leaves."""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import stats

from machine_tool_calibration.diagnosis.candidates import Candidate, effect_candidates
from machine_tool_calibration.diagnosis.look import Look, look_at
from machine_tool_calibration.diagnosis.pairs import Pair
from machine_tool_calibration.diagnosis.rules import LATER_LEVEL, LEVEL, PAIR_LEVEL, ROUNDS, rules_of
from machine_tool_calibration.diagnosis.structure import structure_candidates
from machine_tool_calibration.effects.effect import Effect
from machine_tool_calibration.errors import ModelError
from machine_tool_calibration.model.fit import Fit, fit_models
from machine_tool_calibration.model.model import MethodModel
from machine_tool_calibration.session.session import Session

__all__ = ["Found", "find_effects_in", "left_over", "still_fails"]

# How much better a structure without a cause must do than one effect, or than several together, to speak against them.
_ONE, _MARGIN, _SEVERAL = 1.3, 6.0, 0.9
# Gain of the information criterion from which two effects are tried in the place of a single other one.
_PARSIMONY = 6.0
# The same in the place of two or three.
_CLEARLY = 2.0
# Reduced chi-square from which the readings contradict the model, the chance of that, and the share of the excess that
# effects must take to be the cause all the same.
_GROSS, _GROSS_LEVEL, _MOST_OF_IT = 2.0, 1e-9, 1 / 3
# Chance from which an effect that was found early is no longer needed beside those found after it, and how often that
# is looked at.
_NEEDLESS, _MOST_NEEDLESS = 0.003, 4


# Growth of the map's uncertainty from which an effect is worth nothing in the model, whether or not it is there.
_SPOILT = 30.0
# Uncertainties of the map that are those of the machine or the part, not of where the instrument stood.
_OF_THE_MACHINE = re.compile(r"(position_error|[xyz]|E[XYZABC][XYZABC]|workpiece_error|workpiece_form)_u")


@dataclass(frozen=True)
class Found:
    """What the rounds came to.

    Attributes:
        looks: at the first model and after every accepted effect.
        accepted: in the order in which they were found.
        excluded: effects that could not be looked for, with the reason.
    """

    looks: tuple[Look, ...]
    accepted: tuple[Effect, ...]
    excluded: dict[str, str]


@dataclass(frozen=True)
class _Task:
    """What stays the same in all rounds."""

    session: Session
    model_of: Callable[[Session, Sequence[Effect]], MethodModel]
    fit: Fit
    candidates: list[Candidate]
    structures: list[Candidate]
    rng: np.random.Generator
    sets: int
    progress: Callable[[str, float], None]


def find_effects_in(
    session: Session,
    known: Sequence[Effect],
    model_of: Callable[[Session, Sequence[Effect]], MethodModel],
    rng: np.random.Generator,
    sets: int,
    progress: Callable[[str, float], None],
) -> Found:
    """Look, accept the best effect, and look again, until nothing is found or three are.

    Args:
        session: the measurement.
        known: effects to look for.
        model_of: makes the model of a session with effects added.
        rng: source of random numbers.
        sets: simulated data sets in which nothing is missing.
        progress: told what is being done and the share that is finished.
    """
    base = model_of(session, ())
    # Error motions that the model holds as random functions, under names of their own.
    held = {term.name.rsplit(".", 1)[1] for term in base.terms if "." in term.name}
    candidates, excluded = effect_candidates(base.observations, [e for e in known if e.id not in held])
    excluded |= {e.id: "the model has it already, as a random function" for e in known if e.id in held}
    structures = structure_candidates(base.observations)
    task = _Task(session, model_of, fit_models([base]).fits[0], candidates, structures, rng, sets, progress)
    if rules_of(session.method).side_by_side:
        return _without_needless(task, excluded)
    found = _one_after_the_other(task, excluded)
    look = found.looks[0]
    pair = look.pair
    if pair is not None and _does_better(pair, found):
        # Neither leads by itself, or a third one looks like their sum.
        granted = pair.family_p_value <= PAIR_LEVEL
        other = _one_after_the_other(task, found.excluded, look, first=pair.names, granted=granted)
        if _are(pair, other.accepted[:2]) and _stands(other):
            both = _each_beside_the_other(task, other)
            if both is not None:
                return both
    if found.accepted and not _stands(found):
        # The first may have been taken for several others together.
        other = _one_after_the_other(task, found.excluded, look, last=(found.accepted[0].id,))
        if other.accepted and _stands(other):
            return other
    if _contradicted(found):
        return replace(found, looks=found.looks[:1], accepted=())
    suspect = look.suspect()
    if not found.accepted and look.structure and suspect is not None:
        # That something is missing is known: what takes it all up need not stand out of all effects by itself.
        other = _one_after_the_other(task, found.excluded, look, first=(suspect.candidate.name,), granted=True)
        if other.accepted and _stands(other):
            return other
    return found


def _without_needless(task: _Task, excluded: dict[str, str]) -> Found:
    """The rounds, begun again while an early effect is made superfluous by later ones."""
    last: set[str] = set()
    while True:
        found = _one_after_the_other(task, excluded, last=last)
        needless = _needless(found)
        if needless is None or needless in last or len(last) == _MOST_NEEDLESS:
            return found
        last.add(needless)


def _does_better(pair: Pair, found: Found) -> bool:
    """Whether two effects fitted together explain more than what was found one after the other."""
    if _are(pair, found.accepted) or (len(found.accepted) == 1 and found.accepted[0].id in pair.names):
        return False  # the other one of the two was tried beside it
    return pair.gain > _gain(found) + (_PARSIMONY if len(found.accepted) < 2 else _CLEARLY)


def _are(pair: Pair, effects: Sequence[Effect]) -> bool:
    return {effect.id for effect in effects} == set(pair.names)


def _each_beside_the_other(task: _Task, found: Found) -> Found | None:
    """The same with the first effect as it shows beside the second, where it does not show alone; None if not there."""
    first, second = found.accepted[:2]
    look = found.looks[0]
    alone = look.of(first.id)
    if alone.family_p_value <= LEVEL:
        return found
    fit = fit_models([task.model_of(task.session, [second])]).fits[0]
    left = [c for c in task.candidates if c.effect is not second]
    beside = look_at(fit, left, task.structures, task.rng, task.sets, pairs=False).of(first.id)
    if beside.family_p_value > LATER_LEVEL:
        return None
    shown = replace(
        alone,
        p_value=beside.p_value,
        log_p_value=beside.log_p_value,
        family_p_value=beside.family_p_value,
        probability=beside.probability,
    )
    ranked = tuple(shown if r is alone else r for r in look.ranked)
    return replace(found, looks=(replace(look, ranked=ranked), *found.looks[1:]))


def _stands(found: Found) -> bool:
    return not _contradicted(found) and not left_over(found)


def left_over(found: Found) -> bool:
    """Whether so much is left that the accepted effects, if there are any, are not the cause."""
    look = found.looks[-1]
    if still_fails(found.looks):
        return True
    first, last = found.looks[0].fit.solution.chi_square, look.fit.solution.chi_square
    left = look.structure[0].share * last if look.structure else 0.0
    if not found.accepted:
        return left > 0
    most = rules_of(look.fit.model.observations.session.method).left_over
    return left > most * (first - last + left)


def still_fails(looks: Sequence[Look]) -> bool:
    """Whether the model fails by much more than any spread that is usual, and what was found hardly changes that.

    Repeats that scatter as much as all readings speak for a declared uncertainty that is too small instead. Deviations
    that are read directly scatter as the part or the axis does, which nobody declares.

    Args:
        looks: at the first model and after every effect found, if there are any.
    """
    first, last = looks[0].fit, looks[-1].fit
    joint = last.joint
    if rules_of(last.model.observations.session.method).side_by_side or looks[-1].noisy:
        return False
    if joint.reduced_chi_square < _GROSS or joint.p_value > _GROSS_LEVEL:
        return False
    excess = first.solution.chi_square - first.solution.degrees_of_freedom
    return first.solution.chi_square - last.solution.chi_square < _MOST_OF_IT * excess


def _one_after_the_other(
    task: _Task,
    excluded: dict[str, str],
    start: Look | None = None,
    *,
    first: Collection[str] = (),
    last: Collection[str] = (),
    granted: bool = False,
) -> Found:
    """The rounds, with some effects taken before all others, or only if there is no other.

    Args:
        task: what stays the same.
        excluded: effects that could not be looked for.
        start: the look at the first model, where it was taken already.
        first: effects that are taken before all others.
        last: effects that are taken only if there is no other.
        granted: whether one of the first is taken in the first round also where it is not significant by itself.
    """
    rules = rules_of(task.session.method)
    fit, excluded = task.fit, dict(excluded)
    candidates = [c for c in task.candidates if c.name not in excluded]
    looks: list[Look] = []
    accepted: list[Effect] = []
    alike: set[str] = set()
    while True:
        what = f"round {len(looks) + 1}: {len(candidates)} effects, {task.sets} simulated sets"
        task.progress(what, min((len(looks) + 0.2) / (ROUNDS + 1), 0.9))
        left = [c for c in candidates if c.effect not in accepted and c.name not in alike]
        pairs = not looks and not rules.side_by_side
        looks.append(start or look_at(fit, left, task.structures, task.rng, task.sets, pairs=pairs))
        start = None
        level = LATER_LEVEL if accepted and not rules.side_by_side else LEVEL
        winner = looks[-1].winner(first, last, level=level, granted=granted and not accepted)
        rounds = sum(rules.tier(effect.id) == len(rules.order) for effect in accepted)
        if winner is None or rounds == ROUNDS:
            return Found(tuple(looks), tuple(accepted), excluded)
        effect = winner.candidate.effect
        assert effect is not None
        try:
            wider = _settled(fit_models([task.model_of(task.session, [*accepted, effect])]).fits[0])
            if not rules.side_by_side:
                _hold(fit, wider)
        except ModelError as error:
            # Together with it the data no longer determines the rest: nothing can be said of it.
            excluded[effect.id] = str(error)
            candidates = [c for c in candidates if c.effect is not effect]
            looks.pop()
            continue
        fit = wider
        accepted.append(effect)
        # What cannot be told from it would only take up what its linearisation leaves; what contains it may still have
        # more to say.
        groups = (group for group in looks[-1].groups if effect.id in group)
        alike |= {name for group in groups for name in group if effect.id not in _contained(name, candidates)}


def _contained(name: str, candidates: Sequence[Candidate]) -> tuple[str, ...]:
    """Ids of the simpler effects that a candidate contains."""
    return next((c.effect.contains for c in candidates if c.name == name and c.effect is not None), ())


def _contradicted(found: Found) -> bool:
    """Whether a structure that the accepted effects do not depend on does better: that means another cause."""
    if not found.accepted:
        return False
    own = {name for effect in found.accepted for name in effect.covariates or effect.needs}
    foreign = max((g for name, g in found.looks[0].structure_gains.items() if name not in own), default=-np.inf)
    if len(found.accepted) == 1:
        return bool(foreign >= _ONE * _gain(found) + _MARGIN)
    return bool(foreign >= _SEVERAL * _gain(found))


def _gain(found: Found) -> float:
    """By how much the information criterion fell with the accepted effects."""
    gains = [look.of(effect.id).bic_gain for look, effect in zip(found.looks, found.accepted, strict=False)]
    pair = found.looks[0].pair
    if pair is not None:
        # Each of two may hide the other until it is in the model.
        both = pair.others.get(frozenset(effect.id for effect in found.accepted[:2]), -np.inf)
        gains[:2] = [max(sum(gains[:2]), both)]
    return float(sum(gains))


def _needless(found: Found) -> str | None:
    """The effect that the later ones have made superfluous: what it explained they explain better."""
    fit = found.looks[-1].fit
    worst, chance = None, _NEEDLESS
    first = len(fit.model.own)
    for term in fit.model.terms:
        mine = np.arange(first, first + len(term.parameters))
        first += len(term.parameters)
        mine = mine[fit.determined[mine]]
        if not len(mine) or all(effect.id != term.name for effect in found.accepted[:-1]):
            continue
        inner = fit.solution.covariance[np.ix_(fit.places[mine], fit.places[mine])]
        squares = float(fit.theta[mine] @ np.linalg.pinv(inner, rcond=1e-10, hermitian=True) @ fit.theta[mine])
        p = float(stats.chi2.sf(squares / fit.joint.reduced_chi_square, len(mine)))
        if p > chance:
            worst, chance = term.name, p
    return worst


def _settled(fit: Fit) -> Fit:
    """The fit, if the iteration came to rest.

    Raises:
        ModelError: it did not: the unknowns are so nearly interchangeable that no step is small.
    """
    squares = float(np.sum((fit.residuals / fit.model.sigma) ** 2))
    expected = fit.solution.chi_square
    if abs(squares - expected) > max(1.0, 0.02 * expected) and fit.joint.assembly.problem.priors is None:
        raise ModelError("together with the model's own unknowns the data does not determine it")
    return fit


def _hold(fit: Fit, wider: Fit) -> None:
    """Nothing, if the map is still worth something with another effect in the model.

    Raises:
        ModelError: its uncertainty has grown beyond all use.
    """
    before, after = fit.model.error_map(fit).content, wider.model.error_map(wider).content
    growth = 1.0
    for name in (name for name in before if _OF_THE_MACHINE.fullmatch(name) and name in after):
        old, new = (np.asarray(content[name], dtype=float) for content in (before, after))
        both = np.isfinite(old) & np.isfinite(new) & (old > 0)
        if both.any():
            growth = max(growth, float(np.sqrt(np.mean(new[both] ** 2) / np.mean(old[both] ** 2))))
    if growth > _SPOILT:
        raise ModelError(
            "together with it the data no longer determines the machine's errors: their uncertainty would grow "
            f"{growth:.0f} times"
        )
