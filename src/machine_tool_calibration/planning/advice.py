"""What to measure next: to tell look-alikes apart, and to see what this measurement could not show."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from machine_tool_calibration.diagnosis.diagnose import Diagnosis, Look
from machine_tool_calibration.diagnosis.power import noncentrality
from machine_tool_calibration.diagnosis.ranking import Ranked
from machine_tool_calibration.effects.catalogue import catalogue
from machine_tool_calibration.effects.effect import Effect
from machine_tool_calibration.errors import CalibrationError
from machine_tool_calibration.planning.option import Option
from machine_tool_calibration.planning.options import further_options
from machine_tool_calibration.planning.sensing import Assumed, Sensed, sense
from machine_tool_calibration.session.session import Session

__all__ = ["ALIKE", "Advice", "Separation", "Visibility", "alias_groups_of", "what_to_measure"]

ALIKE = 0.9
"""Cosine from which two effects count as look-alikes."""
_TOLD_APART = 0.8
# Cosines closer than this are equally good: the quicker measurement is proposed.
_EQUAL = 0.05
# Share of its norm outside the model below which an effect is hardly visible.
_HARDLY = 0.1
# A measurement is worth proposing for an effect if it shows one this much smaller.
_WORTH = 0.5
_LEVEL = 0.03
_MANY = 3
_NOTHING = "none of the further measurements that were considered tells them apart"


@dataclass(frozen=True)
class Separation:
    """How to tell look-alikes apart.

    Attributes:
        effects: the group, the most probable first.
        kind: of the measurement; None if none of those tried does it.
        measure: what to measure, in words.
        cosine_before: largest cosine between the first and the others now.
        cosine_after: the same with the further measurement.
        apart_before: least norm by which the readings differ between the first effect, at its fitted size, and the
            nearest of the others, in standard uncertainties, now.
        apart_after: the same with the further measurement.
        seconds: its time at the session's own pace; None without a time column.
        aside: what comes on top of that time, in words.
    """

    effects: tuple[str, ...]
    kind: str | None
    measure: str
    cosine_before: float
    cosine_after: float
    apart_before: float
    apart_after: float
    seconds: float | None
    aside: str = ""

    @property
    def separates(self) -> bool:
        """Whether they would no longer look alike."""
        return self.cosine_after < ALIKE


@dataclass(frozen=True)
class Visibility:
    """How to see an effect that hardly shows, or not at all.

    Attributes:
        effect: its id.
        coefficient: the name of that coefficient which is seen best.
        unit: its unit.
        before: its smallest detectable size now; None if the model absorbs it.
        after: the same with the further measurement.
        kind: of the measurement.
        measure: what to measure, in words.
        seconds: its time.
        aside: what comes on top of it, in words.
    """

    effect: str
    coefficient: str
    unit: str
    before: float | None
    after: float
    kind: str
    measure: str
    seconds: float | None
    aside: str = ""


@dataclass(frozen=True)
class Advice:
    """What to measure next."""

    separations: tuple[Separation, ...] = ()
    visibilities: tuple[Visibility, ...] = ()


def alias_groups_of(diagnosis: Diagnosis) -> list[tuple[tuple[str, ...], tuple[str, ...]]]:
    """Groups of effects that this data cannot tell apart, and the accepted effects beside which they are alike.

    First the groups of the accepted effects, as they were when each was found; then the rest, with all accepted.
    """
    out: list[tuple[tuple[str, ...], tuple[str, ...]]] = []
    accepted = diagnosis.accepted
    for k, name in enumerate(accepted):
        out += [(_led(group, name), accepted[:k]) for group in diagnosis.looks[k].groups if name in group]
    seen = {frozenset(group) for group, _ in out}
    last = diagnosis.looks[len(accepted)]
    out += [(group, accepted) for group in last.groups if frozenset(group) not in seen]
    return out


def _led(group: Sequence[str], name: str) -> tuple[str, ...]:
    return (name, *(other for other in group if other != name))


def what_to_measure(
    diagnosis: Diagnosis,
    *,
    model: str | None = None,
    own: Sequence[Effect] = (),
    progress: Callable[[str, float], None] = lambda what, share: None,
) -> Advice:
    """Try further measurements that the user can make, on paper, and propose the best.

    Every proposal is added to the session as readings without values; what they sense of each effect outside the
    model's freedom follows from geometry alone.

    Args:
        diagnosis: what looks alike, and how large.
        model: the method's model that was diagnosed.
        own: the user's own effects.
        progress: told what is being done and the share that is finished.
    """
    groups = alias_groups_of(diagnosis)
    assumed = _assumed(diagnosis)
    present = _present(diagnosis, own)
    session = diagnosis.session

    def tried(option: Option) -> Sensed | None:
        try:
            return sense(
                option.session,
                list(assumed.values()),
                model=model,
                present=present,
                first_row=option.first_row,
                turned=option.turned,
            )
        except (CalibrationError, np.linalg.LinAlgError):
            return None

    try:
        now = sense(session, list(assumed.values()), model=model, present=present)
    except (CalibrationError, np.linalg.LinAlgError):
        return Advice()
    seen: list[tuple[Option, Sensed]] = []
    options = further_options(session)
    for k, option in enumerate(options):
        progress("what to measure next", k / len(options))
        found = tried(option)
        if found is not None:
            seen.append((option, found))
    separations = []
    for group, given in groups:
        separation = _separation(group, now.beside(given), [(o, s.beside(given)) for o, s in seen])
        if separation is not None:
            separations.append(_cheaper(separation, session, given, tried))
    given = diagnosis.accepted
    visibilities = _visibilities(
        diagnosis, now.beside(given), [(o, s.beside(given)) for o, s in seen], assumed
    )
    return Advice(tuple(separations), tuple(visibilities))


def _assumed(diagnosis: Diagnosis) -> dict[str, Assumed]:
    """Every candidate with the coefficients of the look that it was found in, or of the last one."""
    out: dict[str, Assumed] = {}
    looks: list[Look] = [diagnosis.looks[0], diagnosis.looks[len(diagnosis.accepted)]]
    for look in looks:
        for r in look.ranked:
            out[r.candidate.name] = _as_found(r)
    for look, name in zip(diagnosis.looks, diagnosis.accepted, strict=False):
        out[name] = next(_as_found(r) for r in look.ranked if r.candidate.name == name)
    return out


def _as_found(ranked: Ranked) -> Assumed:
    effect = ranked.candidate.effect
    assert effect is not None
    names = [size.coefficient.name for size in ranked.sizes]
    return Assumed(effect, ranked.shape, dict(zip(names, ranked.signal.tolist(), strict=False)))


def _present(diagnosis: Diagnosis, own: Sequence[Effect]) -> list[Assumed]:
    """Effects that were in the model from the start, as it holds them."""
    fit = diagnosis.looks[0].fit
    known = catalogue(own)
    values = {p.name: float(p.reference + v) for p, v in zip(fit.model.parameters, fit.theta, strict=True)}
    out = []
    for term in fit.model.terms:
        names = {p.name for p in term.parameters}
        if term.name not in known or not all(name.startswith(f"{term.name}.") for name in names):
            continue
        effect = known[term.name]
        shape = tuple(values.get(f"{effect.id}.{s.name}", np.nan) for s in effect.shapes)
        if not np.isfinite(shape).all():
            shape = next(
                (
                    tried
                    for tried in effect.shape_grid(fit.model.observations)
                    if {f"{effect.id}.{c.name}" for c in effect.coefficients_for(fit.model.observations, tried)} == names
                ),
                (),
            )
        if len(shape) == len(effect.shapes):
            out.append(Assumed(effect, shape, {}))
    return out


def _separation(
    group: tuple[str, ...], now: Sensed, seen: Sequence[tuple[Option, Sensed]]
) -> Separation | None:
    group = tuple(name for name in group if name in now.place)
    if len(group) < 2:
        return None
    before, apart = _alike(group, now), _apart(group, now)
    tries = [
        (_alike(group, sensed), option.effort, k)
        for k, (option, sensed) in enumerate(seen)
        if all(name in sensed.place for name in group)
    ]
    if not tries:
        return Separation(group, None, _NOTHING, before, before, apart, apart, None)
    least = min(cosine for cosine, _, _ in tries)
    good = [t for t in tries if t[0] <= max(least + _EQUAL, min(_TOLD_APART / 2, before))]
    # Among equals the quickest, and of these the simplest.
    cosine, _, k = min(good, key=lambda t: (t[1], t[2]))
    option, sensed = seen[k]
    if cosine >= ALIKE or cosine > before - _EQUAL:
        words = _NOTHING
        return Separation(group, None, words, before, cosine, apart, _apart(group, sensed), None)
    return Separation(
        group, option.kind, option.words, before, cosine, apart, _apart(group, sensed), option.seconds, option.aside
    )


def _cheaper(
    separation: Separation, session: Session, given: Sequence[str], tried: Callable[[Option], Sensed | None]
) -> Separation:
    """The same measurement in one setup only, where that is enough."""
    used = np.unique(session.readings.setup)
    if separation.kind in (None, "station", "index") or len(used) < 2 or separation.cosine_after > _TOLD_APART:
        return separation
    for option in further_options(session, [int(used[0])]):
        if option.kind != separation.kind:
            continue
        sensed = tried(option)
        if sensed is None or not all(name in sensed.place for name in separation.effects):
            continue
        sensed = sensed.beside(given)
        cosine = _alike(separation.effects, sensed)
        if cosine <= _TOLD_APART:
            return Separation(
                separation.effects,
                option.kind,
                option.words,
                separation.cosine_before,
                cosine,
                separation.apart_before,
                _apart(separation.effects, sensed),
                option.seconds,
                option.aside,
            )
    return separation


def _alike(group: Sequence[str], sensed: Sensed) -> float:
    head = group[0]
    return max(max(sensed.cosine(head, other), sensed.cosine(other, head)) for other in group[1:])


def _apart(group: Sequence[str], sensed: Sensed) -> float:
    return min(sensed.apart(group[0], other) for other in group[1:])


def _visibilities(
    diagnosis: Diagnosis, now: Sensed, seen: Sequence[tuple[Option, Sensed]], assumed: Mapping[str, Assumed]
) -> list[Visibility]:
    """For effects that hardly show or not at all: the measurement that shows the smallest size of them."""
    look = diagnosis.looks[len(diagnosis.accepted)]
    searched = max(sum(1 for r in look.ranked if r.rank), 1)
    variance = max(look.fit.joint.reduced_chi_square, 1e-12)
    out = []
    for r in look.ranked:
        name = r.candidate.name
        if name not in now.place or (r.rank and now.share(name) > _HARDLY):
            continue
        coefficients = assumed[name].effect.coefficients_for(look.fit.model.observations, assumed[name].shape)
        before = now.information(name)
        if len(coefficients) > _MANY:
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
        needed = noncentrality(max(r.rank, 1), _LEVEL / searched) * variance
        smallest = look.detectable.get(name, {}).get(coefficients[k].name)
        if smallest is not None and before[k] > 0:
            needed = smallest**2 * float(before[k])
        after_size = float(np.sqrt(needed / information))
        possible = max(abs(coefficients[k].low), abs(coefficients[k].high))
        if after_size > possible or (smallest is not None and after_size > _WORTH * smallest):
            continue
        unit, words = coefficients[k].unit, option.words
        out.append(
            Visibility(
                name, coefficients[k].name, unit, smallest, after_size, option.kind, words, option.seconds, option.aside
            )
        )
    return out
