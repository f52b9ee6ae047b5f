# SPDX-License-Identifier: Apache-2.0
"""A diagnosis for people: in plain words first, then tables; text only, without a terminal's colours."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

from machine_tool_calibration.arrays import rms
from machine_tool_calibration.diagnosis.consequence import Consequence, before_and_after
from machine_tool_calibration.diagnosis.diagnose import Diagnosis
from machine_tool_calibration.diagnosis.search.effect_search import Absorbed
from machine_tool_calibration.diagnosis.search.findings import Finding
from machine_tool_calibration.effects.effect import Effect
from machine_tool_calibration.model.model import POINTS
from machine_tool_calibration.planning.advice import Advice, alias_groups_of
from machine_tool_calibration.reports.diagnosis_document import screened_sizes, smallest_sizes
from machine_tool_calibration.reports.planning import dominant_words
from machine_tool_calibration.reports.quantities import (
    duration,
    micrometres,
    probability,
    quantity,
    range_of,
    sizes_in_words,
)
from machine_tool_calibration.reports.tables import Part, TextTable, heads
from machine_tool_calibration.reports.unknowns import unknowns_in_words
from machine_tool_calibration.reports.verdict import AS_GOOD, next_step, verdict_words
from machine_tool_calibration.residuals.pool import Pool
from machine_tool_calibration.session.catalogue import spec_of
from machine_tool_calibration.words import say, together

if TYPE_CHECKING:
    from machine_tool_calibration.planning.what_to_measure import Conclusions

__all__ = [
    "Report",
    "diagnosis_parts",
    "diagnosis_report",
]


# Errors of position that are not the machine's: a map that takes them up is wrong by them.
_NOT_THE_MACHINES = ("workpiece_thermal", "table_thermal_growth")


def _coefficients_table(diagnosis: Diagnosis, changes: Mapping[str, Consequence]) -> TextTable:
    """Every coefficient of the effects found: what it is, and its size."""
    observations = diagnosis.fits[0].fits[0].model.observations
    known = _effects(diagnosis)
    rows = []
    for name in diagnosis.accepted:
        effect, change = known.get(name), changes.get(name)
        meanings = {} if effect is None else effect.meanings(observations)
        for p in () if change is None else change.parameters:
            size = quantity(p.value, p.unit, p.standard_uncertainty)
            rows.append((name, p.name.removeprefix(f"{name}."), meanings.get(p.name, ""), size))
    columns = heads("effect", "coefficient", "what_it_is", "size_u")
    return TextTable(say("found.coefficients"), columns, tuple(rows))


def _in_map_table(diagnosis: Diagnosis) -> TextTable:
    """Errors of the machine that are part of the map already: whatever their size, nothing needs to be added."""
    return TextTable(say("found.in_map"), heads("errors", "part_of"), _rows(diagnosis, True))


def _hidden_table(diagnosis: Diagnosis) -> TextTable:
    """Effects that would not show, because they are fully correlated with unknowns of the setups or the map."""
    rows = _rows(diagnosis, False)
    wrong = any(unknown.in_map for a in _absorbed(diagnosis, False) for unknown in a.by[:1])
    note = say("found.wrong_map") if wrong else ""
    return TextTable(say("found.hidden"), heads("effects", "taken_for"), rows, note)


def _rows(diagnosis: Diagnosis, of_map: bool) -> tuple[tuple[str, ...], ...]:
    by: dict[str, list[str]] = {}
    for a in _absorbed(diagnosis, of_map):
        by.setdefault(_words(a, of_map, diagnosis), []).append(a.effect)
    return tuple((", ".join(names), what) for what, names in by.items())


def _absorbed(diagnosis: Diagnosis, of_map: bool) -> list[Absorbed]:
    known, surface = _effects(diagnosis), spec_of(diagnosis.chosen.sessions[0]).probes_surface
    return [a for a in diagnosis.search.absorbed if _of_the_map(a, known.get(a.effect), surface) == of_map]


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
    """All effects that were looked for."""
    return {f.name: f.candidate.effect for f in diagnosis.search.findings if f.candidate.effect is not None}


_SHOWN = 8
_FEW = 3
_MANY = 3


@dataclass(frozen=True)
class Report:
    """A diagnosis in words.

    Attributes:
        words: paragraphs, the verdict first.
        tables: the numbers; empty ones are left out.
        forecast: sentences on what dominates the map's uncertainty, and what makes it smaller.
        details: what to measure next, what this measurement could not show, and what was not looked for.
    """

    words: tuple[str, ...]
    tables: tuple[TextTable, ...]
    forecast: tuple[str, ...]
    details: tuple[TextTable, ...]


def diagnosis_report(
    diagnosis: Diagnosis, advice: Advice, changes: Mapping[str, Consequence], shown: int = _SHOWN
) -> Report:
    """The diagnosis in words and tables.

    Args:
        diagnosis: what was found.
        advice: what to measure next.
        changes: what candidates change, by id.
        shown: how many candidates beside the accepted ones; 0 for all.
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
        _hidden_table(diagnosis),
        _in_map_table(diagnosis),
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
    letters: dict[str, str] = {}
    for k, group in enumerate(alias_groups_of(diagnosis)):
        for name in group:
            letters.setdefault(name, chr(ord("A") + k % 26))
    accepted = diagnosis.accepted
    ranked = [f for f in diagnosis.ranked if f.rank]
    rows = []
    for r in ranked[: len(accepted) + shown] if shown else ranked:
        name = r.name
        change = changes.get(name)
        _, after = before_and_after(diagnosis, r, changes)
        rows.append(
            (
                f"{'✓ ' if name in accepted else ''}{name}",
                letters.get(name, ""),
                probability(r.probability),
                probability(r.p_value),
                sizes_in_words((change.parameters if change is not None else ()) or screened_sizes(r)),
                "" if r.plausible else say("text.no"),
                _held_out(diagnosis, name),
                micrometres(after),
                micrometres(None if change is None else change.map_change_rms),
            )
        )
    title = say("found.none_named" if diagnosis.verdict == "unexplained" else "found.candidates")
    left = len(ranked) - len(rows)
    before = quantity(rms(Pool(diagnosis.fits[0]).residuals), "m")
    notes = [say("found.note_found")] if accepted else []
    # Columns of which nothing is known are not shown.
    notes += [say("found.note_group")] if any(row[1] for row in rows) else []
    notes += [say("found.note_p"), say("head.size_u")]
    notes += [say("found.note_cross")] if any(row[6] for row in rows) else []
    notes += [say("found.note_residual"), say("found.note_without", size=before)]
    if accepted:
        notes.append(say("found.note_others"))
    if any(not r.plausible for r in ranked):
        notes.append(say("found.note_plausible"))
    if left:
        notes.append(say("found.note_left", n=left))
    columns = heads(
        *("effect", "group", "probability", "p_value", "size", "plausible", "cross_validation"),
        *("residual_um", "map_moves_um"),
    )
    return TextTable(title, columns, tuple(rows), together(notes, "; "))


