# SPDX-License-Identifier: Apache-2.0
"""What stands in the report, section by section: sentences, tables and pictures."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import groupby
from typing import Any

import numpy as np

from machine_tool_calibration.plots.budget import draw_budget
from machine_tool_calibration.plots.improve import draw_improvement
from machine_tool_calibration.report.evaluation import Evaluation
from machine_tool_calibration.report.figures import (
    Picture,
    map_pictures,
    motion_pictures,
    residual_pictures,
    standard_pictures,
    translated,
)
from machine_tool_calibration.report.turnable import turnable
from machine_tool_calibration.reports.budget import budget_tables
from machine_tool_calibration.reports.comparison import records, times_declared
from machine_tool_calibration.reports.conformity import conformity_table, decision_words
from machine_tool_calibration.reports.diagnosis import diagnosis_report
from machine_tool_calibration.reports.direct_deviations import direct_tables
from machine_tool_calibration.reports.goodness import fits
from machine_tool_calibration.reports.identification import (
    datum_words,
    goodness_of_fit,
    group_by_reason,
    readings_set_aside,
    summary_rows,
)
from machine_tool_calibration.reports.information import setup_place
from machine_tool_calibration.reports.quantities import (
    NOT_DETERMINED,
    decimals,
    fixed,
    micrometres,
    plus_minus,
    probability,
    quantity,
    rounded,
    sizes_in_words,
)
from machine_tool_calibration.reports.result_tables import error_motions
from machine_tool_calibration.reports.signs import negative_words
from machine_tool_calibration.reports.standards import STANDARDS, standard_tables
from machine_tool_calibration.reports.tables import TextTable
from machine_tool_calibration.reports.values import value_tables
from machine_tool_calibration.session.provenance import flattened
from machine_tool_calibration.session.session import Session
from machine_tool_calibration.session.summary import summarize
from machine_tool_calibration.words import Verbatim, Words

__all__ = ["Section", "Turnable", "sections"]

# Setups that are listed.
_SETUPS = 20
_ENVIRONMENT = ("temperature", "air_pressure", "relative_humidity")


@dataclass(frozen=True)
class Turnable:
    """A drawing in space: what plotly.js takes."""

    drawing: dict[str, Any]


@dataclass
class Section:
    """A section of the report.

    Attributes:
        id: for links.
        title: its heading.
        blocks: what stands in it: sentences, tables, pictures, drawings in space.
    """

    id: str
    title: str
    blocks: list[str | TextTable | Picture | Turnable] = field(default_factory=list)

    def rows(self) -> Iterator[tuple[bool, list[str | TextTable | Picture | Turnable]]]:
        """Blocks that follow each other: those as wide as the page, and narrow pictures, which stand side by side."""
        for narrow, blocks in groupby(self.blocks, lambda one: isinstance(one, Picture) and one.narrow):
            yield not narrow, list(blocks)


def sections(found: Evaluation, words: Words) -> list[Section]:
    """The report's content, in the order in which it is read; without sections of what there is not."""
    parts = {
        "summary": _summary(found, words),
        "measurement": _measurement(found, words),
        **{name: _standard(found, name, words) for name in STANDARDS},
        "map": _map(found, words),
        "motions": _motions(found, words),
        "reproducibility": _reproducibility(found, words),
        "residuals": _residuals(found, words),
        "diagnosis": _diagnosis(found, words),
        "improvement": _improvement(found, words),
        "budget": _budget(found, words),
        "conformity": _conformity(found, words),
        "undetermined": _undetermined(found, words),
        "rejected": _rejected(found, words),
        "provenance": _provenance(found, words),
    }
    out = []
    for name, blocks in parts.items():
        section = Section(name, words(f"section_{name}"), [_translated(block, words) for block in blocks])
        if section.blocks:
            out.append(section)
    return out


