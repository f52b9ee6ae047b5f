# SPDX-License-Identifier: Apache-2.0
"""The verdict in sentences."""

from collections.abc import Iterator, Mapping
from typing import Literal

import numpy as np

from machine_tool_calibration.arrays import rms
from machine_tool_calibration.diagnosis.consequence import Consequence
from machine_tool_calibration.diagnosis.diagnose import Diagnosis
from machine_tool_calibration.diagnosis.search.effect_search import Structure
from machine_tool_calibration.effects.effect import unrecorded, with_gaps
from machine_tool_calibration.estimation import priors
from machine_tool_calibration.model.fit import JointFit
from machine_tool_calibration.model.observations import SAME_POSITION
from machine_tool_calibration.model.result import fit_quality, one_direction
from machine_tool_calibration.planning.what_to_measure import Advice, Separation
from machine_tool_calibration.reports.goodness import effect_words, free_words, scatter_change_words, scatter_words
from machine_tool_calibration.reports.quantities import (
    MOST_NAMED,
    p_value,
    probability,
    quantity,
    reproducibility_words,
    residual_change,
    rounded,
    sizes_in_words,
)
from machine_tool_calibration.residuals.noise import scatter_over_declared
from machine_tool_calibration.residuals.places import alike_beside_p, differ_by_setup, read_in_several_setups
from machine_tool_calibration.residuals.pool import Pool
from machine_tool_calibration.session.catalogue import spec_of
from machine_tool_calibration.words import Said, say, together

_APART = 6.0  # standard uncertainties between confounded effects from which it is said how far apart they are
AS_GOOD = 0.1
"""Probability of another effect from which it is told beside those found."""
# Covariates of a structure that is no more than that these differ: places, or what was read at the one place.
_OF_PLACES = ("place", "target")
_SURELY = 0.9  # probability from which an effect is named without it
_PARTLY = 0.5  # share of the whole scatter from which that of repeats is part of the story
_MEMORY = 1.5  # readings for one independent one from which the memory of the noise is told
# Factor of the uncertainties over that by which readings scatter, from which places that differ make it.
_OF_PLACES_MOSTLY = 1.5
_SHARED = 0.7  # scatter of repeats over that of all, below which places differ more than their repeats
_VARYING = "lost_motion"  # effects that are the reversal of an axis
_OF_REVERSAL = ("backlash", _VARYING)


def verdict_words(
    diagnosis: Diagnosis, changes: Mapping[str, Consequence], advice: Advice, *, brief: bool = False
) -> Iterator[str]:
    """Paragraphs: the verdict, every effect found, and what the data does not determine.

    Where it is to be `brief` only what decides; the effects are then in a table.
    """
    yield headline(diagnosis)
    yield from left_words(diagnosis)
    yield from _there_and_back_once(diagnosis)
    for words in diagnosis.suspicious:
        yield say("diagnosis.suspicious", what=words)
    if not brief:
        for name in diagnosis.accepted:
            yield _found(diagnosis, name, changes.get(name), advice)
    yield from effect_words(diagnosis.fits[-1], diagnosis.accepted)
    yield from _unrecorded(diagnosis)
    for name, why in diagnosis.refused.items():
        p = probability(diagnosis.search.of(name).probability)
        yield say("diagnosis.refused", effect=_title(diagnosis, name), p=p, why=why)
    if diagnosis.verdict == "unexplained":
        yield from _unexplained(diagnosis)
    yield from _may_be_of_an_axis(diagnosis)
    if diagnosis.gross_errors and diagnosis.verdict != "outliers":
        yield say("diagnosis.set_aside_before", n=len(diagnosis.gross_errors))
    yield from reproducibility_words([size.document() for size in diagnosis.with_found.joint.marginal.sizes])
    if (memory := diagnosis.search.memory) >= _MEMORY:
        yield say("diagnosis.memory", n=min(round(memory), len(Pool(diagnosis.search.fit))))
    yield from _noise(diagnosis)
    if diagnosis.verdict in ("adequate", "outliers"):
        yield from scatter_change_words(diagnosis.with_found.joint, memory)
    if diagnosis.verdict == "missing_effect" and diagnosis.left:
        yield say("diagnosis.still_depend", **_dependence(diagnosis.left[0]))


