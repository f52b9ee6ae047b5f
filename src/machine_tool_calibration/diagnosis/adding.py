# SPDX-License-Identifier: Apache-2.0
"""Which of the probable effects the model can take, and why it cannot take the others."""

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
from scipy import special

from machine_tool_calibration.arrays import rms
from machine_tool_calibration.diagnosis.search.candidates import Candidate
from machine_tool_calibration.diagnosis.search.effect_search import EffectSearch
from machine_tool_calibration.diagnosis.search.findings import occurs
from machine_tool_calibration.diagnosis.search.prediction import Prediction
from machine_tool_calibration.errors import ModelError
from machine_tool_calibration.estimation import priors
from machine_tool_calibration.methods.build import VAGUE
from machine_tool_calibration.methods.fitted import FittedSessions
from machine_tool_calibration.model.fit import JointFit
from machine_tool_calibration.model.model import Kind
from machine_tool_calibration.model.result import ErrorMap, effect_signal
from machine_tool_calibration.residuals.pool import Pool
from machine_tool_calibration.words import Said, say, together

# Uncertainties of the map that are those of the machine or the part, not of where the instrument stood.
_OF_THE_MACHINE = re.compile(r"(position_error|[xyz]|E[XYZABC][XYZABC]|workpiece_error|workpiece_form)_u")

# Reasons for which an effect is refused whose size may be zero, and that changes nothing.
_MAY_BE_ZERO = ("undetermined.no_size", "undetermined.no_size_beside")
_CHANGE_NOTHING = ("undetermined.no_size", "undetermined.explains_nothing", "undetermined.of_the_scatter")
# Share of an effect's squares that a single reading has at most, for its own leverage.
_MOST_OF_ONE = 0.999


class Added(NamedTuple):
    """What the model can take of the probable effects."""

    accepted: tuple[str, ...]  # those added, in this order
    fitted: tuple[FittedSessions, ...]  # the first model and one after every one of them
    refused: dict[str, str]  # by effect, why it is not what is missing
    impossible: dict[str, str]  # by effect, why the data does not allow it all the same


def add_probable(
    names: Sequence[str],
    search: EffectSearch,
    predicted: Mapping[str, Sequence[Prediction]],
    first: FittedSessions,
    fit_with: Callable[[tuple[str, ...]], FittedSessions],
    spurious: Mapping[str, str] = MappingProxyType({}),
    deferred: tuple[str, ...] = (),
) -> Added:
    """Those of some effects, the surest first, that can be added to the first model, and why the others cannot.

    What has no size of its own before the others are added is tried once more beside them, where less is left; what has
    none beside them was another effect, and is in `spurious`.
    """
    again = partial(add_probable, names, search, predicted, first, fit_with)
    fitted, accepted, refused, impossible = [first], list[str](), dict(spurious), dict[str, str]()
    order = [name for name in names if name not in (*spurious, *deferred)] + [n for n in deferred if n not in spurious]
    for name in order:
        against = [p.what for p in predicted.get(name, ()) if p.speaks_against]
        if not search.of(name).plausible:
            refused[name] = say("undetermined.no_such_size")
        elif against:
            refused[name] = say("undetermined.not_predicted", what=against[0])
        else:
            try:
                wider = fit_with((*accepted, name))
                _hold(fitted[-1].error_map, wider.error_map)
                late = _spurious(search, first.joint, (*accepted, name), fit_with)
            except ModelError as error:
                impossible[name] = str(error)
                continue
            if late:
                (one,) = late
                if one in deferred or name == order[-1]:
                    return again({**spurious, **late}, deferred)
                return again(spurious, (*deferred, one))
            if nothing := _changes_nothing(fitted[-1].joint, wider.joint, name, search.memory):
                refused[name] = nothing
                continue
            fitted.append(wider)
            accepted.append(name)
    # As certain as they are published, with the noise's memory: nothing is left to add that would seem to be one.
    unsure = [name for name in accepted if search.of(name).p_value > priors.NO_CHANCE]
    unsized = [name for name in unsure if not _sized(fitted[-1].joint, name, memory=True)]
    if unsized:
        one = _least_needed(unsized, accepted, fit_with)
        return again({**spurious, one: _no_size(accepted)}, deferred)
    return Added(tuple(accepted), tuple(fitted), refused, impossible)


