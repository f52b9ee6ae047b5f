# SPDX-License-Identifier: Apache-2.0
"""A diagnosis for people: in plain words first, then tables; text only, without a terminal's colours."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

from machine_tool_calibration.arrays import rms
from machine_tool_calibration.budget.complete import Conclusions
from machine_tool_calibration.diagnosis.consequence import Consequence, before_and_after
from machine_tool_calibration.diagnosis.diagnose import Diagnosis
from machine_tool_calibration.diagnosis.search.effect_search import Absorbed
from machine_tool_calibration.diagnosis.search.findings import Finding
from machine_tool_calibration.effects.effect import Effect
from machine_tool_calibration.model.model import POINTS
from machine_tool_calibration.planning.what_to_measure import Advice, alias_groups_of
from machine_tool_calibration.reports.diagnosis_document import screened_sizes, smallest_sizes
from machine_tool_calibration.reports.planning import dominant_words
from machine_tool_calibration.reports.quantities import (
    MOST_NAMED,
    NOT_DETERMINED,
    duration,
    micrometres,
    probability,
    quantity,
    range_of,
    sizes_in_words,
)
from machine_tool_calibration.reports.tables import Part, TextTable, heads, names_by_reason, table
from machine_tool_calibration.reports.unknowns import unknowns_in_words
from machine_tool_calibration.reports.verdict import AS_GOOD, next_step, verdict_words
from machine_tool_calibration.residuals.pool import Pool
from machine_tool_calibration.session.catalogue import spec_of
from machine_tool_calibration.words import say, together

# Errors of position that are not the machine's: a map that takes them up is wrong by them.
_NOT_THE_MACHINES = ("workpiece_thermal", "table_thermal_growth")


def _coefficients_table(diagnosis: Diagnosis, changes: Mapping[str, Consequence]) -> TextTable:
    observations, known = diagnosis.fits[0].fits[0].model.observations, _effects(diagnosis)
    found = [(name, p) for name in diagnosis.accepted if name in changes for p in changes[name].parameters]
    meanings: dict[str, str] = {}
    for name in known.keys() & set(diagnosis.accepted):
        meanings |= known[name].meanings(observations)
    return table(
        say("found.coefficients"),
        found,
        effect=lambda one: one[0],
        coefficient=lambda one: one[1].name.removeprefix(f"{one[0]}."),
        what_it_is=lambda one: meanings.get(one[1].name, ""),
        size_u=lambda one: quantity(one[1].value, one[1].unit, one[1].standard_uncertainty),
    )


def _absorbed_tables(diagnosis: Diagnosis) -> Iterator[TextTable]:
    """Effects that would not show, because they are fully correlated with unknowns of the setups or the map.

    And errors of the machine that are part of the map already: whatever their size, nothing needs to be added.
    """
    known, surface = _effects(diagnosis), spec_of(diagnosis.chosen.sessions[0]).probes_surface
    for of_map, title, *columns in ((False, "hidden", "effects", "taken_for"), (True, "in_map", "errors", "part_of")):
        own = [a for a in diagnosis.search.absorbed if _of_the_map(a, known.get(a.effect), surface) == of_map]
        by = names_by_reason((a.effect, _words(a, of_map, diagnosis)) for a in own)
        wrong = not of_map and any(unknown.in_map for a in own for unknown in a.by[:1])
        rows = tuple((", ".join(names), what) for what, names in by.items())
        yield TextTable(say(f"found.{title}"), heads(*columns), rows, say("found.wrong_map") if wrong else "")


def _of_the_map(absorbed: Absorbed, effect: Effect | None, surface: bool) -> bool:
    """Whether what takes an effect up is the map, which is meant to say it."""
    if absorbed.effect in absorbed.families:
        return True
    if effect is None or effect.kind != "position" or effect.id in _NOT_THE_MACHINES:
        return False
    # The points of a probing are those of the workpiece, whose form is not the machine's.
    first = absorbed.by[0] if absorbed.by else None
    return first is not None and first.in_map and not (first is POINTS and surface)


def _words(absorbed: Absorbed, of_map: bool, diagnosis: Diagnosis) -> str:
    if absorbed.effect in absorbed.families:
        return say("found.unknowns_themselves")
    chosen = [unknown for unknown in absorbed.by if unknown.in_map or not of_map]
    if chosen == [POINTS] and spec_of(diagnosis.chosen.sessions[0]).probes_surface:
        return say("found.form")
    return unknowns_in_words(chosen) or say("found.the_model")


def _effects(diagnosis: Diagnosis) -> dict[str, Effect]:
    return {f.name: f.candidate.effect for f in diagnosis.search.findings if f.candidate.effect is not None}


ROWS_SHOWN = 8
"""Candidates, or forms of the residuals, in a table for people."""
_MOST_OTHERS = 3  # effects beside those found


@dataclass(frozen=True)
class Report:
    """A diagnosis in words."""

    words: tuple[str, ...]  # paragraphs, the verdict first
    tables: tuple[TextTable, ...]  # the numbers; empty ones are left out
    forecast: tuple[str, ...]  # sentences on what dominates the map's uncertainty, and what makes it smaller
    # what to measure next, what this measurement could not show, and what was not looked for
    details: tuple[TextTable, ...]


def diagnosis_report(
    diagnosis: Diagnosis, advice: Advice, changes: Mapping[str, Consequence], shown: int = ROWS_SHOWN
) -> Report:
    """The diagnosis in words and tables.

    With so many candidates `shown` beside the accepted ones, all for 0; `changes` is what candidates change, by id.
    """
    tables = [
        _candidates(diagnosis, changes, shown),
        _coefficients_table(diagnosis, changes),
        _outliers(diagnosis),
        _structure(diagnosis),
    ]
    details = [
        _confounded(diagnosis, advice),
        _next(advice),
        *_absorbed_tables(diagnosis),
        _detectable(diagnosis),
        _excluded(diagnosis),
    ]
    dominant = advice.dominant
    return Report(
        words=tuple(verdict_words(diagnosis, changes, advice)),
        tables=tuple(table for table in tables if table.rows),
        forecast=() if dominant is None or dominant.cause == "readings" else tuple(dominant_words(dominant)),
        details=tuple(table for table in details if table.rows),
    )


def _candidates(diagnosis: Diagnosis, changes: Mapping[str, Consequence], shown: int) -> TextTable:
    groups = alias_groups_of(diagnosis)
    letters = {name: chr(ord("A") + k % 26) for k, group in reversed([*enumerate(groups)]) for name in group}
    ranked = [finding for finding in diagnosis.ranked if finding.rank]
    listed = ranked[: len(diagnosis.accepted) + shown] if shown else ranked
    before = quantity(rms(Pool(diagnosis.fits[0]).residuals), "m")
    # Columns of which nothing is known are not shown.
    notes = {
        "found": diagnosis.accepted,
        "group": any(one.name in letters for one in listed),
        "p": True,
        "size": True,
        "cross": any(diagnosis.predicted.get(one.name) for one in listed),
        "residual": True,
        "means": diagnosis.of_means,
        "without": True,
        "others": diagnosis.accepted,
        "plausible": not all(one.plausible for one in ranked),
        "left": len(ranked) > len(listed),
    }
    left = len(ranked) - len(listed)
    said = [say(f"found.note_{name}", size=before, n=left) for name, wanted in notes.items() if wanted]
    return table(
        say("found.none_named" if diagnosis.verdict == "unexplained" else "found.candidates"),
        listed,
        together(said, "; "),
        effect=lambda one: _marked(diagnosis, one),
        group=lambda one: letters.get(one.name, ""),
        probability=lambda one: probability(one.probability),
        p_value=lambda one: probability(one.p_value),
        size=lambda one: _sizes(one, changes),
        plausible=lambda one: "" if one.plausible else say("text.no"),
        cross_validation=lambda one: _held_out(diagnosis, one.name),
        residual_um=lambda one: micrometres(before_and_after(diagnosis, one, changes)[1]),
        map_moves_um=lambda one: micrometres(changes[one.name].map_change_rms if one.name in changes else None),
    )


def _marked(diagnosis: Diagnosis, finding: Finding) -> str:
    return f"{'✓ ' if finding.name in diagnosis.accepted else ''}{finding.name}"


def _sizes(finding: Finding, changes: Mapping[str, Consequence]) -> str:
    """Of a full fit where there is one, otherwise those of the screening."""
    change = changes.get(finding.name)
    return sizes_in_words((change.parameters if change is not None else ()) or screened_sizes(finding))


def _held_out(diagnosis: Diagnosis, name: str) -> str:
    """How an effect does on readings that were left out; empty where that was not asked."""
    gains = [p.gain for p in diagnosis.predicted.get(name, ())]
    return f"{100 * min(gains):+.0f} %" if gains else ""


def _outliers(diagnosis: Diagnosis) -> TextTable:
    return table(
        say("found.outliers"),
        sorted(diagnosis.gross_errors, key=lambda one: one.row),
        say("found.note_outliers"),
        row=lambda one: str(one.row),
        times_expected=lambda one: NOT_DETERMINED if one.deviation is None else f"{one.studentized:+.1f}",
        deviation_um=lambda one: micrometres(one.deviation, signed=True),
    )


def _structure(diagnosis: Diagnosis) -> TextTable:
    left = diagnosis.left
    return table(
        say("found.structure"),
        left[:ROWS_SHOWN],
        say("text.more", n=len(left) - ROWS_SHOWN) if len(left) > ROWS_SHOWN else "",
        covariate=lambda one: one.covariate,
        shape=lambda one: one.shape,
        p_value=lambda one: probability(one.p_value),
        share=lambda one: f"{100 * one.share:.0f} %",
    )


def _confounded(diagnosis: Diagnosis, advice: Advice) -> TextTable:
    found = {s.effects[0] for s in advice.separations} & set(diagnosis.accepted)
    notes = [say("found.note_cosine"), *([say("found.note_apart")] if found else [])]
    return table(
        say("found.confounded"),
        advice.separations,
        together(notes, "; "),
        confounded=lambda s: ", ".join(s.effects),
        to_distinguish=lambda s: s.measure,
        time=lambda s: duration(s.seconds),
        besides=lambda s: s.aside,
        cosine=lambda s: f"{s.cosine_before:.2f} → {s.cosine_after:.2f}" if s.kind is not None else "",
        apart=lambda s: f"{s.apart_before:.1f} → {s.apart_after:.1f}" if s.effects[0] in found else "",
    )


def _next(advice: Advice) -> TextTable:
    return table(
        say("found.hardly"),
        advice.visibilities,
        effect=lambda v: v.effect,
        to_detect=lambda v: v.measure,
        time=lambda v: duration(v.seconds),
        besides=lambda v: v.aside,
        smallest_now=lambda v: say("found.not_at_all") if v.before is None else quantity(v.before, v.unit),
        then=lambda v: quantity(v.after, v.unit),
    )


def _detectable(diagnosis: Diagnosis) -> TextTable:
    every = diagnosis.search.findings
    rows = sorted((found.name, *_smallest(found, sizes)) for found in every if (sizes := smallest_sizes(found)))
    return TextTable(say("found.detectable"), heads("effect", "smallest", "occurs"), tuple(rows))


def _smallest(ranked: Finding, sizes: Mapping[str, float | None]) -> tuple[str, str]:
    known = {s.coefficient.name: s.coefficient for s in ranked.sizes}
    first = known[next(iter(sizes))]
    seen = {name: value for name, value in sizes.items() if value is not None}
    text: str
    if not seen:
        text = say("found.none_occurs")
    elif len(sizes) <= MOST_NAMED:
        text = ", ".join(f"{name}: {quantity(value, known[name].unit)}" for name, value in seen.items())
    else:
        ends = range_of(min(seen.values()), max(seen.values()), first.unit)
        many = len(sizes) if len(seen) == len(sizes) else say("text.of", n=len(seen), count=len(sizes))
        text = say("text.coefficients", n=many, one=ends)
    return text, range_of(first.low, first.high, first.unit)


def _excluded(diagnosis: Diagnosis) -> TextTable:
    longest_last = sorted(names_by_reason(diagnosis.excluded.items()).items(), key=lambda entry: len(entry[1]))
    rows = tuple((", ".join(names), why) for why, names in longest_last)
    return TextTable(say("found.excluded"), heads("effect", "why"), rows)


def diagnosis_parts(found: Diagnosis, then: Conclusions, *, details: bool = False) -> Iterator[Part]:
    """The verdict, the effects and the next step; with details all words, all tables and all effects."""
    if details:
        report = diagnosis_report(found, then.advice, then.changes, shown=0)
        yield from (*report.words, *report.forecast, next_step(found, then.advice))
        yield from (*report.tables, *report.details)
        return
    yield from verdict_words(found, then.changes, then.advice, brief=True)
    yield _brief(found, then.changes)
    yield next_step(found, then.advice)
    yield say("found.details")


def _brief(diagnosis: Diagnosis, changes: Mapping[str, Consequence]) -> TextTable:
    """The effects found and what may be there instead, or the most probable ones where none is sure."""
    ranked = [finding for finding in diagnosis.ranked if finding.rank]
    own = [finding for finding in ranked if finding.name in diagnosis.accepted]
    others = [finding for finding in ranked if finding not in own][:_MOST_OTHERS]
    likely = [finding for finding in others if finding.probability > AS_GOOD]
    title = "looked_for" if not own else "found_and" if likely else "found"
    return table(
        say(f"found.{title}"),
        [*own, *likely] if own else others,
        say("found.note_means") if diagnosis.of_means else "",
        effect=lambda one: _marked(diagnosis, one),
        probability=lambda one: probability(one.probability),
        size_u=lambda one: _sizes(one, changes),
        residual_then_um=lambda one: micrometres(before_and_after(diagnosis, one, changes)[1]),
    )
