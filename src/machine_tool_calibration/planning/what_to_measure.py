# SPDX-License-Identifier: Apache-2.0
"""What to measure next: to distinguish confounded effects, and to detect what this measurement could not show."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from machine_tool_calibration.diagnosis.diagnose import Diagnosis
from machine_tool_calibration.effects.effect_terms import shape_of
from machine_tool_calibration.errors import CalibrationError
from machine_tool_calibration.estimation import priors
from machine_tool_calibration.estimation.reduction import single_blas
from machine_tool_calibration.methods.fitted import FitRequest
from machine_tool_calibration.model.effect_sizes import smallest_signal
from machine_tool_calibration.model.model import Kind
from machine_tool_calibration.planning.dominant import Dominant, limits_of, with_remedies
from machine_tool_calibration.planning.options import Option, Proposal, further_options
from machine_tool_calibration.planning.sensing import Sensed, SizedEffect, sense
from machine_tool_calibration.progress import Progress, untold
from machine_tool_calibration.words import together


@dataclass(frozen=True, kw_only=True)
class Separation(Proposal):
    """How to distinguish confounded effects."""

    effects: tuple[str, ...]  # the group, the most probable first
    cosine_before: float  # largest cosine between the first and the others now
    cosine_after: float  # the same with the further measurement
    # least norm by which the readings differ between the first effect, at its fitted size, and the nearest of the
    # others, in standard uncertainties, now
    apart_before: float
    apart_after: float  # the same with the further measurement

    @property
    def separates(self) -> bool:
        """Whether they would no longer look alike."""
        return self.kind is not None and self.cosine_after < priors.ALIKE


@dataclass(frozen=True, kw_only=True)
class Visibility(Proposal):
    """How to see an effect that hardly shows, or not at all."""

    effect: str  # its id
    coefficient: str  # the name of that coefficient which is seen best
    unit: str  # its unit
    before: float | None  # its smallest detectable size now; None if the model absorbs it
    after: float  # the same with the further measurement


@dataclass(frozen=True)
class Advice:
    """What to measure next."""

    separations: tuple[Separation, ...] = ()  # to distinguish confounded effects
    visibilities: tuple[Visibility, ...] = ()  # to see effects that hardly show
    dominant: Dominant | None = None  # what dominates the map's uncertainty; None where there is no map


def alias_groups_of(diagnosis: Diagnosis) -> list[tuple[str, ...]]:
    """Groups of effects that this data cannot distinguish, those of the accepted effects first and led by them."""
    accepted = diagnosis.accepted
    groups = [
        tuple(sorted(group, key=lambda name: accepted.index(name) if name in accepted else len(accepted)))
        for group in diagnosis.search.groups
    ]
    return sorted(groups, key=lambda group: group[0] not in accepted)


def assumed_effects(diagnosis: Diagnosis) -> dict[str, SizedEffect]:
    """Every candidate with the coefficients that were found."""
    out: dict[str, SizedEffect] = {}
    for found in diagnosis.search.findings:
        effect = found.candidate.effect
        assert effect is not None
        out[found.name] = SizedEffect(effect, found.shape, {size.coefficient.name: size.value for size in found.sizes})
    return out


def present_effects(diagnosis: Diagnosis) -> list[SizedEffect]:
    """Effects that were in the model from the start, as it holds them."""
    fit = diagnosis.fits[0].fits[0]
    known = diagnosis.chosen.known
    values = {p.name: float(p.reference + v) for p, v in zip(fit.model.parameters, fit.theta, strict=True)}
    terms = [t for t in fit.model.terms if t.name in known and all(p.kind is Kind.EFFECT for p in t.parameters)]
    shapes = (shape_of(known[term.name], term, fit.model.observations, values) for term in terms)
    return [SizedEffect(known[term.name], shape, {}) for term, shape in zip(terms, shapes, strict=True)]


_HARDLY = 0.1  # share of its norm outside the model below which an effect is hardly visible
_WORTH = 0.5  # a measurement is worth proposing for an effect if it shows one this much smaller
_MOST_COEFFICIENTS = 3  # of an effect for which a measurement is proposed


def visibilities(
    diagnosis: Diagnosis, now: Sensed, seen: Sequence[tuple[Option, Sensed]], assumed: Mapping[str, SizedEffect]
) -> list[Visibility]:
    """For effects that hardly show or not at all: the measurement that shows the smallest size of them."""
    fit = diagnosis.fits[-1]
    variance = max(fit.variance, 1e-12)
    every = [model.observations for model in fit.assembly.models]
    out = []
    for r in diagnosis.search.findings:
        name = r.name
        if name not in now.place or (r.rank and now.share(name) > _HARDLY):
            continue
        effect = assumed[name].effect
        observations = next(o for o in every if effect.why_not(o) is None)
        coefficients = effect.coefficients_for(observations, assumed[name].shape)
        before = now.information(name)
        if len(coefficients) > _MOST_COEFFICIENTS:
            continue
        best: tuple[float, Option, int] | None = None
        for option, sensed in seen:
            if name not in sensed.place:
                continue
            after = sensed.information(name)[: len(before)]
            k = int(np.argmax(after))
            # A measurement that is more trouble must be worth it.
            if after[k] > 0 and (best is None or after[k] > 1.3 * best[0]):
                best = (float(after[k]), option, k)
        if best is None:
            continue
        information, option, k = best
        # What is not shared has columns of its own in every session.
        coefficient = coefficients[k % len(coefficients)]
        possible = max(abs(coefficient.low), abs(coefficient.high))
        strength = np.array([information * (possible / 2.0) ** 2 / variance])
        needed = smallest_signal(strength, float(strength[0]), -np.log(priors.EFFECT)) ** 2 * variance
        smallest = r.detectable.get(coefficient.name)
        if smallest is not None and before[k] > 0:
            needed = smallest**2 * float(before[k])
        after_size = float(np.sqrt(needed / information))
        if after_size > possible or (smallest is not None and after_size > _WORTH * smallest):
            continue
        out.append(
            Visibility(
                effect=name, coefficient=coefficient.name, unit=coefficient.unit, before=smallest, after=after_size,
                **option.proposal,
            )
        )  # fmt: skip
    return out


# Cosines closer than this, or below the other, are equally good: the quicker measurement is proposed.
_EQUAL, _DIFFERENT = 0.05, 0.4
_NONE_DISTINGUISHES = "none of the further measurements that were considered distinguishes them"


@single_blas()
def what_to_measure(diagnosis: Diagnosis, progress: Progress = untold) -> Advice:
    """Try further measurements that the user can make, on paper, and propose the best.

    Each is added to the session as readings without values; what they sense of effects follows from geometry alone.
    """
    assumed, present = assumed_effects(diagnosis), present_effects(diagnosis)
    chosen, sessions, labels = diagnosis.chosen, diagnosis.chosen.sessions, diagnosis.chosen.labels
    scatter = max(float(np.sqrt(diagnosis.fits[-1].reduced_chi_square)), 1.0)
    limits = limits_of(sessions[0], chosen.base(sessions[0])[0], scatter) if len(sessions) == 1 else None
    improvable = limits if limits is not None and limits.cause != "readings" else None

    def sensed(subject: FitRequest, at: int = 0, **new: Any) -> Sensed | None:
        try:
            return sense(subject, list(assumed.values()), present=present, at=at, **new)
        except (CalibrationError, np.linalg.LinAlgError):
            return None

    if (now := sensed(chosen)) is None:
        return Advice(dominant=limits)
    options = [(k, option) for k, session in enumerate(sessions) for option in further_options(session)]
    seen = list[tuple[Option, Sensed]]()
    for number, (k, option) in enumerate(options):
        progress("what to measure next", number / len(options))
        further = chosen.instead(k, option.session)
        if (found := sensed(further, k, first_row=option.first_row, turned=option.turned)) is not None:
            named = option if labels is None else replace(option, measure=together((labels[k], option.measure), ": "))
            seen.append((named, found))
    separations = []
    for group in alias_groups_of(diagnosis):
        given = [name for name in diagnosis.accepted if name not in group]
        separation = _separation(group, now.beside(given), [(o, s.beside(given)) for o, s in seen])
        if separation is not None:
            separations.append(separation)
    others = diagnosis.accepted
    seldom = visibilities(diagnosis, now.beside(others), [(o, s.beside(others)) for o, s in seen], assumed)
    if improvable is not None:
        limits = with_remedies(improvable, [option for _, option in options], lambda own: chosen.base(own)[0])
    return Advice(tuple(separations), tuple(seldom), limits)


def _separation(group: tuple[str, ...], now: Sensed, seen: Sequence[tuple[Option, Sensed]]) -> Separation | None:
    group = tuple(name for name in group if name in now.place)
    if len(group) < 2:
        return None
    before, apart = _alike(group, now), _apart(group, now)
    tries = [
        (_alike(group, sensed), option.effort, k)
        for k, (option, sensed) in enumerate(seen)
        if all(name in sensed.place for name in group)
    ]
    found = Separation(
        kind=None, measure=_NONE_DISTINGUISHES, effects=group,
        cosine_before=before, cosine_after=before, apart_before=apart, apart_after=apart,
    )  # fmt: skip
    if not tries:
        return found
    least = min(cosine for cosine, _, _ in tries)
    good = [t for t in tries if t[0] <= max(least + _EQUAL, min(_DIFFERENT, before))]
    # Among equals the quickest, and of these the simplest.
    cosine, _, k = min(good, key=lambda t: (t[1], t[2]))
    option, sensed = seen[k]
    found = replace(found, cosine_after=cosine, apart_after=_apart(group, sensed))
    if cosine >= priors.ALIKE or cosine > before - _EQUAL:
        return found
    return replace(found, **option.proposal)


def _alike(group: Sequence[str], sensed: Sensed) -> float:
    head = group[0]
    return max(max(sensed.cosine(head, other), sensed.cosine(other, head)) for other in group[1:])


def _apart(group: Sequence[str], sensed: Sensed) -> float:
    return min(sensed.apart(group[0], other) for other in group[1:])