def verdict_line(diagnosis: Diagnosis) -> str:
    """The verdict in one line."""
    sure = {name: probability(diagnosis.search.of(name).probability) for name in diagnosis.accepted}
    found = (say("verdict.with_probability", name=name, p=p) for name, p in sure.items())
    return verdict_said(diagnosis.verdict, together(found, ", "), len(diagnosis.gross_errors))


def verdict_said(verdict: str, names: str, outliers: int) -> str:
    """A verdict in one line, with the effects that are missing, or how many readings do not belong to the rest."""
    if verdict == "missing_effect":
        return say("verdict.missing", names=names)
    if verdict == "outliers":
        return say("verdict.stand_out", what=say("compared.stand_out", n=outliers))
    return say("verdict.nothing" if verdict == "adequate" else "verdict.unexplained")


def good_enough(diagnosis: Diagnosis) -> bool:
    """Whether the model lacks something for sure that is too small to matter."""
    sound = diagnosis.verdict in ("adequate", "outliers")
    return sound and (diagnosis.unknown > priors.ACCEPTED or diagnosis.nothing < 1.0 - priors.SURE)


def _scatters(diagnosis: Diagnosis) -> bool:
    """Whether deviations scatter more than was declared, as a part or an axis may, and nobody can declare."""
    session, fit = diagnosis.chosen.sessions[0], diagnosis.search.fit
    return spec_of(session).reads_machine and fit_quality(fit.p_value) == "bad"


def left_words(diagnosis: Diagnosis) -> Iterator[str]:
    """What to make of structure that is left where nothing is missing: one sentence."""
    if good_enough(diagnosis):
        small = say("diagnosis.small_in_map" if _scatters(diagnosis) else "diagnosis.good_enough")
        yield small if diagnosis.left else say("diagnosis.may_be_left", p=probability(1.0 - diagnosis.nothing))
    elif diagnosis.verdict in ("adequate", "outliers") and any(s.covariate not in _OF_PLACES for s in diagnosis.left):
        yield say("diagnosis.structure_unsure")


def headline(diagnosis: Diagnosis) -> Said:
    """The verdict, and what it rests on: one sentence or two."""
    look, declared = diagnosis.search, quantity(diagnosis.noise.declared, "m")
    residual = say("diagnosis.residual", found=quantity(rms(Pool(diagnosis.fits[0]).residuals), "m"), declared=declared)
    if diagnosis.verdict == "missing_effect":
        names = [_with_doubt(_title(diagnosis, name), look.of(name).probability) for name in diagnosis.accepted]
        what = say("diagnosis.effects", n=len(names), names=together(names, ", "))
        return say("diagnosis.only_reversal" if only_reversal(diagnosis) else "diagnosis.lacks", what=what)
    if diagnosis.verdict == "unexplained" and diagnosis.unknown < 1.0 - diagnosis.nothing - diagnosis.unknown:
        something = 1.0 - diagnosis.nothing
        if something < priors.ACCEPTED:  # by none of these causes, and by how much is left for sure
            return say("diagnosis.misfit_alone")
        return say("diagnosis.which_unknown", p=probability(something))
    if diagnosis.verdict == "unexplained":
        return say("diagnosis.unexplained")
    enough, scatters = good_enough(diagnosis), _scatters(diagnosis)
    if diagnosis.likely:
        sound = together((say("diagnosis.none_sure", residual=residual), _likeliest(diagnosis)))
    elif scatters and not enough and (places := [s.shape for s in diagnosis.left if s.covariate in _OF_PLACES]):
        sound = say("diagnosis.places_only", residual=residual, places=places[0])
    elif scatters or enough:
        key = ("no_effect" if enough else "no_pattern") if scatters else "nothing_matters"
        sound = say(f"diagnosis.{key}", residual=residual)
    elif diagnosis.nothing < 1.0 - priors.ACCEPTED:
        sound = say("diagnosis.one_of_many", p=probability(1.0 - diagnosis.nothing), residual=residual)
    else:
        sound = say("diagnosis.nothing_shown", p=probability(diagnosis.nothing), residual=residual)
    # Of the readings that were not set aside.
    free = all("free" in spec_of(session).models for session in diagnosis.chosen.sessions)
    repeated = sum(one.repeated for one in diagnosis.gross_errors) if free else 0
    key = "outliers_repeat" if repeated else "outliers"
    outliers = say(f"diagnosis.{key}", n=len(diagnosis.gross_errors), repeated=repeated)
    return together((outliers, sound)) if diagnosis.verdict == "outliers" else sound


