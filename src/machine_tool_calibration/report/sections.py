# SPDX-License-Identifier: Apache-2.0
"""What stands in the report, section by section: sentences, tables and pictures."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import groupby
from typing import Any

import numpy as np

from machine_tool_calibration.model.result import effect_estimates
from machine_tool_calibration.plots.budget import draw_budget
from machine_tool_calibration.plots.improve import draw_improvement
from machine_tool_calibration.report.evaluation import Evaluation
from machine_tool_calibration.report.figures import (
    Picture,
    map_pictures,
    motion_pictures,
    residual_pictures,
    translated,
)
from machine_tool_calibration.report.turnable import turnable
from machine_tool_calibration.report.words import Words
from machine_tool_calibration.reports.budget import budget_tables
from machine_tool_calibration.reports.conformity import conformity_table
from machine_tool_calibration.reports.diagnosis_document import screened_sizes
from machine_tool_calibration.reports.direct_deviations import direct_tables
from machine_tool_calibration.reports.identification import (
    datum_words,
    group_by_reason,
    motion_row,
    readings_set_aside,
    summary_rows,
)
from machine_tool_calibration.reports.information import setup_place
from machine_tool_calibration.reports.quantities import (
    micrometres,
    p_value,
    probability,
    quantity,
    rounded,
    sizes_in_words,
)
from machine_tool_calibration.reports.result_tables import error_motions
from machine_tool_calibration.reports.signs import negative_words
from machine_tool_calibration.reports.tables import TextTable
from machine_tool_calibration.reports.verdict import good_enough, left_words
from machine_tool_calibration.session.provenance import flattened
from machine_tool_calibration.session.session import Session
from machine_tool_calibration.session.summary import summarize

__all__ = ["Section", "Turnable", "sections"]

# p-values at which the fit is called bad, nearly good, or too good.
_BAD, _NEARLY, _TOO_GOOD = 1e-3, 0.05, 1 - 1e-3
# Candidates and setups that are listed.
_CANDIDATES, _SETUPS = 8, 20
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
    """Tables of other rooms are in English; what this one writes is in the report's language already."""
    if not isinstance(block, TextTable):
        return block
    used = [k for k in range(len(block.columns)) if any(row[k] for row in block.rows)]
    return TextTable(
        words.phrase(block.title),
        tuple(words.phrase(block.columns[k]) for k in used),
        tuple(tuple(words.phrase(row[k].strip()) for k in used) for row in block.rows),
        words.phrase(block.note),
    )


def _summary(found: Evaluation, words: Words) -> Iterator[str | TextTable]:
    document = found.document
    ratio, p = document["reduced_chi_square"], document["p_value"]
    if ratio is not None and p is not None:
        fit = "bad" if p < _BAD else "nearly" if p < _NEARLY else "small" if p > _TOO_GOOD else "good"
        yield words(f"fit_{fit}", ratio=rounded(ratio**0.5), p=p_value(p))
    rows = summary_rows({**document, "not_determined": []})
    yield TextTable("", ("", ""), tuple(rows))
    for text in document["suspicious"]:
        yield words("suspicious", what=words.phrase(text))