def _held_out(diagnosis: Diagnosis, name: str) -> str:
    """How an effect does on readings that were left out; empty where that was not asked."""
    gains = [p.gain for p in diagnosis.predicted.get(name, ())]
    return f"{100 * min(gains):+.0f} %" if gains else ""


def _outliers(diagnosis: Diagnosis) -> TextTable:
    rows = tuple(
        (str(o.row), f"{o.studentized:+.1f}", micrometres(o.deviation, signed=True))
        for o in sorted(diagnosis.gross_errors, key=lambda o: o.row)
    )
    columns = heads("row", "times_expected", "deviation_um")
    return TextTable(say("found.outliers"), columns, rows, say("found.note_outliers"))


def _structure(diagnosis: Diagnosis) -> TextTable:
    left = diagnosis.search.left
    rows = tuple((s.covariate, s.shape, probability(s.p_value), f"{100 * s.share:.0f} %") for s in left[:_SHOWN])
    note = say("text.more", n=len(left) - _SHOWN) if len(left) > _SHOWN else ""
    return TextTable(say("found.structure"), heads("covariate", "shape", "p_value", "share"), rows, note)


def _confounded(diagnosis: Diagnosis, advice: Advice) -> TextTable:
    rows = []
    for s in advice.separations:
        found = s.effects[0] in diagnosis.accepted
        rows.append(
            (
                ", ".join(s.effects),
                s.measure,
                duration(s.seconds),
                s.aside,
                f"{s.cosine_before:.2f} → {s.cosine_after:.2f}" if s.kind is not None else "",
                f"{s.apart_before:.1f} → {s.apart_after:.1f}" if found else "",
            )
        )
    columns = heads("confounded", "to_distinguish", "time", "besides", "cosine", "apart")
    notes = [say("found.note_cosine"), *([say("found.note_apart")] if any(row[-1] for row in rows) else [])]
    return TextTable(say("found.confounded"), columns, tuple(rows), together(notes, "; "))