def _with_doubt(name: str, chance: float) -> str:
    """An effect that is accepted, with how sure that is where it is not sure; of look-alikes one stands for all."""
    if chance < priors.ACCEPTED:
        return say("diagnosis.or_alike", what=name)
    return say("diagnosis.with_probability", what=name, p=probability(chance)) if chance < _SURELY else name


def only_reversal(diagnosis: Diagnosis) -> bool:
    """Whether nothing is missing but the reversal of axes that were run both ways by ISO 230-2, which reports it."""
    if diagnosis.left:
        return False
    axes = {str(run["axis"]).lower() for run in diagnosis.fitted[0].error_map.content.get("iso230_2", ())}
    return set(diagnosis.accepted) <= {f"{kind}_{axis}" for kind in _OF_REVERSAL for axis in axes}


# What comes at a moment: of a target, of what is on the table, and of anything.
_OF_TARGET, _ON_TABLE = "shape.shift_of_target_at", "shape.shift_on_table_at"
_SUDDEN = ("shape.step_at", "shape.shift_at")
_OF_RUNS = "repeat"
# Changes of an axis's direction where it went there and back once, from where it may have come from either side.
_ONE_REVERSAL = 2


def _there_and_back_once(diagnosis: Diagnosis) -> Iterator[Said]:
    """Of an axis that turned once: what times do not tell from the reversal that was found."""
    observed = [model.observations for model in diagnosis.fits[0].assembly.models]
    for timed, kinds, key in ((False, _OF_REVERSAL, "or_a_drift"), (True, (_VARYING,), "or_a_wander")):
        found = {name[-1] for name in diagnosis.accepted if name[:-2] in kinds}
        columns = [one.readings.columns for one in observed if one.timed == timed]
        ways = [way for axis in found for own in columns if (way := own.get(f"dir_{axis}")) is not None]
        if any(0 < np.count_nonzero(np.diff(way[way != 0])) <= _ONE_REVERSAL for way in ways):
            yield say(f"diagnosis.{key}")


def next_step(diagnosis: Diagnosis, advice: Advice) -> str:
    """What to do next: one sentence or two."""
    likely = set(diagnosis.likely)
    told = next((s for s in advice.separations if s.kind is not None and likely.intersection(s.effects)), None)
    if diagnosis.accepted or diagnosis.verdict == "outliers":
        names = together(diagnosis.accepted, say("text.and"))
        text = say("next.adds", names=names) if diagnosis.accepted else say("next.sets_aside")
        mine = next((s for s in advice.separations if s.effects[0] in diagnosis.accepted), None)
        if mine is not None and _as_good(diagnosis, mine):
            measure = mine.measure if mine.kind is not None else say("next.no_measure")
            others = together(mine.effects[1:], say("diagnosis.or"))
            return together((text, say("next.from_rivals", name=mine.effects[0], names=others, measure=measure)))
        return text
    if told is not None:
        return say("next.between", names=together(told.effects, say("text.and")), measure=told.measure)
    if diagnosis.verdict == "unexplained":
        return _mended(diagnosis) or say("next.look")
    best = advice.dominant.remedies[0] if advice.dominant is not None and advice.dominant.remedies else None
    if best is None:
        fit = diagnosis.fits[-1]
        if diagnosis.fitted[-1].limited_by_runs:
            timed = all(model.observations.timed for model in fit.assembly.models)
            return say("next.runs" if timed else "next.runs_untimed")
        # Of places or setups that differ there are fewer than readings, however often these are repeated.
        if fit_quality(fit.p_value) != "bad" and fit.marginal.scatter < _OF_PLACES_MOSTLY * fit.birge_ratio:
            if not np.isfinite(diagnosis.fitted[-1].error_map.error).any():
                return say("next.undetermined")
            missing = diagnosis.nothing < 1.0 - priors.ACCEPTED and not good_enough(diagnosis)
            return say("next.may_be_missing" if missing else "next.nothing")
        what = f"next.{_what_scatters(diagnosis)}"
        return say(what, ratio=rounded(np.sqrt(fit.reduced_chi_square)))
    return say("next.smaller", measure=best.measure)


