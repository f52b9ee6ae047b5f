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
from machine_tool_calibration.planning.dominant import Dominant
from machine_tool_calibration.reports.diagnosis_document import screened_sizes, smallest_sizes
from machine_tool_calibration.reports.quantities import (
    duration,
    micrometres,
    probability,
    quantity,
    range_of,
    sizes_in_words,
)
from machine_tool_calibration.reports.tables import TextTable, show_table
from machine_tool_calibration.reports.unknowns import unknowns_in_words
from machine_tool_calibration.reports.verdict import AS_GOOD, next_step, verdict_words
from machine_tool_calibration.residuals.pool import Pool
from machine_tool_calibration.session.catalogue import spec_of

if TYPE_CHECKING:
    from rich.console import Console

    from machine_tool_calibration.planning.what_to_measure import Conclusions

__all__ = [
    "Report",
    "diagnosis_report",
    "dominant_words",
    "show_diagnosis",
]


def dominant_words(found: Dominant) -> Iterator[str]:
    """Sentences; where the scatter of the readings dominates, only more of them help, and nothing is proposed.

    In shares: what U is, the map says, and the sizes assumed here are no part of that.
    """
    if found.cause == "readings":
        yield (
            f"the readings' own scatter dominates the map's uncertainty: {100 * found.shares['readings']:.0f} % of its "
            "variance; more repeats help"
        )
        return
    share = f"{100 * found.shares[found.cause]:.0f} % of its variance"
    assumed = f"angular errors of {quantity(found.angular, 'rad')}"
    if found.cause == "time":
        assumed = f"a drift of {quantity(found.drift, 'm/s')}"
    yield (
        f"{found.cause} dominate{'s' if found.cause == 'time' else ''} the map's uncertainty: {share}, for {assumed}"
    )
    for remedy in found.remedies:
        besides = f", and {remedy.aside}" if remedy.aside else ""
        time = f" ({duration(remedy.seconds)}{besides})" if remedy.seconds is not None else ""
        again = "" if found.again is None else f", the same once more {100 * found.again / found.uncertainty:.0f} %"
        yield f"  {remedy.measure}{time} leaves {100 * remedy.uncertainty / found.uncertainty:.0f} % of U{again}"
    if not found.remedies:
        yield "  none of the further measurements that were considered does clearly better than the same once more"


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
    heads = ("effect", "coefficient", "what it is", "size ± U (k = 2)")
    return TextTable("What was found, coefficient by coefficient", heads, tuple(rows))


def _in_map_table(diagnosis: Diagnosis) -> TextTable:
    """Errors of the machine that are part of the map already: whatever their size, nothing needs to be added."""
    title = "Errors that the map holds already, whatever their size: nothing needs to be added for them"
    return TextTable(title, ("errors", "they are part of"), _rows(diagnosis, True))


def _hidden_table(diagnosis: Diagnosis) -> TextTable:
    """Effects that would not show, because they are fully correlated with unknowns of the setups or the map."""
    title = "Effects that would not show here: fully correlated with unknowns of the model"
    rows = _rows(diagnosis, False)
    wrong = any(unknown.in_map for a in _absorbed(diagnosis, False) for unknown in a.by[:1])
    note = "taken for an error motion, a squareness or the points, they make the map wrong" if wrong else ""
    return TextTable(title, ("effects", "taken for"), rows, note)


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
        return "unknowns of this model themselves"
    chosen = [unknown for unknown in absorbed.by if unknown.in_map or not of_map]
    if chosen == [POINTS] and spec_of(diagnosis.chosen.sessions[0]).probes_surface:
        return "form of the workpiece: each probed point has an error of its own"
    return unknowns_in_words(chosen) or "the model"


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
                "" if r.plausible else "no",
                _held_out(diagnosis, name),
                micrometres(after),
                micrometres(None if change is None else change.map_change_rms),
            )
        )
    title = "Effects looked for, the most probable first"
    if diagnosis.verdict == "unexplained":
        title = "Effects looked for: none of them is named as the cause"
    left = len(ranked) - len(rows)
    before = quantity(rms(Pool(diagnosis.fits[0]).residuals), "m")
    note = (
        "group: the same letter, confounded effects; p-value: largest chance of so much evidence if nothing is "
        "missing; size ± U (k = 2); "
        "cross-validation: fall of the mean square error of predicting readings left out, worst of setups, blocks of "
        f"places and cycles; residual and map: RMS with it in the model; without any the residual is {before}"
    )
    if accepted:
        note = f"✓ found; {note}; the others as they were before anything was added"
    if any(not r.plausible for r in ranked):
        note += "; plausible: no, if such a size does not occur"
    if left:
        note += f"; {left} less probable {'one is' if left == 1 else 'ones are'} left out"
    heads = (
        *("effect", "group", "probability", "p-value", "size", "plausible", "cross-validation"),
        *("residual / µm", "map moves / µm"),
    )
    return TextTable(title, heads, tuple(rows), note)


def _held_out(diagnosis: Diagnosis, name: str) -> str:
    """How an effect does on readings that were left out; empty where that was not asked."""
    gains = [p.gain for p in diagnosis.predicted.get(name, ())]
    return f"{100 * min(gains):+.0f} %" if gains else ""


def _outliers(diagnosis: Diagnosis) -> TextTable:
    rows = tuple(
        (str(o.row), f"{o.studentized:+.1f}", micrometres(o.deviation, signed=True))
        for o in sorted(diagnosis.gross_errors, key=lambda o: o.row)
    )
    return TextTable(
        "Readings that do not belong to the rest; they were set aside",
        ("row", "× expected", "deviation / µm"),
        rows,
        "× expected: deviation over the scatter that it should have; row 0 is the second line of observations.csv",
    )


