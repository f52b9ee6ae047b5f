# SPDX-License-Identifier: Apache-2.0
"""What stands in the report, section by section: sentences, tables and pictures."""

import re
from collections.abc import Container, Iterator, Sequence
from dataclasses import dataclass, field, replace
from itertools import groupby, islice
from typing import Any

import numpy as np

from machine_tool_calibration.plots.budget import draw_budget
from machine_tool_calibration.plots.diagnosis import draw_improvement
from machine_tool_calibration.report import figures
from machine_tool_calibration.report.evaluation import Evaluation
from machine_tool_calibration.reports import identification
from machine_tool_calibration.reports.budget import budget_parts, conformity_parts, decision_words
from machine_tool_calibration.reports.comparison import records, times_declared
from machine_tool_calibration.reports.diagnosis import diagnosis_report
from machine_tool_calibration.reports.goodness import effect_words, free_words
from machine_tool_calibration.reports.history import tried_models
from machine_tool_calibration.reports.improvement import steps_table
from machine_tool_calibration.reports.information import session_tables
from machine_tool_calibration.reports.quantities import micrometres, plus_minus, quantity, sizes_in_words
from machine_tool_calibration.reports.result_tables import error_motions
from machine_tool_calibration.reports.tables import TextTable, heads
from machine_tool_calibration.reports.values import STANDARDS, standard_rows, standard_tables, value_tables
from machine_tool_calibration.session.provenance import flattened
from machine_tool_calibration.session.session import Session
from machine_tool_calibration.session.summary import summarize
from machine_tool_calibration.words import Verbatim, Words, named, say, together

_SETUPS = 20  # setups that are listed


@dataclass(frozen=True)
class Turnable:
    """A drawing in space: what plotly.js takes."""

    drawing: dict[str, Any]


Block = str | TextTable | figures.Picture | Turnable
"""What stands in a section: a sentence, a table, a picture, a drawing in space."""


@dataclass
class Section:
    """A section of the report."""

    id: str  # for links
    title: str  # its heading
    # what stands in it: sentences, tables, pictures, drawings in space
    blocks: list[Block] = field(default_factory=list)

    def rows(self) -> Iterator[tuple[int, list[Block]]]:
        """Blocks that follow each other, and how many of them stand side by side."""
        for beside, blocks in groupby(self.blocks, lambda one: one.beside if isinstance(one, figures.Picture) else 1):
            same = list(blocks)
            yield min(beside, len(same)), same


def sections(found: Evaluation, words: Words, only: Container[str] | None = None) -> list[Section]:
    """The report's content in a language, in the order in which it is read; without sections of what there is not.

    `only` has the ids of the sections that are made; all if None.
    """
    parts = {
        "summary": _summary(found),
        "measurement": _measurement(found),
        **{name: _standard(found, name) for name in STANDARDS},
        "map": _map(found, words),
        "motions": _motions(found),
        "residuals": _residuals(found),
        "diagnosis": _diagnosis(found),
        "improvement": _improvement(found),
        "budget": _budget(found),
        "conformity": conformity_parts(found.conformity) if found.conformity is not None else (),
        "undetermined": _undetermined(found),
        "rejected": _rejected(found),
        "provenance": _provenance(found),
    }
    out = []
    for name, blocks in ((name, blocks) for name, blocks in parts.items() if only is None or name in only):
        section = Section(name, words(f"report.section_{name}"), [in_language(block, words) for block in blocks])
        if section.blocks:
            out.append(section)
    return out


def in_language(block: Block, words: Words) -> Block:
    """A block in the report's language; of a table the columns in which there is anything."""
    if isinstance(block, str):
        return words.numbers(block)
    if isinstance(block, figures.Picture):
        return figures.told(block, words)
    if not isinstance(block, TextTable):
        return block
    table = block.filled()
    title, note = map(words.numbers, (table.title, table.note))
    rows = tuple(tuple(_cell(text, words) for text in row) for row in table.rows)
    return TextTable(title, tuple(map(words.told, table.columns)), rows, note)


def _cell(text: str, words: Words) -> str:
    return text if isinstance(text, Verbatim) else words.numbers(words.told(text).strip())