def _translated(block: str | TextTable | Picture | Turnable, words: Words) -> str | TextTable | Picture | Turnable:
    """Tables of other rooms are in English; what this one writes is in the report's language, but for its numbers."""
    if isinstance(block, str):
        return words.numbers(block)
    if not isinstance(block, TextTable):
        return block
    used = [k for k in range(len(block.columns)) if any(row[k] for row in block.rows)]
    return TextTable(
        words.numbers(words.phrase(block.title)),
        tuple(words.phrase(block.columns[k]) for k in used),
        tuple(tuple(_cell(row[k], words) for k in used) for row in block.rows),
        words.numbers(words.phrase(block.note)),
    )


def _cell(text: str, words: Words) -> str:
    return text if isinstance(text, Verbatim) else words.numbers(words.phrase(text).strip())


def _summary(found: Evaluation, words: Words) -> Iterator[str | TextTable]:
    document = found.document
    if "agreement" in document:
        yield words.phrase(document["agreement"]["statement"])
    if found.conformity is not None:
        yield words.phrase(decision_words(found.conformity))
    yield words.phrase(goodness_of_fit(document))
    if fits(document["p_value"]) == "bad" and "one_direction" not in (document["error_map"].get("scatter") or {}):
        yield words("only_if_right")
    complete = "u_is_general" if found.general else "u_is_complete"
    yield words(complete if document["uncertainty"] == "budget" else "u_is_incomplete")
    yield words("model_is", model=", ".join([words.phrase(found.result.model_name), *document["effects"]]))
    yield TextTable("", ("", ""), tuple(summary_rows({**document, "not_determined": []})))
    if document["effects"]:
        yield _effects(found, words)
        yield from map(words.phrase, negative_words(found.result.joint, document["effects"]))
    for text in document["suspicious"]:
        yield words("suspicious", what=words.phrase(text))


def _measurement(found: Evaluation, words: Words) -> Iterator[str | TextTable]:
    measured = found.measured
    for label, session in zip(measured.chosen.labels or ("",), measured.recorded, strict=True):
        if label:
            yield words("session_named", label=label)
        about = tuple(
            (_said(name, words), Verbatim(value))
            for name, value in flattened(session.description.about)
            if value.strip()
        )
        if about:
            yield TextTable(words("about"), ("", ""), about)
        yield _set_up(session, words)
        yield _setups(session, words)
        yield _environment(session, words)


def _said(name: str, words: Words) -> str:
    """A name of descriptive data for people: `instruments[1].serial` is `instruments 1, serial`."""
    parts = re.sub(r"\[(\d+)\]", r" \1", name.replace("_", " ")).split(".")
    return ", ".join(words.phrase(part) for part in parts)


def _set_up(session: Session, words: Words) -> TextTable:
    summary, description = summarize(session), session.description
    travel = ", ".join(
        f"{axis.upper()} " + " … ".join(f"{np.degrees(v) if axis in 'abc' else 1e3 * v:g}" for v in ends)
        + (" °" if axis in "abc" else " mm")
        for axis, ends in description.machine.travel.items()
    )  # fmt: skip
    rows = [
        (words("method"), words.phrase(session.method.replace("_", " "))),
        (words("instrument"), words.phrase((session.instrument or "").replace("_", " "))),
        (words("chain"), description.machine.chain),
        (words("travel"), travel),
        (words("readings"), words("readings_of", count=summary.readings, missing=summary.missing)),
        (words("places"), str(summary.targets)),
        (words("declared_u"), quantity(session.sigma, "m")),
    ]
    if summary.duration is not None:
        rows.insert(-1, (words("duration"), f"{summary.duration / 60.0:.0f} min"))
    return TextTable(words("what_and_how"), ("", ""), tuple(row for row in rows if row[1]))


def _setups(session: Session, words: Words) -> TextTable:
    rows = [
        (Verbatim(own.id), setup_place(setup), str(own.readings), str(own.repeats))
        for setup, own in zip(session.description.setups, summarize(session).setups, strict=True)
    ]
    note = words("more_rows", count=len(rows) - _SETUPS) if len(rows) > _SETUPS else ""
    heads = (words("setup"), words("place"), words("readings"), words("repeats"))
    return TextTable(words("setups"), heads, tuple(rows[:_SETUPS]), note)


