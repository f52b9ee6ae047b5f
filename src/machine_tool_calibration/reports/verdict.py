# SPDX-License-Identifier: Apache-2.0
"""The verdict in sentences."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np

from machine_tool_calibration.arrays import rms
from machine_tool_calibration.diagnosis.consequence import Consequence
from machine_tool_calibration.diagnosis.diagnose import Diagnosis
from machine_tool_calibration.diagnosis.search.effect_search import Structure
from machine_tool_calibration.estimation import priors
from machine_tool_calibration.planning.advice import Advice, Separation
from machine_tool_calibration.reports.comparison import stand_out
from machine_tool_calibration.reports.goodness import fits
from machine_tool_calibration.reports.quantities import (
    p_value,
    probability,
    quantity,
    reproducibility_words,
    residual_change,
    rounded,
    sizes_in_words,
)
from machine_tool_calibration.reports.signs import negative_words
from machine_tool_calibration.residuals.pool import Pool
from machine_tool_calibration.session.catalogue import spec_of
from machine_tool_calibration.session.checks.suspicion import suspicions
from machine_tool_calibration.session.session import Session

__all__ = [
    "AS_GOOD",
    "good_enough",
    "left_words",
    "mounted_more_than_once",
    "next_step",
    "only_reversal",
    "verdict_line",
    "verdict_words",
]

_MANY = 3
# Standard uncertainties between confounded effects from which the readings distinguish them all the same.
_APART = 6.0
AS_GOOD = 0.1
"""Probability of another effect from which it is told beside those found."""
# Scatter of repeats over that of all, below which places differ more than their repeats.
_SHARED = 0.7


def verdict_words(
    diagnosis: Diagnosis, changes: Mapping[str, Consequence], advice: Advice, *, brief: bool = False
) -> Iterator[str]:
    """Paragraphs: the verdict, every effect found, and what the data does not determine.

    Args:
        diagnosis: what was found.
        changes: what candidates change, by id.
        advice: what to measure next.
        brief: whether only what decides is wanted; the effects are then in a table.
    """
    yield _verdict(diagnosis)
    yield from left_words(diagnosis)
    yield from (f"Suspicious: {words}" for words in suspicions(diagnosis.chosen.sessions, diagnosis.chosen.labels))
    if not brief:
        for name in diagnosis.accepted:
            yield _found(diagnosis, name, changes.get(name), advice)
    yield from negative_words(diagnosis.fits[-1], diagnosis.accepted)
    for name, why in diagnosis.refused.items():
        p = probability(diagnosis.search.of(name).probability)
        yield f"{_title(diagnosis, name)} is probable ({p}) and not added: {why}."
    if diagnosis.verdict == "unexplained":
        yield from _unexplained(diagnosis)
    if brief:
        yield from _noise(diagnosis)
        return
    if diagnosis.outliers and diagnosis.verdict != "outliers":
        n = len(diagnosis.outliers)
        yield f"{'One reading was' if n == 1 else f'{n} readings were'} set aside before, as outliers: see below."
    yield from reproducibility_words([size.document() for size in diagnosis.fits[-1].marginal.sizes])
    yield from _noise(diagnosis)


def verdict_line(diagnosis: Diagnosis) -> str:
    """The verdict in one line."""
    if diagnosis.verdict == "missing_effect":
        found = ((name, probability(diagnosis.search.of(name).probability)) for name in diagnosis.accepted)
        return f"missing: {', '.join(f'{name} (probability {p})' for name, p in found)}"
    if diagnosis.verdict == "outliers":
        return f"no effect is missing; {stand_out(len(diagnosis.outliers))}"
    if diagnosis.verdict == "adequate":
        return "nothing is missing that these readings show"
    return "something is missing that no effect of the catalogue explains"


def good_enough(diagnosis: Diagnosis) -> bool:
    """Whether the model lacks something for sure that is too small to matter."""
    look, sound = diagnosis.search, diagnosis.verdict in ("adequate", "outliers")
    return sound and (look.unknown > priors.ACCEPTED or look.nothing < 1.0 - priors.SURE)


def left_words(diagnosis: Diagnosis) -> Iterator[str]:
    """What to make of structure that is left where nothing is missing: one sentence."""
    if good_enough(diagnosis):
        yield (
            "Structure is left in the residuals, small beside the declared uncertainty of a reading or in what it does "
            "to the map: the model is good enough without it."
        )
    elif diagnosis.search.left and diagnosis.verdict in ("adequate", "outliers"):
        yield "Whether the structure that seems to be left in the residuals is more than chance is not sure."


def _verdict(diagnosis: Diagnosis) -> str:
    look, declared = diagnosis.search, quantity(diagnosis.noise.declared, "m")
    residual = f"{quantity(rms(Pool(diagnosis.fits[0]).residuals), 'm')} RMS (declared uncertainty {declared})"
    if diagnosis.verdict == "missing_effect":
        names = [_title(diagnosis, name) for name in diagnosis.accepted]
        what = names[0] if len(names) == 1 else f"{len(names)} effects: {', '.join(names)}"
        if only_reversal(diagnosis):
            return (
                f"The axis has a reversal error: {what}. It is part of the result (ISO 230-2), no fault of the model."
            )
        return f"The model lacks {what}."
    if diagnosis.verdict == "unexplained" and look.unknown < 1.0 - look.nothing - look.unknown:
        return (
            f"Something is missing (probability {probability(1.0 - look.nothing)}), and these readings do not "
            "determine which effect it is: none is named as the cause."
        )
    if diagnosis.verdict == "unexplained":
        return "The model lacks something that no effect of the catalogue explains. No effect is named as the cause."
    if diagnosis.verdict == "outliers":
        n, shown = len(diagnosis.outliers), "matters" if good_enough(diagnosis) else "this measurement could show"
        many = "One reading does" if n == 1 else f"{n} readings do"
        return (
            f"{many} not belong to the rest: single, large deviations that do not repeat, as a chip or a broken beam "
            f"makes them. Without them nothing is missing that {shown}; the residual is {residual}."
        )
    if diagnosis.likely:
        return f"No effect is sure: the residual is {residual}. {_likeliest(diagnosis)}"
    if spec_of(diagnosis.chosen.sessions[0]).reads_machine and fits(look.fit.p_value) == "bad":
        return f"No effect and no pattern stands out from the scatter of the deviations: the residual is {residual}."
    if good_enough(diagnosis):
        return f"Nothing is missing that matters: the residual is {residual}."
    return (
        f"Nothing is missing that this measurement could show (probability {probability(look.nothing)}): the residual "
        f"is {residual}."
    )


def only_reversal(diagnosis: Diagnosis) -> bool:
    """Whether nothing is missing but the reversal of axes that were run both ways by ISO 230-2, which reports it."""
    axes = {str(run["axis"]).lower() for run in diagnosis.fitted[0].error_map.content.get("iso230_2", ())}
    return set(diagnosis.accepted) <= {f"{kind}_{axis}" for kind in ("backlash", "lost_motion") for axis in axes}


def next_step(diagnosis: Diagnosis, advice: Advice) -> str:
    """What to do next: one sentence or two."""
    told = next((s for s in advice.separations if s.kind is not None), None)
    if diagnosis.accepted or diagnosis.verdict == "outliers":
        what = " and ".join(diagnosis.accepted) if diagnosis.accepted else "what does not belong to the rest"
        text = f"Next: `mtcal improve` {'adds' if diagnosis.accepted else 'sets aside'} {what} and looks again."
        mine = next((s for s in advice.separations if s.effects[0] in diagnosis.accepted), None)
        rival = mine is not None and (
            mine.apart_before < _APART
            or max(diagnosis.search.of(name).probability for name in mine.effects[1:]) > AS_GOOD
        )
        if mine is not None and rival:
            sure = mine.measure if mine.kind is not None else "no further measurement that was considered does"
            text += f" To distinguish it from {' or '.join(mine.effects[1:])}: {sure}."
        return text
    if diagnosis.likely and told is not None:
        return f"Next, to distinguish {' and '.join(told.effects)}: {told.measure}."
    if diagnosis.verdict == "unexplained":
        return (
            "Next: `mtcal compare -o FOLDER` draws where the residuals are; a law of your own can be tried as a "
            "formula (--effects-file)."
        )
    best = advice.dominant.remedies[0] if advice.dominant is not None and advice.dominant.remedies else None
    if best is None:
        return "Next: nothing is needed; more repeats make the uncertainty smaller."
    return f"Next, for a smaller uncertainty of the map: {best.measure}."


def _likeliest(diagnosis: Diagnosis) -> str:
    found = [f"{name} ({probability(diagnosis.search.of(name).probability)})" for name in diagnosis.likely]
    return f"Likely, with the probability that it is missing: {', '.join(found)}."


def _title(diagnosis: Diagnosis, name: str) -> str:
    effect = diagnosis.search.of(name).candidate.effect
    return f"{effect.title} ({name})" if effect is not None else name


def _found(diagnosis: Diagnosis, name: str, change: Consequence | None, advice: Advice) -> str:
    found = diagnosis.search.of(name)
    effect = found.candidate.effect
    words = [f"{name}: {effect.formula}." if effect is not None else f"{name}."]
    if change is not None:
        if 0 < len(change.parameters) <= _MANY:
            words.append(f"Its size is {sizes_in_words(change.parameters)} (k = 2).")
        elif change.parameters:
            words.append(f"Its size is that of {len(change.parameters)} coefficients, listed below.")
        if change.signal is not None:
            words.append(
                f"It changes the readings by {quantity(rms(change.signal), 'm')} RMS, "
                f"{quantity(float(np.abs(change.signal).max(initial=0.0)), 'm')} at most."
            )
        moved = ""
        if change.map_change_rms is not None:
            moved = f", and the errors at the tool point move by {quantity(change.map_change_rms, 'm')} RMS"
        words.append(f"With it in the model {residual_change(change.rms_before, change.rms_after)}{moved}.")
    words.append(f"The probability that it is missing is {probability(found.probability)}.")
    predicted = diagnosis.predicted.get(name, ())
    if predicted:
        shares = ", ".join(f"{p.what} {100 * p.gain:+.0f} %" for p in predicted)
        words.append(f"Cross-validation: readings left out are predicted better (mean square error less by: {shares}).")
    if not found.plausible:
        words.append("Such a size does not usually occur: look for another cause as well.")
    separation = next((s for s in advice.separations if s.effects[0] == name), None)
    if separation is not None:
        rivals = [diagnosis.search.of(other).probability for other in separation.effects[1:]]
        words.append(_lookalike(separation, max(rivals, default=0.0) > 0.1 * found.probability))
    return " ".join(words)


def _lookalike(separation: Separation, as_good: bool) -> str:
    """What to say of confounded effects, which may do as well with nonlinear coefficients of their own."""
    others = " or ".join(separation.effects[1:])
    if separation.apart_before >= _APART and not as_good:
        return (
            f"A similar effect, {others}, would leave nearly the same residuals, but at the size found the readings "
            f"distinguish them: the patterns differ by {separation.apart_before:.0f} standard uncertainties."
        )
    text = f"It may as well be {others}: this measurement cannot distinguish them."
    return f"{text} To distinguish them: {separation.measure}." if separation.kind is not None else text


def _unexplained(diagnosis: Diagnosis) -> Iterator[str]:
    left = diagnosis.search.structure
    if left:
        best = left[0]
        yield (
            f"The residuals depend on {_covariate(best)}: this takes up {100 * best.share:.0f} % of their sum of "
            f"squares ({p_value(best.p_value)})."
        )
    if diagnosis.contradicted:
        fit, repeats = diagnosis.fits[-1], diagnosis.noise.from_repeats
        text = f"The readings scatter {rounded(np.sqrt(fit.reduced_chi_square))} times as much as declared"
        yield f"{text}, repeats by {quantity(repeats, 'm')}." if repeats is not None else f"{text}."
    if diagnosis.likely:
        yield f"{_likeliest(diagnosis)} None of these accounts for the residuals."


def _covariate(structure: Structure) -> str:
    if structure.covariate == "place":
        return f"the place: {structure.shape}"
    shape = {"smooth": "in a smooth curve", "periodic": "in waves", "its sign": "by its sign"}
    return f"{structure.covariate}, {shape.get(structure.shape, structure.shape)}"


def _noise(diagnosis: Diagnosis) -> Iterator[str]:
    noise, joint = diagnosis.noise, diagnosis.fits[-1]
    ratio = float(np.sqrt(joint.reduced_chi_square))
    again = mounted_more_than_once(diagnosis.chosen.sessions[0])
    if spec_of(diagnosis.chosen.sessions[0]).reads_machine:
        yield from _scatter(diagnosis)
        return
    if diagnosis.verdict in ("adequate", "outliers", "missing_effect") and fits(joint.p_value) == "bad":
        text = f"The readings scatter {rounded(ratio)} times as much as declared, which noise does not explain."
        if noise.from_repeats is not None and diagnosis.noisy:
            repeats = quantity(noise.from_repeats, "m")
            text += f" Repeats scatter as much ({repeats}): the declared uncertainty is too small."
        elif again:
            text += " The rest is what does not reproduce, or the model in a way that no effect and no covariate shows."
        else:
            text += (
                " Whether that is the model or the reproducibility of the setups is not determined: none was measured "
                "again after being mounted again."
            )
        yield text


def _scatter(diagnosis: Diagnosis) -> Iterator[str]:
    """Scatter of direct deviations: a part's or an axis's own, which no instrument declares."""
    noise, fit = diagnosis.noise, diagnosis.fits[-1]
    declared = noise.declared
    found = float(np.sqrt(fit.reduced_chi_square)) * declared
    both = f"scatter {quantity(found, 'm')}, declared {quantity(declared, 'm')}"
    if fits(fit.p_value) == "bad":
        yield f"The deviations scatter more about the model than was declared ({both}): sizes and tests use it."
    elif fits(fit.p_value) == "too well":
        yield f"The deviations scatter less about the model than was declared ({both}): tests use what they scatter."
    else:
        yield f"The deviations scatter about the model as was declared ({both})."
    repeats = noise.from_repeats
    if repeats is not None and repeats < _SHARED * found and diagnosis.verdict != "unexplained":
        yield (
            f"Repeats of one place agree within {quantity(repeats, 'm')}, places differ from each other by more, "
            "without a pattern: that is the scatter of the part, or of the machine from place to place."
        )
    if diagnosis.verdict == "missing_effect" and diagnosis.search.left:
        best = diagnosis.search.left[0]
        yield (
            f"The residuals still depend on {_covariate(best)}: {100 * best.share:.0f} % of their sum of squares "
            f"({p_value(best.p_value)}), which no single effect of the catalogue explains. The effects that were "
            "found stay as they are beside it."
        )


def mounted_more_than_once(session: Session) -> bool:
    """Whether a setup was measured, left, and measured again."""
    setup = session.readings.setup
    if not len(setup):
        return False
    stretches = setup[np.r_[True, np.diff(setup) != 0]]
    return len(stretches) > len(np.unique(stretches))