def _summary(found: Evaluation) -> Iterator[str | TextTable]:
    document = found.document
    if "agreement" in document:
        yield document["agreement"]["statement"]
    if found.conformity is not None:
        yield decision_words(found.conformity)
    yield identification.goodness_of_fit(document)
    yield from free_words(document)
    yield from identification.spread_words(document)
    complete = "u_is_general" if found.general else "u_is_complete"
    yield say(f"report.{complete if document['uncertainty'] == 'budget' else 'u_is_incomplete'}")
    yield say("report.model_is", model=_model(found.result.model_name, document["effects"]))
    rows = [*identification.summary_rows({**document, "not_determined": []}), *standard_rows(document["error_map"])]
    yield TextTable("", ("", ""), tuple(rows))
    if document["effects"]:
        yield _effects(found)
        yield from effect_words(found.result.joint, document["effects"])
    for text in document["suspicious"]:
        yield say("diagnosis.suspicious", what=text)


def _model(variant: str, effects: Sequence[str]) -> str:
    return together((named("variant", variant), *effects), ", ")


def _measurement(found: Evaluation) -> Iterator[str | TextTable]:
    measured = found.measured
    for label, session in zip(measured.chosen.labels or ("",), measured.recorded, strict=True):
        if label:
            yield say("report.session_named", label=label)
        about = [(name, value) for name, value in flattened(session.description.about) if value.strip()]
        if about:
            rows = tuple((_said(name), Verbatim(value)) for name, value in about)
            yield TextTable(say("report.about"), ("", ""), rows)
        yield set_up(session)
        yield next(session_tables(session, summarize(session)))  # of setups


def _said(name: str) -> str:
    """A name of descriptive data for people: `instruments[1].serial` is `instruments 1, serial`."""
    parts = (re.fullmatch(r"(.*?)(?:\[(\d+)\])?", part) for part in name.replace("_", " ").split("."))
    named_parts = ((named("about", part[1]), part[2]) for part in parts if part is not None)
    return together((together((text, number)) if number else text for text, number in named_parts), ", ")


def set_up(session: Session) -> TextTable:
    """What was measured and how, in figures."""
    summary, description = summarize(session), session.description
    travel = ", ".join(
        f"{axis.upper()} " + " … ".join(f"{np.degrees(v) if axis in 'abc' else 1e3 * v:g}" for v in ends)
        + (" °" if axis in "abc" else " mm")
        for axis, ends in description.machine.travel.items()
    )  # fmt: skip
    rows = [
        (say("head.method"), named("method", session.method.replace("_", " "))),
        (say("about.instrument"), named("instrument", (session.instrument or "").replace("_", " "))),
        (say("report.chain"), description.machine.chain),
        (say("report.travel"), travel),
        (say("head.readings"), say("report.readings_of", count=summary.readings, missing=summary.missing)),
        (say("report.places"), str(summary.targets)),
        (say("report.declared_u"), quantity(session.sigma, "m")),
    ]
    if summary.duration is not None:
        rows.insert(-1, (say("report.duration"), f"{summary.duration / 60.0:.0f} min"))
    return TextTable(say("report.what_and_how"), ("", ""), tuple(row for row in rows if row[1]))


def _map(found: Evaluation, words: Words) -> Iterator[str | TextTable | figures.Picture | Turnable]:
    yield from figures.map_pictures(found)
    if (drawing := figures.turnable(found.result, words)) is not None:
        yield Turnable(drawing)


def _standard(found: Evaluation, name: str) -> Iterator[str | TextTable | figures.Picture]:
    """Figures of a standard and its plot, of ISO 230-2 one run after the other."""
    content = found.document["error_map"]
    entry = content.get(name) or ()
    for one in [[run] for run in entry] if name == "iso230_2" else [entry]:
        own = {**content, name: one}
        yield from standard_tables(own, name)
        yield from figures.standard_pictures(own, name)


def _effects(found: Evaluation) -> TextTable:
    rows = [
        (found.titles.get(name, name), name, sizes_in_words([p for p in found.result.parameters if p.owner == name]))
        for name in found.document["effects"]
    ]
    (effect, size) = heads("effect", "size_u")
    return TextTable(say("report.effects_in_model"), (effect, "id", size), tuple(rows))


def _motions(found: Evaluation) -> Iterator[str | TextTable | figures.Picture]:
    table = error_motions(found.result)
    others = identification.parameters_table(found.document, found.result.joint)
    known = table[table["determined"].astype(bool) & ~table["motion"].isin([row[0] for row in others.rows])]
    single = tuple(
        (str(row["motion"]), plus_minus(row["value"], row["u"], 1e6), f"µ{row['unit']}")
        for row in known[known["position"].isna()].to_dict("records")
    )
    if not len(table):
        yield say("report.no_motions")
    yield from value_tables(found.result)
    if single:
        yield TextTable(say("report.squareness"), heads("", "value_u", "unit"), single)
    yield from figures.motion_pictures(found)
    if others.rows:
        yield others