def _environment(session: Session, words: Words) -> TextTable:
    rows = []
    for name, values in session.readings.columns.items():
        if name.startswith(_ENVIRONMENT) and np.isfinite(values).any():
            scale, unit = (1e-2, "hPa") if name == "air_pressure" else (1e2, "%") if "humidity" in name else (1.0, "°C")
            low, high = (f"{scale * float(end):.2f}" for end in (np.nanmin(values), np.nanmax(values)))
            rows.append((words.phrase(name), low, high, unit))
    return TextTable(words("environment"), ("", words("lowest"), words("highest"), words("unit")), tuple(rows))


def _map(found: Evaluation, words: Words) -> Iterator[str | TextTable | Picture | Turnable]:
    yield from map_pictures(found, words)
    drawing = turnable(found.result, words)
    if drawing is not None:
        yield Turnable(drawing)
    for part in direct_tables(found.document["error_map"]):
        yield words.phrase(part) if isinstance(part, str) else part


def _standard(found: Evaluation, name: str, words: Words) -> Iterator[str | TextTable | Picture]:
    """Figures of a standard and its plot, of ISO 230-2 one run after the other."""
    content = found.document["error_map"]
    entry = content.get(name) or ()
    for one in [[run] for run in entry] if name == "iso230_2" else [entry]:
        own = {**content, name: one}
        for part in standard_tables(own, name):
            yield words.phrase(part) if isinstance(part, str) else part
        yield from standard_pictures(own, name, words)


def _effects(found: Evaluation, words: Words) -> TextTable:
    """Effects in the model, with what was found of them."""
    rows = [
        (_title(name, found, words), name, sizes_in_words([p for p in found.result.parameters if p.owner == name]))
        for name in found.document["effects"]
    ]
    return TextTable(words("effects_in_model"), (words("effect"), "id", words("size_u")), tuple(rows))


def _title(name: str, found: Evaluation, words: Words) -> str:
    return words.phrase(found.titles[name]) if name in found.titles else name


def _motions(found: Evaluation, words: Words) -> Iterator[str | TextTable | Picture]:
    table = error_motions(found.result)
    known = table[table["determined"].astype(bool)]
    single = tuple(
        (str(row["motion"]), plus_minus(row["value"], row["u"], 1e6), f"µ{row['unit']}")
        for row in known[known["position"].isna()].to_dict("records")
    )
    if not len(table):
        yield words("no_motions")
    yield from value_tables(found.result)
    if single:
        yield TextTable(words("squareness"), ("", words("value_u"), words("unit")), single)
    yield from motion_pictures(found, words)


def _reproducibility(found: Evaluation, words: Words) -> Iterator[str | TextTable]:
    rows = [
        (
            words(f"spread_{one['family']}"),
            quantity(one["size"], "m"),
            f"{quantity(one['interval'][0], 'm')} … {quantity(one['interval'][1], 'm')}",
            probability(one["probability"]),
        )
        for one in found.document["spread"]
    ]
    if not rows:
        yield words("nothing_spreads")
        return
    yield words("spread_is")
    heads = (words("between"), words("size_rms"), words("interval"), words("spread_probability"))
    yield TextTable("", heads, tuple(rows))


def _residuals(found: Evaluation, words: Words) -> Iterator[str | TextTable | Picture]:
    labels = found.measured.chosen.labels or ("",)
    rows = [
        (Verbatim(label), Verbatim(one["name"]), str(one["readings"]), micrometres(one["rms"]),
         times_declared(one["reduced_chi_square"]))
        for label, comparison in zip(labels, found.comparisons, strict=True) for one in records(comparison.setups)
    ]  # fmt: skip
    heads = (words("session"), words("setup"), words("readings"), words("residual_um"), words("over_declared"))
    note = words("more_rows", count=len(rows) - _SETUPS) if len(rows) > _SETUPS else ""
    yield TextTable(words("by_setup"), heads, tuple(rows[:_SETUPS]), note)
    yield from residual_pictures(found, words)