def _structure(diagnosis: Diagnosis) -> TextTable:
    left = diagnosis.search.left
    rows = tuple((s.covariate, s.shape, probability(s.p_value), f"{100 * s.share:.0f} %") for s in left[:_SHOWN])
    title = "What the residuals still depend on"
    note = f"{len(left) - _SHOWN} more" if len(left) > _SHOWN else ""
    return TextTable(title, ("covariate", "shape", "p-value", "share of the sum of squares"), rows, note)


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
    heads = ("confounded effects", "to distinguish them", "time", "besides", "cosine", "apart / u")
    note = "cosine: of the angle between their patterns in the readings, now → then; 1: fully correlated"
    if any(row[-1] for row in rows):
        note += "; apart: how far the patterns differ at the size found, in standard uncertainties u"
    return TextTable("Confounded effects, and what to measure next", heads, tuple(rows), note)


def _next(advice: Advice) -> TextTable:
    rows = tuple(
        (
            v.effect,
            v.measure,
            duration(v.seconds),
            v.aside,
            "not at all" if v.before is None else quantity(v.before, v.unit),
            quantity(v.after, v.unit),
        )
        for v in advice.visibilities
    )
    heads = ("effect", "to detect it", "time", "besides", "smallest size: now", "then")
    return TextTable("Effects that hardly show here, and what would show them", heads, rows)


def _detectable(diagnosis: Diagnosis) -> TextTable:
    rows = []
    for found in diagnosis.search.findings:
        sizes = smallest_sizes(found)
        if sizes:
            rows.append((found.name, *_smallest(found, sizes)))
    rows.sort()
    title = "Smallest size that this measurement would have found (80 % power)"
    return TextTable(title, ("effect", "smallest size", "sizes that occur"), tuple(rows))


def _smallest(ranked: Finding, sizes: Mapping[str, float | None]) -> tuple[str, str]:
    known = {s.coefficient.name: s.coefficient for s in ranked.sizes}
    first = known[next(iter(sizes))]
    seen = {name: value for name, value in sizes.items() if value is not None}
    if not seen:
        text = "none that occurs"
    elif len(sizes) <= _MANY:
        text = ", ".join(f"{name}: {quantity(value, known[name].unit)}" for name, value in seen.items())
    else:
        low, high = min(seen.values()), max(seen.values())
        many = f"{len(sizes)}" if len(seen) == len(sizes) else f"{len(seen)} of {len(sizes)}"
        text = f"{many} coefficients, {quantity(low, first.unit)} to {quantity(high, first.unit)}"
    return text, range_of(first.low, first.high, first.unit)


def _excluded(diagnosis: Diagnosis) -> TextTable:
    by: dict[str, list[str]] = {}
    for name, why in diagnosis.excluded.items():
        by.setdefault(why, []).append(name)
    longest_last = sorted(by.items(), key=lambda entry: len(entry[1]))
    rows = tuple((", ".join(names), why) for why, names in longest_last)
    return TextTable("Effects that were not looked for", ("effect", "why"), rows)


def show_diagnosis(
    screen: Console, found: Diagnosis, then: Conclusions, shown: int = _SHOWN, *, details: bool = False
) -> None:
    """The verdict, the effects and the next step; with details all words and all tables.

    Args:
        screen: where.
        found: the diagnosis.
        then: what follows from it.
        shown: of the details, how many candidates beside the accepted ones; 0 for all.
        details: whether they are wanted.
    """
    if not details:
        for paragraph in verdict_words(found, then.changes, then.advice, brief=True):
            screen.print(paragraph)
        show_table(screen, _brief(found, then.changes))
        screen.print(next_step(found, then.advice))
        screen.print(
            "--details: how sure, what is confounded or would not show, smallest sizes, all that was looked for"
        )
        return
    report = diagnosis_report(found, then.advice, then.changes, shown)
    for paragraph in (*report.words, *report.forecast):
        screen.print(paragraph)
    for table in (*report.tables, *report.details):
        show_table(screen, table)


def _brief(diagnosis: Diagnosis, changes: Mapping[str, Consequence]) -> TextTable:
    """The effects found and what may be there instead, or the most probable ones where none is sure."""
    ranked = [finding for finding in diagnosis.ranked if finding.rank]
    own = [finding for finding in ranked if finding.name in diagnosis.accepted]
    others = [finding for finding in ranked if finding not in own][:_FEW]
    likely = [finding for finding in others if finding.probability > AS_GOOD]
    rows = tuple(_sized(diagnosis, finding, changes) for finding in ([*own, *likely] if own else others))
    title = "Found (✓), and what else is probable" if likely else "Found"
    return TextTable(
        title if own else "Looked for, the most probable first",
        ("effect", "probability", "size ± U (k = 2)", "residual then / µm"),
        rows,
    )


def _sized(diagnosis: Diagnosis, finding: Finding, changes: Mapping[str, Consequence]) -> tuple[str, ...]:
    change = changes.get(finding.name)
    sizes = sizes_in_words((change.parameters if change is not None else ()) or screened_sizes(finding))
    _, after = before_and_after(diagnosis, finding, changes)
    name = f"{'✓ ' if finding.name in diagnosis.accepted else ''}{finding.name}"
    return name, probability(finding.probability), sizes, micrometres(after)