def _mended(diagnosis: Diagnosis) -> Said | None:
    """What helps where readings are others from a moment on, which is not where an axis is, or runs grow; else None."""
    structure = next(iter(diagnosis.search.structure), None)
    if structure is None or structure.covariate in ("x", "y", "z") or not isinstance(structure.shape, Said):
        return None
    shape, observed = structure.shape, Pool(diagnosis.search.fit).observations
    if structure.covariate == _OF_RUNS and not all(one.timed for one in observed):
        return say("next.runs_grow")
    if shape.key == _OF_TARGET:
        return say("next.moved_target", target=shape.values["target"])  # type: ignore[call-overload]
    if shape.key == _ON_TABLE or (shape.key in _SUDDEN and spec_of(diagnosis.chosen.sessions[0]).probes_surface):
        return say("next.moved_part")
    return say("next.moved") if shape.key in _SUDDEN else None


def _what_scatters(diagnosis: Diagnosis) -> Literal["repeats", "few", "scatter", "both", "places", "setups"]:
    """Where readings scatter more than declared: without repeats nobody knows what does; these do, places, or both."""
    noise, observed = diagnosis.noise, Pool(diagnosis.search.fit).observations
    if noise.as_read is None and noise.from_repeats is None:
        if any(read_in_several_setups(one) for one in observed) and not differ_by_setup(diagnosis.fits[-1].fits):
            # In several setups: what places have for themselves in all of them, against what is left beside that.
            own, left = diagnosis.search.spread.get("place", np.inf), diagnosis.search.variance
            return "places" if own**2 > left else "both"
        return "few" if any(len(np.unique(one.place)) < len(one) for one in observed) else "repeats"
    chi_square = diagnosis.fits[-1].reduced_chi_square

    def by_repeats(share: float) -> bool:
        return any(noise.is_all(repeats, chi_square, share) for repeats in (noise.as_read, noise.from_repeats))

    more = max(size for size in (noise.as_read, noise.from_repeats) if size is not None) > noise.declared
    if more and by_repeats(_PARTLY):
        return "scatter" if by_repeats(priors.AS_NOISY) else "both"
    moves = any(one.moves for one in observed) and not differ_by_setup(diagnosis.fits[-1].fits)
    return "places" if moves else "setups"


def _likeliest(diagnosis: Diagnosis) -> Said:
    found = [f"{name} ({probability(diagnosis.search.of(name).probability)})" for name in diagnosis.likely]
    return say("diagnosis.likely", names=", ".join(found))


def _title(diagnosis: Diagnosis, name: str) -> str:
    effect = diagnosis.search.of(name).candidate.effect
    return say("diagnosis.effect", title=effect.title, name=name) if effect is not None else name


def _found(diagnosis: Diagnosis, name: str, change: Consequence | None, advice: Advice) -> Said:
    found = diagnosis.search.of(name)
    effect = found.candidate.effect
    law = say("diagnosis.formula", name=name, formula=effect.formula) if effect is not None else f"{name}."
    words = [law, *(_changed(change) if change is not None else ())]
    words.append(say("diagnosis.probable", p=probability(found.probability)))
    shares = []
    for p in diagnosis.predicted.get(name, ()):
        key, count = "diagnosis.needed" if p.needed else "diagnosis.left_out", len(p.log_gains) + p.needed
        shares.append(say(key, what=p.what, gain=f"{100 * p.gain:+.0f}", needed=p.needed, count=count))
    if shares:
        words.append(say("diagnosis.predicted", shares=together(shares, ", ")))
    if not found.plausible:
        words.append(say("diagnosis.implausible"))
    if (separation := next((s for s in advice.separations if s.effects[0] == name), None)) is not None:
        words.append(_lookalike(diagnosis, separation))
    return together(words)


def _instead(diagnosis: Diagnosis, separation: Separation) -> float:
    """Probability that another one of confounded effects is missing, and not the first."""
    first, *others = separation.effects
    return sum(p for members, p in diagnosis.search.sets if first not in members and set(others) & set(members))


def _as_good(diagnosis: Diagnosis, separation: Separation) -> bool:
    """Whether another one of confounded effects may as well be missing as the first."""
    return _instead(diagnosis, separation) > AS_GOOD * diagnosis.search.of(separation.effects[0]).probability


