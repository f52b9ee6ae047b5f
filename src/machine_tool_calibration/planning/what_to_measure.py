"""What to measure next: to tell look-alikes apart, and to see what this measurement could not show."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from machine_tool_calibration.diagnosis.diagnose import Diagnosis
from machine_tool_calibration.effects.effect import Effect
from machine_tool_calibration.errors import CalibrationError
from machine_tool_calibration.estimation.reduction import single_blas
from machine_tool_calibration.planning.advice import ALIKE, Advice, Separation, alias_groups_of
from machine_tool_calibration.planning.assumptions import assumed_effects, present_effects
from machine_tool_calibration.planning.dominant import limits_of
from machine_tool_calibration.planning.option import Option
from machine_tool_calibration.planning.options import further_options
from machine_tool_calibration.planning.sensing import Sensed, sense
from machine_tool_calibration.planning.visible import visibilities
from machine_tool_calibration.session.session import Session

__all__ = ["what_to_measure"]

_TOLD_APART = 0.8
# Cosines closer than this are equally good: the quicker measurement is proposed.
_EQUAL = 0.05
_NOTHING = "none of the further measurements that were considered tells them apart"


@single_blas()
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
    if len(diagnosis.sessions) > 1:
        # What another session would tell depends on which: each is asked for by itself.
        return Advice()
    groups = alias_groups_of(diagnosis)
    assumed = assumed_effects(diagnosis)
    present = present_effects(diagnosis, own)
    session = diagnosis.session
    limits = limits_of(session, model)

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
        return Advice(dominant=limits)
    seen: list[tuple[Option, Sensed]] = []
    options = further_options(session)
    for k, option in enumerate(options):
        progress("what to measure next", k / len(options))
        found = tried(option)
        if found is not None:
            seen.append((option, found))
    separations = []
    for group in groups:
        given = [name for name in diagnosis.accepted if name not in group]
        separation = _separation(group, now.beside(given), [(o, s.beside(given)) for o, s in seen])
        if separation is not None:
            separations.append(_cheaper(separation, session, given, tried))
    others = diagnosis.accepted
    seldom = visibilities(diagnosis, now.beside(others), [(o, s.beside(others)) for o, s in seen], assumed)
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
