# SPDX-License-Identifier: Apache-2.0
"""From what a diagnosis sets out: readings without gross errors, the first model, and what may be missing in it."""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from machine_tool_calibration.diagnosis.search.candidates import Candidate, effect_candidates, in_the_model
from machine_tool_calibration.diagnosis.search.effect_search import search_effects
from machine_tool_calibration.diagnosis.search.laws import with_laws
from machine_tool_calibration.diagnosis.search.structure import structure_candidates
from machine_tool_calibration.effects.effect_terms import add_effects
from machine_tool_calibration.errors import ModelError
from machine_tool_calibration.methods.fitted import FitRequest, FittedSessions, fit_sessions, refuse_impossible
from machine_tool_calibration.model.model import MethodModel
from machine_tool_calibration.progress import Progress
from machine_tool_calibration.residuals.averaged import mean_places
from machine_tool_calibration.residuals.gross_errors import Outlier, find_outliers, suspected_rows, without
from machine_tool_calibration.residuals.noise import Noise
from machine_tool_calibration.residuals.pool import Pool
from machine_tool_calibration.session.session import Session

Aside = tuple[tuple[Outlier, ...], ...]
"""Readings that were set aside, of each session."""


def without_gross_errors(chosen: FitRequest, added: Sequence[str]) -> tuple[FitRequest, Aside]:
    """What is chosen without the gross errors beside these effects, and these errors, session by session."""
    build = _alone(chosen, added)
    aside = tuple(tuple(find_outliers(one, build, lambda part: chosen.base(part)[0])) for one in chosen.sessions)
    return replace(chosen, sessions=tuple(map(without, chosen.sessions, aside))), aside


def without_suspects(chosen: FitRequest, progress: Progress) -> tuple[str, ...]:
    """Effects that are probable without all that may be wrong; none where nothing lies far out.

    Gross errors that an effect hides may in turn hide the effect, which shows among the other readings (masking).
    Laws are taken to hold exactly: what is found here is looked for again.
    """
    build = _alone(chosen, ())
    suspected = [suspected_rows(session, build) for session in chosen.sessions]
    if not any(map(len, suspected)):
        return ()
    each = zip(chosen.sessions, suspected, strict=True)
    sessions = tuple(session.without(np.isin(session.readings.row, rows)) for session, rows in each)
    progress("effects without what lies far out", 0.1)
    try:
        _, first, _ = first_model(replace(chosen, sessions=sessions))
        pool = with_laws(first.joint, chosen.present)
        candidates, present = candidates_of(chosen, first)[0], in_the_model(pool, chosen.present)
        return search_effects(pool, candidates, structure_candidates(pool), exact_laws=True, present=present).accepted
    except ModelError:
        # What is left does not allow the model: then it says nothing of what is missing.
        return ()


def _alone(chosen: FitRequest, added: Sequence[str]) -> Callable[[Session], MethodModel]:
    """The model of a session by itself beside further effects."""
    several = len(chosen.sessions) > 1
    present = [*chosen.present, *(effect for effect in chosen.absent if effect.id in added)]

    def build(session: Session) -> MethodModel:
        base = chosen.base(session)[0]
        # One of several has those effects that can act in it.
        return add_effects(base, [e for e in present if not several or e.why_not(base.observations) is None])

    return build


def first_model(chosen: FitRequest) -> tuple[FitRequest, FittedSessions, Noise | None]:
    """What is searched, its fit, and where places that were measured repeatedly have their means, what repeats say."""
    chosen = replace(chosen, alternatives={})  # what is in the model is taken for what it is
    first = fit_sessions(chosen)
    refuse_impossible(first)
    averaged = mean_places(first.joint.fits[0]) if len(chosen.sessions) == 1 else None
    if averaged is None:
        return chosen, first, None
    searched = replace(chosen, sessions=averaged[:1])
    return searched, fit_sessions(searched), averaged[1]


def candidates_of(chosen: FitRequest, first: FittedSessions) -> tuple[list[Candidate], dict[str, str]]:
    """Effects that may be missing, and why each of the others is not looked for."""
    # Error motions that the model holds as random functions, under names of their own.
    held = {t.name.rsplit(".", 1)[1] for model in first.joint.assembly.models for t in model.terms if "." in t.name}
    candidates, excluded = effect_candidates(Pool(first.joint), [e for e in chosen.absent if e.id not in held])
    excluded |= {e.id: "the model has it already, as a random function" for e in chosen.absent if e.id in held}
    return candidates, excluded