def _measurement(found: Evaluation, words: Words) -> Iterator[str | TextTable]:
    measured = found.measured
    for label, session in zip(measured.chosen.labels or ("",), measured.recorded, strict=True):
        if label:
            yield words("session_named", label=label)
        about = tuple(
            (_said(name, words), value) for name, value in flattened(session.description.about) if value.strip()
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
        (own.id, setup_place(setup), str(own.readings), str(own.repeats))
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
    document = found.document
    yield words("model_is", model=", ".join([words.phrase(found.result.model_name), *document["effects"]]))
    if document["effects"]:
        yield _effects(found, words)
        yield from map(words.phrase, negative_words(found.result.joint, document["effects"]))
    if "agreement" in document:
        yield words.phrase(document["agreement"]["statement"])
    yield from map_pictures(found, words)
    drawing = turnable(found.result, words)
    if drawing is not None:
        yield Turnable(drawing)
    for part in direct_tables(document["error_map"]):
        if isinstance(part, str):
            yield words.phrase(part)
        else:
            yield part


def _effects(found: Evaluation, words: Words) -> TextTable:
    """Effects in the model, with what was found of them."""
    rows = [
        (_title(name, found, words), name, sizes_in_words(effect_estimates(found.result.joint, [name])))
        for name in found.document["effects"]
    ]
    return TextTable(words("effects_in_model"), (words("effect"), "id", words("size_u")), tuple(rows))


def _title(name: str, found: Evaluation, words: Words) -> str:
    return words.phrase(found.titles[name]) if name in found.titles else name


def _motions(found: Evaluation, words: Words) -> Iterator[str | TextTable | Picture]:
    table = error_motions(found.result)
    known = table[table["determined"].astype(bool)]
    rows, single = [], []
    for name, own in known.groupby("motion", sort=False):
        unit = "µrad" if own["unit"].iloc[0] == "rad" else "µm"
        if own["position"].notna().all():
            count = int((table["motion"] == name).sum())
            rows.append(motion_row(str(name), own["value"].to_numpy(), own["u"].to_numpy(), count, own["unit"].iloc[0]))
        else:
            single.append(
                (str(name), micrometres(float(own["value"].iloc[0])), micrometres(2 * float(own["u"].iloc[0])), unit)
            )
    if not len(table):
        yield words("no_motions")
    heads = (words("motion"), words("values"), words("smallest"), words("largest"), words("u_at_most"), words("unit"))
    if rows:
        yield TextTable(words("motions"), heads, tuple(rows))
    if single:
        yield TextTable(words("squareness"), ("", words("value"), "U (k = 2)", words("unit")), tuple(single))
    yield from motion_pictures(found, words)


def _reproducibility(found: Evaluation, words: Words) -> Iterator[str | TextTable]:
    rows = [
        (
            words.texts.get(f"spread_{one['family']}") or words.phrase(one["family"]),
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
        (label, one.name, str(one.readings), micrometres(one.rms),
         rounded(one.ratio))
        for label, comparison in zip(labels, found.comparisons, strict=True) for one in comparison.setups
    ]  # fmt: skip
    heads = (words("session"), words("setup"), words("readings"), words("residual_um"), words("over_declared"))
    note = words("more_rows", count=len(rows) - _SETUPS) if len(rows) > _SETUPS else ""
    yield TextTable(words("by_setup"), heads, tuple(rows[:_SETUPS]), note)
    yield from residual_pictures(found, words)


def _diagnosis(found: Evaluation, words: Words) -> Iterator[str | TextTable]:
    if found.improvement is None:
        return
    diagnosis = found.improvement.diagnosis
    named = ", ".join(f"{_title(name, found, words)} ({name})" for name in diagnosis.accepted)
    small = "_good_enough" if good_enough(diagnosis) else ""
    yield words(f"verdict_{diagnosis.verdict}{small}", effects=named, count=len(diagnosis.outliers))
    yield from map(words.phrase, left_words(diagnosis))
    yield from map(words.phrase, negative_words(diagnosis.fits[-1], diagnosis.accepted))
    ranked = [one for one in diagnosis.ranked if one.rank][:_CANDIDATES]
    rows = tuple(
        (
            _title(one.name, found, words),
            one.name,
            probability(one.probability),
            sizes_in_words(screened_sizes(one)),
        )
        for one in ranked
    )
    heads = (words("effect"), "id", words("probability"), words("size_u"))
    yield TextTable(words("candidates"), heads, rows, words("candidates_note"))
    left = tuple(
        (words.phrase(s.covariate), words.phrase(s.shape), probability(s.p_value), f"{100 * s.share:.0f} %")
        for s in diagnosis.search.left[:_CANDIDATES]
    )
    heads = (words("covariate"), words("shape"), words("p_value"), words("share"))
    if left:
        yield TextTable(words("still_depends"), heads, left)


def _improvement(found: Evaluation, words: Words) -> Iterator[str | TextTable | Picture]:
    heads = (words("step"), words("residual_um"), "χ²/ν", words("map_um"), words("map_u_um"))
    if found.measured.history:
        rows = [
            (f"{entry.number}: {_change(entry.change, words)}", entry.rms_residual, entry.reduced_chi_square,
             entry.map_rms, entry.map_uncertainty_rms)
            for entry in found.measured.history
        ]  # fmt: skip
        yield TextTable(words("steps_history"), heads, tuple(map(_step, rows)))
    done = found.improvement
    if done is not None and len(done.steps) > 1:
        rows = [
            (_change(step.change, words), step.result.rms_residual, step.reduced_chi_square, step.map_rms,
             step.map_uncertainty)
            for step in done.steps
        ]  # fmt: skip
        yield TextTable(words("steps"), heads, tuple(map(_step, rows)))
        yield translated("improve", words("figure_improve"), draw_improvement(done), words)


def _change(change: str, words: Words) -> str:
    return words.phrase(change) if change else words("first_model")


def _step(row: tuple[str, float, float | None, float | None, float | None]) -> tuple[str, ...]:
    name, residual, chi, size, u = row
    return (
        name,
        micrometres(residual),
        rounded(chi),
        micrometres(size),
        micrometres(None if u is None else 2 * u),
    )


def _budget(found: Evaluation, words: Words) -> Iterator[str | TextTable | Picture]:
    if found.budget is not None:
        for part in budget_tables(found.budget):
            yield words.phrase(part) if isinstance(part, str) else part
        yield translated("budget", words("figure_budget"), draw_budget(found.budget), words)


def _conformity(found: Evaluation, words: Words) -> Iterator[str | TextTable]:
    if found.conformity is not None:
        yield conformity_table(found.conformity)
        yield words("all_together", decision=words.phrase(found.conformity.decision))


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
    rows = [(words("evaluated"), origin.evaluated), (words("software"), origin.software)]
    rows.append((words("model"), ", ".join([origin.model, *origin.effects])))
    for one in origin.sessions:
        where = f" ({one.label})" if one.label else ""
        if one.measured:
            rows.append((words("measured_on") + where, one.measured))
        rows.append((words("sha256") + where, one.sha256))
    if len(origin.sessions) > 1:
        rows.append((words("sha256_all"), origin.sha256))
    yield TextTable("", ("", ""), tuple(rows), words("sha256_note"))