def _changes_nothing(before: JointFit, after: JointFit, name: str, memory: float) -> Said | None:
    """Why an effect is none that changes the readings; None if it is one.

    It lowers the squares of so many readings that tell as much as one, random functions aside.
    """
    gain = before.without_random.solution.chi_square - after.without_random.solution.chi_square
    if gain < priors.LEAST_GAIN * memory * min(after.reduced_chi_square, 1.0):
        return say("undetermined.explains_nothing")
    return say("undetermined.of_the_scatter") if _is_of_the_scatter(before, after, name) else None


def _is_of_the_scatter(before: JointFit, after: JointFit, name: str) -> bool:
    """Whether readings scatter most where an effect changes most, and its size does not stand out of that.

    What the effect takes out of the residuals, d, is its column outside the model times its size. The variance of the
    sum of d y by the residuals e themselves, not by one scatter of all (White 1980; HC3 of MacKinnon and White 1985).
    """
    pool = Pool(after)
    d = (Pool(before).residuals - pool.residuals) / pool.sigma
    e, whole = pool.residuals / pool.sigma, float(d @ d)
    leverage = np.minimum(d**2 / max(whole, np.finfo(float).tiny), _MOST_OF_ONE)
    own, alike = float(np.sum((d * e / (1.0 - leverage)) ** 2)), whole * float(np.mean(e**2))
    if priors.OF_ONE_SCATTER * own <= alike:
        return False
    count = sum(p.kind is Kind.EFFECT and p.owner == name for p in after.assembly.parameters)
    return bool(special.chdtrc(count, whole**2 / own) > priors.OF_THE_SCATTER_P)


def _spurious(
    search: EffectSearch,
    before: JointFit,
    names: tuple[str, ...],
    fit_with: Callable[[tuple[str, ...]], FittedSessions],
) -> dict[str, str]:
    """Which of the effects is not what is missing, and why: one at most, as without it the others may be.

    Of those that have no size beside the others, or that decay and take each other back, it is the one that is needed
    least; else one that decays and explains less than a special case of it. The fit `before` has none of them.
    """
    after, last = fit_with(names).joint, names[-1]
    # Each by itself is of a size that occurs; two that nearly take each other back need not be.
    if len(names) > 1 and (huge := [name for name in names if not _occurs(after, name)]):
        return {_least_needed(huge, names, fit_with): say("undetermined.no_such_size")}
    decaying = [name for name in names if search.of(name).candidate.decays]
    # What no chance makes is there, though repeats leave room for a size of zero.
    sure = {last} if search.of(last).p_value <= priors.NO_CHANCE and last not in decaying else set[str]()
    unsized = [name for name in names if name not in sure and not _sized(after, name)]
    if unsized:
        return {_least_needed(unsized, names, fit_with): _no_size(names)}
    if not decaying:
        return {}
    # What each changes that the model does not absorb, and the residual.
    signals = np.array([effect_signal(after, name)[0] for name in decaying])
    *squares, left = np.diag(Pool(before).screen(signals).gram)
    multiple = [name for name, own in zip(decaying, squares, strict=True) if own > priors.TAKEN_BACK**2 * left]
    if multiple:
        return {_least_needed(multiple, names, fit_with): say("undetermined.taken_back")}
    known = {f.name for f in search.findings if f.rank}
    cases = {name: sorted(known.intersection(search.of(name).candidate.contains)) for name in decaying}
    instead = {
        (n, case): _chi_square(fit_with, (case if k == n else k for k in names)) for n in decaying for case in cases[n]
    }
    best = min(instead, key=lambda one: instead[one], default=None)
    if best is None or instead[best] >= after.solution.chi_square:
        return {}
    return {best[0]: say("undetermined.less_than_simpler", names=together(cases[best[0]], say("text.and")))}


def _occurs(fit: JointFit, name: str) -> bool:
    """Whether all coefficients of an effect in the model are of a size that occurs, as far as they are certain."""
    published = fit.published
    for k, own in enumerate(fit.assembly.parameters):
        if own.kind is Kind.EFFECT and own.owner == name and published.determined[k] and own.low is not None:
            value, u = own.reference + float(published.theta[k]), float(published.covariance[k, k]) ** 0.5
            if not occurs(value, u, own.low, own.high or 0.0):
                return False
    return True