def _residuals(found: Evaluation) -> Iterator[str | TextTable | figures.Picture]:
    labels = found.measured.chosen.labels or ("",)
    rows = [
        (Verbatim(label), Verbatim(one["name"]), str(one["readings"]), micrometres(one["rms"]),
         times_declared(one["reduced_chi_square"]))
        for label, comparison in zip(labels, found.comparisons, strict=True) for one in records(comparison.setups)
    ]  # fmt: skip
    columns = heads("session", "setup", "readings", "residual_um_rms", "over_declared")
    note = say("text.more", n=len(rows) - _SETUPS) if len(rows) > _SETUPS else ""
    yield TextTable(say("report.by_setup"), columns, tuple(rows[:_SETUPS]), note)
    yield from figures.residual_pictures(found)


def _diagnosis(found: Evaluation) -> Iterator[str | TextTable]:
    if found.improvement is None or found.conclusions is None:
        return
    report = diagnosis_report(found.improvement.diagnosis, found.conclusions.advice, found.conclusions.changes)
    judged, used = found.improvement.diagnosis.fits[0].assembly.problem.n_readings, found.document["used"]
    if judged != used:
        yield say("report.judged_anew", count=judged, used=used)
    yield from report.words
    yield from (_entitled(table, found) for table in report.tables)


def _entitled(table: TextTable, found: Evaluation) -> TextTable:
    """A table with the titles of effects in the place of their ids."""

    def told(text: str) -> str:
        mark, name = ("✓ ", text[2:]) if text.startswith("✓ ") else ("", text)
        title = found.titles.get(name)
        return text if title is None else together((mark, title), "")

    return replace(table, rows=tuple(tuple(map(told, row)) for row in table.rows))


def _improvement(found: Evaluation) -> Iterator[str | TextTable | figures.Picture]:
    if history := found.measured.history:
        yield tried_models(history, history[-1].number)
    done = found.improvement
    if done is not None and len(done.steps) > 1:
        yield _entitled(steps_table(done), found)
        yield figures.Picture("improve", say("report.figure_improve"), draw_improvement(done))


def _budget(found: Evaluation) -> Iterator[str | TextTable | figures.Picture]:
    if found.budget is not None:
        yield from budget_parts(found.budget)
        yield figures.Picture("budget", say("report.figure_budget"), draw_budget(found.budget))


def _undetermined(found: Evaluation) -> Iterator[str | TextTable]:
    document = found.document
    lost = document["not_determined"]
    found_why = identification.group_by_reason(((one["name"], one["why"]) for one in lost), len(lost))
    if found_why:
        yield TextTable("", heads("what", "why"), tuple((names, why) for why, names in found_why))
    else:
        yield say("report.all_determined")
    # Directions of the machine that no reading senses are no unknowns of the model.
    errors = np.array((document["error_map"] or {}).get("position_error", ()), dtype=float)
    names = [axis for axis, column in zip("xyz", errors.T, strict=False) if np.isnan(column).all()]
    if names and len(names) < len(errors.T):
        yield say("report.not_measured_along", names=", ".join(names))
    yield say("report.datum", datum=identification.datum_words(document))


def _rejected(found: Evaluation) -> Iterator[str | TextTable]:
    document = found.document
    yield say("report.used_of", used=document["used"], count=document["observations"])
    table = replace(identification.readings_set_aside(document, found.measured.recorded), note="")
    if table.rows:
        yield table


def _provenance(found: Evaluation) -> Iterator[TextTable]:
    origin = found.result.provenance
    rows: list[tuple[str, str]] = [(say("report.evaluated"), origin.evaluated.replace("T", " "))]
    rows += [(say("about.software"), Verbatim(origin.software))]
    rows.append((say("head.model"), _model(origin.model, origin.effects)))
    for one in origin.sessions:
        for key, value in (("measured_on", one.measured), ("sha256", one.sha256)):
            what = say(f"report.{key}")
            if value:
                rows.append((say("text.in_brackets", text=what, more=one.label) if one.label else what, value))
    if len(origin.sessions) > 1:
        rows.append((say("report.sha256_all"), origin.sha256))
    yield TextTable("", ("", ""), tuple(rows), say("report.sha256_note"))
    for session in found.measured.recorded:
        yield from islice(session_tables(session, summarize(session)), 1, 2)  # of columns