def _changed(change: Consequence) -> Iterator[Said]:
    """How large an effect is, and what changes with it in the model."""
    if 0 < len(change.parameters) <= MOST_NAMED:
        yield say("diagnosis.size", sizes=sizes_in_words(change.parameters))
    elif change.parameters:
        yield say("diagnosis.many_sizes", n=len(change.parameters))
    if change.signal is not None:
        most = float(np.abs(change.signal).max(initial=0.0))
        yield say("diagnosis.changes", rms=quantity(rms(change.signal), "m"), most=quantity(most, "m"))
    residual = residual_change(change.rms_before, change.rms_after)
    if change.map_change_rms is None:
        yield say("diagnosis.with_it", residual=residual)
    else:
        yield say("diagnosis.with_it_moved", residual=residual, moved=quantity(change.map_change_rms, "m"))


def _lookalike(diagnosis: Diagnosis, separation: Separation) -> Said:
    """What to say of confounded effects, which may do as well with nonlinear coefficients of their own."""
    others = together(separation.effects[1:], say("diagnosis.or"))
    if not _as_good(diagnosis, separation):
        text = say("diagnosis.similar", others=others, p=probability(_instead(diagnosis, separation)))
        if separation.apart_before < _APART:
            return text
        return together((text, say("diagnosis.apart", apart=f"{separation.apart_before:.0f}")))
    text = say("diagnosis.as_well", others=others)
    if separation.kind is None:
        return text
    return together((text, say("diagnosis.to_distinguish", measure=separation.measure)))


def _unrecorded(diagnosis: Diagnosis) -> Iterator[Said]:
    """That what goes with a temperature that was not recorded may look like what goes with the time."""
    found = [name for name in diagnosis.accepted if diagnosis.search.of(name).candidate.takes_time]
    needs = [(diagnosis.excluded.get(effect.id), name) for effect in diagnosis.chosen.absent for name in effect.needs]
    temperatures = [(why, name) for why, name in needs if name.startswith("temperature_")]
    lacking = {name for why, name in temperatures if why == unrecorded(name)}
    lacking |= {say("diagnosis.with_gaps", column=name) for why, name in temperatures if why == with_gaps(name)}
    if found and lacking:
        names, columns = together(found, say("text.and")), together(sorted(lacking), ", ")
        yield say("diagnosis.unrecorded", names=names, columns=columns, n=len(lacking))


def _may_be_of_an_axis(diagnosis: Diagnosis) -> Iterator[Said]:
    """Of what goes with the time: that it may as well go with the place, or with a reversal that was not recorded."""
    found = any(diagnosis.search.of(name).candidate.takes_time for name in diagnosis.accepted)
    nothing = diagnosis.verdict in ("adequate", "outliers")
    if nothing or (not found and "time" not in [structure.covariate for structure in diagnosis.left[:1]]):
        return
    for observed in (fit.model.observations for fit in diagnosis.with_found.joint.fits):
        if not spec_of(observed.session).reads_machine:
            continue
        moves = {axis: np.diff(observed.position[:, j]) for j, axis in enumerate("xyz")}
        moved = {axis: way for axis, way in moves.items() if np.abs(way).max(initial=0.0) > SAME_POSITION}
        for axis, way in moved.items():
            if len(moved) == 1 and abs(np.sign(way).sum()) == len(way):
                yield say("diagnosis.time_is_place", axis=axis)
            # Of an axis that turned again and again a reversal goes with no course of time.
            turns = np.count_nonzero(np.diff(np.sign(way[np.abs(way) > SAME_POSITION])))
            unknown = diagnosis.excluded.get(f"backlash_{axis}") == unrecorded(f"dir_{axis}")
            if unknown and 0 < turns <= _ONE_REVERSAL:
                yield say("diagnosis.unrecorded_direction", axis=axis)


def _unexplained(diagnosis: Diagnosis) -> Iterator[str]:
    if left := diagnosis.search.structure:
        yield say("diagnosis.depend", **_dependence(left[0]))
    if diagnosis.contradicted:
        fit, repeats = diagnosis.fits[-1], diagnosis.noise.from_repeats
        ratio = rounded(np.sqrt(fit.reduced_chi_square))
        if repeats is not None:
            yield say("diagnosis.contradicted_repeats", ratio=ratio, repeats=quantity(repeats, "m"))
        elif not spec_of(diagnosis.chosen.sessions[0]).reads_machine:  # of which the scatter is told in any case
            yield say("diagnosis.contradicted", ratio=ratio)
    if diagnosis.likely:
        most = min((diagnosis.search.of(name) for name in diagnosis.likely), key=lambda one: one.rms_after)
        accounts = most.rms_after**2 < (1.0 - priors.MOST_OF_THE_EXCESS) * rms(Pool(diagnosis.fits[0]).residuals) ** 2
        told = say("diagnosis.most_is_of", name=most.name, left=quantity(most.rms_after, "m"))
        yield together((_likeliest(diagnosis), told if accounts else say("diagnosis.none_accounts")))