def _no_size(names: Sequence[str]) -> Said:
    """Why an effect is not added whose size may be zero, beside the others among these."""
    return say("undetermined.no_size_beside" if len(names) > 1 else "undetermined.no_size")


def without_size(why: str) -> bool:
    """Whether an effect was refused as one that changes nothing: it is not what is missing."""
    return isinstance(why, Said) and why.key in _CHANGE_NOTHING


def zero_is_open(why: str | None) -> bool:
    """Whether an effect that is not added may be there: it was not refused, or as its size may be zero."""
    return why is None or (isinstance(why, Said) and why.key in _MAY_BE_ZERO)


def _chi_square(fit_with: Callable[[tuple[str, ...]], FittedSessions], names: Iterable[str]) -> float:
    return fit_with(tuple(names)).joint.solution.chi_square


def _least_needed(
    some: Sequence[str], names: Sequence[str], fit_with: Callable[[tuple[str, ...]], FittedSessions]
) -> str:
    """Of some of the effects in a model the one without which the others leave least."""
    return some[0] if len(some) == 1 else min(some, key=lambda k: _chi_square(fit_with, (n for n in names if n != k)))


def explain_nearly_all(
    names: Sequence[str], fitted: Sequence[FittedSessions], fit_with: Callable[[tuple[str, ...]], FittedSessions]
) -> bool:
    """Whether those of some effects that can be added explain nearly all that all of them explain together.

    The first model was `fitted`, and one after every effect that can be added.
    """
    try:
        every = fit_with(tuple(names)).joint.solution.chi_square
    except ModelError:
        return False
    first, rest = (one.joint.solution.chi_square for one in (fitted[0], fitted[-1]))
    return first - rest >= priors.NEARLY_ALL * (first - every)


def better_special_cases(
    candidate: Candidate, fit_with: Callable[[tuple[str, ...]], FittedSessions]
) -> tuple[str, ...]:
    """Special cases of an effect that explain more than it does, each by itself."""
    try:
        least = fit_with((candidate.name,)).joint.solution.chi_square
        return tuple(n for n in candidate.contains if fit_with((n,)).joint.solution.chi_square < least)
    except ModelError:
        return ()


def _sized(fit: JointFit, name: str, *, memory: bool = False) -> bool:
    """Whether the sizes of an effect, jointly, stand out of their uncertainty.

    Where they do not, its coefficients describe something else, in one place or at one moment. The noise's `memory`
    counts once all effects are added: what is left of those that are not would seem to be such.
    """
    published, marginal, every = fit.published, fit.marginal, enumerate(fit.assembly.parameters)
    own = [k for k, p in every if p.kind is Kind.EFFECT and p.owner == name and p.unit != "s"]
    own = [k for k in own if published.determined[k]]
    known = marginal.solution.covariance if memory else marginal.independent
    size, covariance = published.theta[own], marginal.scatter**2 * known[np.ix_(own, own)]
    squares = size @ np.linalg.pinv(covariance, hermitian=True) @ size
    return not own or bool(special.chdtrc(len(own), squares) <= special.chdtrc(1, priors.STANDS_OUT**2))


def _hold(before: ErrorMap, after: ErrorMap) -> None:
    """A ModelError if with another effect in the model some of the map is no longer determined, or not to any use."""
    lost, growth = 0, 1.0
    for name in filter(_OF_THE_MACHINE.fullmatch, before.content):
        old = np.asarray(before.content[name], dtype=float)
        new = np.asarray(after.content.get(name, np.full(old.shape, np.nan)), dtype=float)
        if new.shape == old.shape:
            # What is vague counts as determined only beside the scatter of what is missing.
            lost += int((np.isfinite(old) & (old < VAGUE) & ~np.isfinite(new)).sum())
            both = np.isfinite(old) & np.isfinite(new)
            old, new = old[both], new[both]
        # Otherwise places are there once for every state of the effect, such as either direction of approach.
        old, new = old[old > 0], new[new > 0]
        if old.size and new.size:
            growth = max(growth, rms(new) / rms(old))
    if lost:
        raise ModelError(f"together with it {lost} values of the map would no longer be determined")
    if growth > priors.SPOILT:
        raise ModelError(f"together with it the data would determine the machine's errors {growth:.0f} times worse")
