"""The verdict in sentences."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np

from machine_tool_calibration.diagnosis.consequence import Consequence, rms
from machine_tool_calibration.diagnosis.diagnose import Diagnosis
from machine_tool_calibration.diagnosis.look import Look, Structure
from machine_tool_calibration.diagnosis.quantities import probability, quantity, sizes_in_words
from machine_tool_calibration.diagnosis.ranking import Ranked
from machine_tool_calibration.diagnosis.rounds import still_fails
from machine_tool_calibration.planning.advice import Advice, Separation
from machine_tool_calibration.session.session import Session

__all__ = ["mounted_more_than_once", "verdict_words"]

# Chance below which residuals count as larger than declared.
_TOO_LARGE = 0.01
_MANY = 3
# Standard uncertainties between look-alikes from which the readings tell them apart all the same.
_APART = 6.0
# Chance below which a backlash of the impossible sign is no accident.
_REVERSED = 1e-6
# Difference of the information criterion from which one effect does clearly better than another.
_CLEARLY = 6.0
# Scatter of repeats over that of all, below which places differ more than their repeats.
_SHARED = 0.7


def verdict_words(diagnosis: Diagnosis, changes: Mapping[str, Consequence], advice: Advice) -> Iterator[str]:
    """Paragraphs: the verdict, every effect found, and what the data cannot tell."""
    yield _verdict(diagnosis)
    for name in diagnosis.accepted:
        yield _found(diagnosis, name, changes.get(name), advice)
    if diagnosis.verdict == "unexplained":
        yield from _unexplained(diagnosis)
    if diagnosis.outliers and diagnosis.verdict != "outliers":
        n = len(diagnosis.outliers)
        yield f"{'One reading was' if n == 1 else f'{n} readings were'} set aside before, as outliers: see below."
    yield from _reversed(diagnosis)
    yield from _noise(diagnosis)


def _reversed(diagnosis: Diagnosis) -> Iterator[str]:
    """Backlash that comes out negative and is certain: the sign of a column is wrong, not the machine."""
    for r in diagnosis.looks[-1].ranked:
        if r.rank and not r.possible and r.p_value < _REVERSED and r.candidate.name.startswith("backlash_"):
            axis = r.candidate.name[-1]
            yield (
                f"{r.candidate.name} would come out negative, which no backlash is: the sign of dir_{axis}, or that of "
                "the deviations, looks reversed."
            )


def _verdict(diagnosis: Diagnosis) -> str:
    first = diagnosis.looks[0].fit
    declared = quantity(diagnosis.noise.declared, "m")
    residual = f"{quantity(rms(first.residuals), 'm')} RMS (declared uncertainty {declared})"
    if diagnosis.verdict == "missing_effect":
        names = [_title(diagnosis, name) for name in diagnosis.accepted]
        what = names[0] if len(names) == 1 else f"{len(names)} effects: {', '.join(names)}"
        return f"The model lacks {what}."
    if diagnosis.verdict == "unexplained":
        return "The model lacks something that no effect of the catalogue explains. No effect is named as the cause."
    if diagnosis.verdict == "outliers":
        n = len(diagnosis.outliers)
        many = "One reading does" if n == 1 else f"{n} readings do"
        return (
            f"{many} not belong to the rest: single, large deviations that do not repeat, as a chip or a broken beam "
            f"makes them. Without them nothing is missing that this measurement could show; the residual is {residual}."
        )
    suspect = _suspect(diagnosis)
    if suspect is not None:
        return (
            f"No effect stands out from what chance and small differences between the setups can do: the residual is "
            f"{residual}. {_likeliest(diagnosis, suspect)}"
        )
    look = diagnosis.looks[0]
    if diagnosis.session.method == "direct" and look.fit.joint.p_value < _TOO_LARGE:
        return f"No effect and no pattern stands out from the scatter of the deviations: the residual is {residual}."
    return f"Nothing is missing that this measurement could show: the residual is {residual}."


def _likeliest(diagnosis: Diagnosis, suspect: Ranked) -> str:
    groups = [group for group in diagnosis.looks[0].groups if suspect.candidate.name in group]
    names = " or ".join(groups[0]) if groups else suspect.candidate.name
    return f"The likeliest would be {names}; chance does as well with a probability {_of(suspect.family_p_value)}."


def _suspect(diagnosis: Diagnosis) -> Ranked | None:
    """The likeliest effect, where the residuals are larger than chance explains and repeats do not explain them."""
    look = diagnosis.looks[0]
    likeliest = look.ranked[0] if look.ranked and look.ranked[0].rank else None
    too_large = look.fit.joint.p_value < _TOO_LARGE and diagnosis.session.method != "direct"
    return likeliest if too_large and not look.noisy else None


def _of(p: float) -> str:
    """A probability after its noun: of 0.02, or below 1e-6."""
    text = probability(p)
    return f"below {text[1:].strip()}" if text.startswith("<") else f"of {text}"


def _title(diagnosis: Diagnosis, name: str) -> str:
    effect = next((r.candidate.effect for r in diagnosis.ranked if r.candidate.name == name), None)
    return f"{effect.title} ({name})" if effect is not None else name


def _found(diagnosis: Diagnosis, name: str, change: Consequence | None, advice: Advice) -> str:
    k = diagnosis.accepted.index(name)
    ranked = diagnosis.looks[k].of(name)
    effect = ranked.candidate.effect
    words = [f"{name}: {effect.formula}." if effect is not None else f"{name}."]
    if change is not None:
        if 0 < len(change.parameters) <= _MANY:
            words.append(f"Its size is {sizes_in_words(change.parameters)} (k = 2).")
        elif change.parameters:
            words.append(f"Its size is that of {len(change.parameters)} coefficients, listed below.")
        if change.signal_rms is not None and change.signal_largest is not None:
            words.append(
                f"It changes the readings by {quantity(change.signal_rms, 'm')} RMS, "
                f"{quantity(change.signal_largest, 'm')} at most."
            )
        moved = ""
        if change.map_change_rms is not None:
            moved = f", and the errors at the tool point move by {quantity(change.map_change_rms, 'm')} RMS"
        words.append(
            f"With it in the model the residual falls from {quantity(change.rms_before, 'm')} to "
            f"{quantity(change.rms_after, 'm')} RMS{moved}."
        )
    words.append(f"Chance would do as well with a probability {_of(ranked.family_p_value)}.")
    if not ranked.plausible:
        words.append("Such a size does not usually occur: look for another cause as well.")
    separation = next((s for s in advice.separations if s.effects[0] == name), None)
    if separation is not None:
        gains = {r.candidate.name: r.bic_gain for r in diagnosis.looks[k].ranked}
        as_good = any(gains.get(other, -np.inf) > ranked.bic_gain - _CLEARLY for other in separation.effects[1:])
        words.append(_lookalike(separation, as_good))
    return " ".join(words)


def _lookalike(separation: Separation, as_good: bool) -> str:
    """What to say of look-alikes, which may do as well with nonlinear coefficients of their own."""
    others = " or ".join(separation.effects[1:])
    if separation.apart_before >= _APART and not as_good:
        return (
            f"A look-alike, {others}, would leave a similar pattern in the residuals, but at the size found the "
            f"readings tell them apart: the patterns differ by {separation.apart_before:.0f} standard uncertainties."
        )
    text = f"It may as well be {others}: this measurement cannot tell them apart."
    return f"{text} To tell: {separation.measure}." if separation.kind is not None else text


def _unexplained(diagnosis: Diagnosis) -> Iterator[str]:
    left = diagnosis.looks[-1].structure
    if left:
        best = left[0]
        yield (
            f"The residuals depend on {_covariate(best)}: this takes up {100 * best.share:.0f} % of their sum of "
            f"squares (p {probability(best.p_value)})."
        )
    look = diagnosis.looks[-1]
    if still_fails(diagnosis.looks):
        text = f"The readings scatter {np.sqrt(look.fit.joint.reduced_chi_square):.1f} times as much as declared"
        repeats = look.noise.from_repeats
        text = f"{text}, repeats by {quantity(repeats, 'm')}." if repeats is not None else f"{text}."
        suspect = _suspect(diagnosis) if not left else None
        yield f"{text} {_likeliest(diagnosis, suspect)}" if suspect is not None else text
    tried = [r.candidate.name for look in diagnosis.looks[:-1] if (r := look.winner()) is not None]
    if tried:
        remains = "structure" if left else "most of it"
        yield f"Even with {', '.join(tried)} in the model {remains} remains, so that none of these can be trusted."


def _covariate(structure: Structure) -> str:
    if structure.covariate == "place":
        return f"the place: {structure.shape}"
    shape = {"smooth": "in a smooth curve", "periodic": "in waves", "its sign": "by its sign"}
    return f"{structure.covariate}, {shape.get(structure.shape, structure.shape)}"


def _noise(diagnosis: Diagnosis) -> Iterator[str]:
    look = diagnosis.looks[len(diagnosis.accepted)]
    noise = look.noise
    joint = look.fit.joint
    ratio = float(np.sqrt(joint.reduced_chi_square))
    again = mounted_more_than_once(diagnosis.session)
    if diagnosis.session.method == "direct":
        yield from _scatter(diagnosis, look)
        return
    if diagnosis.verdict in ("adequate", "outliers", "missing_effect") and joint.p_value < _TOO_LARGE:
        text = f"The readings scatter {ratio:.2f} times as much as declared, which chance does not explain."
        if noise.from_repeats is not None and look.noisy:
            repeats = quantity(noise.from_repeats, "m")
            text += f" Repeats scatter as much ({repeats}): the declared uncertainty is too small."
        elif again:
            text += " The rest is the model, in a way that no effect and no covariate shows."
        else:
            text += (
                " Whether that is the model or the reproducibility of the setups cannot be told: none was measured "
                "again after being mounted again."
            )
        yield text
    elif diagnosis.verdict in ("missing_effect", "unexplained") and not again:
        yield (
            "No setup was measured again after being mounted again; small slopes and bows from setup to setup are "
            "allowed for, but a larger irreproducibility cannot be told from the model."
        )


def _scatter(diagnosis: Diagnosis, look: Look) -> Iterator[str]:
    """Scatter of direct deviations: a part's or an axis's own, which no instrument declares."""
    declared = look.noise.declared
    found = float(np.sqrt(look.fit.joint.reduced_chi_square)) * declared
    both = f"scatter {quantity(found, 'm')}, declared {quantity(declared, 'm')}"
    if look.fit.joint.p_value < _TOO_LARGE:
        yield f"The deviations scatter more about the model than was declared ({both}): sizes and tests use it."
    elif look.fit.joint.p_value > 1.0 - _TOO_LARGE:
        yield f"The deviations scatter less about the model than was declared ({both}): tests use what they scatter."
    else:
        yield f"The deviations scatter about the model as was declared ({both})."
    repeats = look.noise.from_repeats
    if repeats is not None and repeats < _SHARED * found and diagnosis.verdict != "unexplained":
        yield (
            f"Repeats of one place agree within {quantity(repeats, 'm')}, places differ from each other by more, "
            "without a pattern: that is the scatter of the part, or of the machine from place to place."
        )
    if diagnosis.verdict == "missing_effect" and diagnosis.looks[-1].structure:
        best = diagnosis.looks[-1].structure[0]
        yield (
            f"What is left still depends on {_covariate(best)}: {100 * best.share:.0f} % of its sum of squares (p "
            f"{probability(best.p_value)}), which no single effect of the catalogue explains. The effects that were "
            "found stay as they are beside it."
        )


def mounted_more_than_once(session: Session) -> bool:
    """Whether a setup was measured, left, and measured again."""
    setup = session.readings.setup
    if not len(setup):
        return False
    stretches = setup[np.r_[True, np.diff(setup) != 0]]
    return len(stretches) > len(np.unique(stretches))