def _dependence(structure: Structure) -> dict[str, str]:
    """What residuals depend on, and how much: the values of a sentence."""
    if structure.covariate in _OF_PLACES:
        covariate = say(f"diagnosis.{structure.covariate}", shape=structure.shape)
    else:
        known = structure.shape in ("smooth", "periodic", "its sign")
        shape = say(f"diagnosis.{structure.shape.replace(' ', '_')}") if known else structure.shape
        covariate = say("diagnosis.on_covariate", covariate=structure.covariate, shape=shape)
    return {"covariate": covariate, "share": f"{100 * structure.share:.0f}", "p": p_value(structure.p_value)}


def _noise(diagnosis: Diagnosis) -> Iterator[str]:
    noise, joint = diagnosis.noise, diagnosis.fits[-1]
    ratio = float(np.sqrt(joint.reduced_chi_square))
    again = diagnosis.chosen.sessions[0].mounted_again
    if spec_of(diagnosis.chosen.sessions[0]).reads_machine:
        yield from _scatter(diagnosis)
        return
    if diagnosis.verdict in ("adequate", "outliers", "missing_effect") and fit_quality(joint.p_value) == "bad":
        if noise.from_repeats is not None and diagnosis.noisy:
            why = [say("diagnosis.repeats_scatter", repeats=quantity(noise.from_repeats, "m"))]
        else:  # what is left with a pattern is told
            why = [] if diagnosis.left else [say("diagnosis.rest" if again else "diagnosis.mounted_once")]
        yield together([say("diagnosis.no_noise", ratio=rounded(ratio)), *why])


def _scatter(diagnosis: Diagnosis) -> Iterator[str]:
    """Scatter of direct deviations: a part's or an axis's own, which no instrument declares."""
    fit, repeats = diagnosis.fits[-1], diagnosis.noise.as_read
    ratio = float(np.sqrt(fit.reduced_chi_square))
    whole = diagnosis.with_found
    if words := scatter_words(whole.error_map.content, whole.joint.p_value):
        yield words
        method, content = diagnosis.chosen.sessions[0].method, whole.error_map.content
        used, p_value = whole.joint.assembly.problem.n_readings, whole.joint.p_value
        known = {"method": method, "model": whole.model_name, "used": used, "p_value": p_value, "error_map": content}
        yield from free_words(known)
    elif fit_quality(fit.p_value) == "bad":  # of several sessions, whose map has no scatter of its own
        yield from _scatter_of_each(fit)
    # Where both directions are a reversal apart, that is no difference of places.
    found = one_direction(whole.error_map.content) or ratio * diagnosis.noise.declared
    if repeats is not None and repeats < _SHARED * found and diagnosis.verdict != "unexplained":
        # What places differ by without a pattern is none.
        patterns = [structure for structure in diagnosis.left if structure.covariate not in _OF_PLACES]
        alike = any(p is not None and p < priors.STRUCTURE_P for p in map(alike_beside_p, fit.fits))
        if alike or not patterns:
            moves = any(own.model.observations.moves for own in fit.fits)
            by_place = "places_alike" if alike else "places_differ"
            key = ("setups_differ" if differ_by_setup(fit.fits) else by_place) if moves else "targets_differ"
            yield say(f"diagnosis.{key}", repeats=quantity(repeats, "m"))


def _scatter_of_each(fit: JointFit) -> Iterator[Said]:
    """How far the readings of every session scatter; of a single one where it is not what runs differ by."""
    ratio = rounded(np.sqrt(fit.reduced_chi_square))
    if fit.assembly.labels is not None:
        own = zip(fit.assembly.labels, map(scatter_over_declared, fit.fits), strict=True)
        each = [say("diagnosis.times", name=name, ratio=rounded(times)) for name, times in own]
        yield say("diagnosis.scatter_of_each", ratio=ratio, each=together(each, ", "))
    elif not any(reproducibility_words([size.document() for size in fit.marginal.sizes])):
        yield say("diagnosis.no_noise", ratio=ratio)