def _diagnosis(found: Evaluation, words: Words) -> Iterator[str | TextTable]:
    """As `mtcal diagnose` tells it."""
    if found.improvement is None or found.conclusions is None:
        return
    told = diagnosis_report(found.improvement.diagnosis, found.conclusions.advice, found.conclusions.changes)
    for paragraph in told.words:
        yield words.phrase(paragraph)
    yield from told.tables


def _improvement(found: Evaluation, words: Words) -> Iterator[str | TextTable | Picture]:
    heads = (words("step"), words("readings"), words("residual_um"), "χ²/ν", words("map_um"), words("map_u_um"))
    if found.measured.history:
        rows = [
            (f"{entry.number}: {_change(entry.change, words)}", entry.used, entry.rms_residual,
             entry.reduced_chi_square, entry.map_rms, None if found.budget else entry.map_uncertainty_rms)
            for entry in found.measured.history
        ]  # fmt: skip
        yield TextTable(words("steps_history"), heads, tuple(map(_step, rows)))
    done = found.improvement
    if done is not None and len(done.steps) > 1:
        rows = [
            (_change(step.change, words), step.result.joint.assembly.problem.n_readings, step.result.rms_residual,
             step.reduced_chi_square, step.map_rms, step.map_uncertainty)
            for step in done.steps
        ]  # fmt: skip
        yield TextTable(words("steps"), heads, tuple(map(_step, rows)))
        yield translated("improve", words("figure_improve"), draw_improvement(done), words)


def _change(change: str, words: Words) -> str:
    return words.phrase(change) if change else words("first_model")


def _step(row: tuple[str, int, float, float | None, float | None, float | None]) -> tuple[str, ...]:
    name, readings, residual, chi, size, u = row
    error, expanded = (micrometres(size), NOT_DETERMINED) if u is None or size is None else _with_digits(size, 2 * u)
    return (name, str(readings), micrometres(residual), rounded(chi), error, expanded)


def _with_digits(size: float, expanded: float) -> tuple[str, str]:
    """An error and its expanded uncertainty in µm, with as many decimals as leave this two figures."""
    places = decimals(1e6 * expanded) if expanded > 0.0 else 3
    return fixed(1e6 * size, places), fixed(1e6 * expanded, places)


def _budget(found: Evaluation, words: Words) -> Iterator[str | TextTable | Picture]:
    if found.budget is not None:
        for part in budget_tables(found.budget):
            yield words.phrase(part) if isinstance(part, str) else part
        yield translated("budget", words("figure_budget"), draw_budget(found.budget), words)


def _conformity(found: Evaluation, words: Words) -> Iterator[str | TextTable]:
    if found.conformity is not None:
        yield words.phrase(decision_words(found.conformity))
        yield conformity_table(found.conformity)


def _undetermined(found: Evaluation, words: Words) -> Iterator[str | TextTable]:
    document = found.document
    rows = tuple(
        (names, words.phrase(why))
        for why, names in group_by_reason((entry["name"], entry["why"]) for entry in document["not_determined"])
    )
    if rows:
        yield TextTable("", (words("what"), words("why")), rows)
    else:
        yield words("all_determined")
    yield words("datum", datum=words.phrase(datum_words(document)))


def _rejected(found: Evaluation, words: Words) -> Iterator[str | TextTable]:
    document = found.document
    table = readings_set_aside(document, found.measured.recorded)
    yield words("used_of", used=document["used"], count=document["observations"])
    if table.rows:
        yield TextTable(table.title, table.columns, table.rows)


def _provenance(found: Evaluation, words: Words) -> Iterator[TextTable]:
    origin = found.result.provenance
    rows = [(words("evaluated"), origin.evaluated), (words("software"), Verbatim(origin.software))]
    rows.append((words("model"), ", ".join([origin.model, *origin.effects])))
    for one in origin.sessions:
        where = f" ({one.label})" if one.label else ""
        if one.measured:
            rows.append((words("measured_on") + where, one.measured))
        rows.append((words("sha256") + where, one.sha256))
    if len(origin.sessions) > 1:
        rows.append((words("sha256_all"), origin.sha256))
    yield TextTable("", ("", ""), tuple(rows), words("sha256_note"))