def _next(advice: Advice) -> TextTable:
    rows = tuple(
        (
            v.effect,
            v.measure,
            duration(v.seconds),
            v.aside,
            say("found.not_at_all") if v.before is None else quantity(v.before, v.unit),
            quantity(v.after, v.unit),
        )
        for v in advice.visibilities
    )
    columns = heads("effect", "to_detect", "time", "besides", "smallest_now", "then")
    return TextTable(say("found.hardly"), columns, rows)


def _detectable(diagnosis: Diagnosis) -> TextTable:
    rows = []
    for found in diagnosis.search.findings:
        sizes = smallest_sizes(found)
        if sizes:
            rows.append((found.name, *_smallest(found, sizes)))
    rows.sort()
    return TextTable(say("found.detectable"), heads("effect", "smallest", "occurs"), tuple(rows))


def _smallest(ranked: Finding, sizes: Mapping[str, float | None]) -> tuple[str, str]:
    known = {s.coefficient.name: s.coefficient for s in ranked.sizes}
    first = known[next(iter(sizes))]
    seen = {name: value for name, value in sizes.items() if value is not None}
    text: str
    if not seen:
        text = say("found.none_occurs")
    elif len(sizes) <= _MANY:
        text = ", ".join(f"{name}: {quantity(value, known[name].unit)}" for name, value in seen.items())
    else:
        ends = range_of(min(seen.values()), max(seen.values()), first.unit)
        many = len(sizes) if len(seen) == len(sizes) else say("text.of", n=len(seen), count=len(sizes))
        text = say("text.coefficients", n=many, one=ends)
    return text, range_of(first.low, first.high, first.unit)


def _excluded(diagnosis: Diagnosis) -> TextTable:
    by: dict[str, list[str]] = {}
    for name, why in diagnosis.excluded.items():
        by.setdefault(why, []).append(name)
    longest_last = sorted(by.items(), key=lambda entry: len(entry[1]))
    rows = tuple((", ".join(names), why) for why, names in longest_last)
    return TextTable(say("found.excluded"), heads("effect", "why"), rows)


def diagnosis_parts(found: Diagnosis, then: Conclusions, *, details: bool = False) -> Iterator[Part]:
    """The verdict, the effects and the next step; with details all words, all tables and all effects."""
    if details:
        report = diagnosis_report(found, then.advice, then.changes, shown=0)
        yield from (*report.words, *report.forecast)
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
    others = [finding for finding in ranked if finding not in own][:_FEW]
    likely = [finding for finding in others if finding.probability > AS_GOOD]
    rows = tuple(_sized(diagnosis, finding, changes) for finding in ([*own, *likely] if own else others))
    title = "looked_for" if not own else "found_and" if likely else "found"
    return TextTable(say(f"found.{title}"), heads("effect", "probability", "size_u", "residual_then_um"), rows)


def _sized(diagnosis: Diagnosis, finding: Finding, changes: Mapping[str, Consequence]) -> tuple[str, ...]:
    change = changes.get(finding.name)
    sizes = sizes_in_words((change.parameters if change is not None else ()) or screened_sizes(finding))
    _, after = before_and_after(diagnosis, finding, changes)
    name = f"{'✓ ' if finding.name in diagnosis.accepted else ''}{finding.name}"
    return name, probability(finding.probability), sizes, micrometres(after)
