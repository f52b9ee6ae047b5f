# SPDX-License-Identifier: Apache-2.0
"""A comparison in plain words and tables, in micrometres, and for programs as one JSON document."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd

from machine_tool_calibration.diagnosis.compare import Comparison, JointComparison, Overall
from machine_tool_calibration.estimation import priors
from machine_tool_calibration.json_types import plain
from machine_tool_calibration.methods.build import error_map, suspicious_fits
from machine_tool_calibration.model.result import only_if_right
from machine_tool_calibration.reports.goodness import fit_words
from machine_tool_calibration.reports.quantities import (
    NOT_DETERMINED,
    micrometres,
    plus_minus,
    probability,
    quantity,
    rounded,
)
from machine_tool_calibration.reports.tables import Part, TextTable, suspicion_words
from machine_tool_calibration.residuals.noise import Noise
from machine_tool_calibration.session.catalogue import spec_of
from machine_tool_calibration.words import Verbatim, say, together

_WORSE = 1.15  # how much worse than all readings together a setup must be to be named


def in_words(comparison: Comparison | JointComparison) -> str:
    """What a person wants to know first: does the model fit, and if not, where not; lengths in micrometres."""
    one = comparison if isinstance(comparison, Comparison) else None
    overall, count = comparison.overall, len(comparison.outliers)
    fitting = fit_words(overall.reduced_chi_square, overall.p_value, _map_of(one) if one else {})
    bad = only_if_right(overall.p_value, _map_of(one) if one else None)
    said: list[str] = [fitting]
    said += [_where(comparison.parts, "setup" if one else "session", overall)] if bad else []
    key = "compared.counted" if comparison.sessions[0].counted else "compared.left_out"
    said += [say(key, text=say("compared.stand_out", n=count))] if count else []
    said += [_repeats(overall, one.noise, not bad or bool(count))] if one else []
    said += [say("compared.ask_diagnosis" if one else "compared.ask_result")] if bad else []
    return together(said)


def _where(parts: pd.DataFrame, part: str, overall: Overall) -> str:
    judged = parts[parts["reduced_chi_square"].notna()]
    if len(judged) < 2:
        return say(f"compared.one_{part}")
    worst = judged.iloc[0]
    if worst["reduced_chi_square"] < _WORSE**2 * overall.reduced_chi_square:
        return say(f"compared.same_{part}")
    ratio = times_declared(worst["reduced_chi_square"])
    return say(f"compared.worst_{part}", name=worst["name"], ratio=ratio, share=f"{worst['share']:.0%}")


def _map_of(one: Comparison) -> Mapping[str, Any]:
    """What the map of deviations that were read directly says of their scatter; empty for other methods."""
    alone = len(one.fit.joint.assembly.models) == 1
    return error_map(one.fit).content if alone and spec_of(one.session).reads_machine else {}


def _repeats(overall: Overall, noise: Noise, explained: bool) -> str:
    if (size := _of_repeats(noise)) is None:
        return say("compared.few_repeats")
    if noise.lack_of_fit_p is not None and noise.lack_of_fit_p < priors.LACK_OF_FIT_P:
        key = "lack"
    elif explained:
        key = "scatter"
    else:
        key = "less" if size < priors.AS_NOISY * overall.ratio * noise.declared else "as_much"
    return say(f"compared.{key}", repeats=quantity(size, "m"), declared=quantity(noise.declared, "m"))


def _of_repeats(noise: Noise) -> float | None:
    """What repeats of one place differ by: as they were read where that is what is told of a machine."""
    return noise.from_repeats if noise.as_read is None else noise.as_read


def times_declared(reduced_chi_square: float | None) -> str:
    """How many times the declared uncertainty readings scatter about the model; a dash where that is not known."""
    return rounded(reduced_chi_square and reduced_chi_square**0.5)


def records(table: pd.DataFrame) -> list[dict[str, Any]]:
    """Rows of a table by their columns, with None for NaN."""
    return [plain(row) for row in table.to_dict("records")]


def comparison_document(comparison: Comparison | JointComparison) -> dict[str, Any]:
    """The comparison as `mtcal-comparison/1`: SI units, None where the model takes a figure up.

    Of several sessions the same keys for all of them together, and under `sessions` those of each.
    """
    sessions = [one.session for one in comparison.sessions]
    worst = comparison.worst.filter(["session", "row", "setup", "residual", "studentized"])
    out = {
        "format": "mtcal-comparison/1",
        "method": sessions[0].method if isinstance(comparison, Comparison) else "joint",
        "effects": list(comparison.effects),
        "summary": in_words(comparison),
        "suspicious": suspicious_fits([one.fit for one in comparison.sessions], comparison.labels),
        "provenance": comparison.provenance.document(),
        **vars(comparison.overall),
        "setups": records(comparison.setups),
        "worst": records(worst),
    }
    if isinstance(comparison, JointComparison):
        labelled = zip(comparison.labels, comparison.sessions, strict=True)
        return out | {"sessions": [{"label": label, **comparison_document(one)} for label, one in labelled]}
    ends = comparison.regions[["axis", "low", "high"]]
    fit = records(comparison.regions.drop(columns=[*ends]))
    return out | {
        "noise": {"declared": comparison.noise.declared, "from_repeats": comparison.noise.from_repeats},
        "lack_of_fit_p_value": comparison.noise.lack_of_fit_p,
        "runs": records(comparison.runs),
        "labels": {name: records(table) for name, table in comparison.texts.items()},
        "regions": [{**region, "fit": own} for region, own in zip(records(ends), fit, strict=True)],
        "approaches": records(comparison.approaches),
        "trends": records(comparison.trends),
        "depends_on": [{"covariate": name, "share": share} for name, share in comparison.ranked],
        "outliers": list(comparison.outliers),
    }


_Row = dict[str, Any]
_MICRO, _HOUR = 1e6, 3600.0
_MOST_GROUPS = 8  # of covariates in the table
# Correlation from which two covariates changed together, so that a line over one is a line over the other.
_TOGETHER = 0.9
# p-value above which a line says nothing, and how many are shown all the same.
_SAYS_NOTHING, _FEWEST_GROUPS = 0.05, 1
_MOST_PARTS, _MOST_LABELS, _MOST_REGIONS = 12, 5, 3
# Names and factors of positions for people.
_UNITS = dict.fromkeys("xyz", ("mm", 1e3)) | dict.fromkeys("abc", ("°", 180.0 / np.pi))


def mark_not_determined(
    columns: Sequence[str], rows: Sequence[tuple[str, ...]], uncertain: Sequence[int]
) -> tuple[tuple[tuple[str, ...], ...], str]:
    """The rows without columns of uncertain values that hold no number at all, and a note on what dashes mean."""
    nowhere = [k for k in uncertain if all(row[k] == NOT_DETERMINED for row in rows)]
    shown = tuple(tuple("" if k in nowhere else cell for k, cell in enumerate(row)) for row in rows)
    notes = []
    if any(row[k] == NOT_DETERMINED for row in shown for k in uncertain):
        notes.append(say("compared.dash"))
    if nowhere:
        notes.append(say("compared.nowhere", names=together((columns[k] for k in nowhere), say("text.and"))))
    return shown, together(notes, "; ")


def _uncertain(name: str, factor: float = _MICRO) -> Callable[[_Row], str]:
    return lambda row: plus_minus(row[name], row[f"{name}_u"], factor)


def _displacement(row: _Row) -> str:
    text = _uncertain("displacement")(row)
    return text if row["displacement"] is None else f"{text} {'µrad' if row['axis'] in 'abc' else 'µm'}"


def _position(row: _Row) -> str:
    unit, factor = _UNITS[row["axis"]]
    low, high = (f"{factor * row[end]:.4g}" for end in ("low", "high"))
    return f"{low} {unit}" if low == high else say("text.range", low=low, high=f"{high} {unit}")


_UNCERTAIN: dict[str, Callable[[_Row], str]] = {
    "mean_um": _uncertain("mean"),
    "drift": _uncertain("slope", _MICRO * _HOUR),
    "difference": _uncertain("difference"),
    "stands_apart": _displacement,
    "needed_um": lambda row: _uncertain("added", _MICRO * row["span"])(row),
}
"""Cells of columns of which a row may leave the figure undetermined, by the key of the column's head."""
_CELLS: dict[str, Callable[[_Row], str]] = _UNCERTAIN | {
    "rms_um": lambda row: micrometres(row["rms"]),
    "times_declared": lambda row: times_declared(row["reduced_chi_square"]),
    "misfit": lambda row: f"{row['share']:.0%}",
    "worst_row": lambda row: "" if row["worst_row"] is None else str(row["worst_row"]),
    "place_on_axis": _position,
    "after": lambda row: f"{row['forward']} / {row['backward']}",
    "change_um": lambda row: _uncertain("slope", _MICRO * row["span"])(row),
    "residual_um": lambda row: micrometres(row["residual"], signed=True),
    "times_expected": lambda row: NOT_DETERMINED if row["studentized"] is None else f"{row['studentized']:+.1f}",
    "p_value": lambda row: probability(row["p_value"]),
}
_SAID = {*_CELLS, "axis", "correlated", "over", "readings", "repeat", "row", "session", "setup", "setup_repeat"}
"""Columns that are no label of the user's own."""
_FIGURES = ("readings", "rms_um", "times_declared", "misfit")
_PART = (*_FIGURES, "mean_um", "drift", "worst_row")


def _table(title: str, table: pd.DataFrame, keys: Sequence[str], about: str = "", most: int | None = None) -> TextTable:
    """A table of text of the first rows; a key that is neither of `_CELLS` nor a column's name stands over names."""
    rows = [
        tuple(_CELLS[key](row) if key in _CELLS else str(row.get(key, row.get("name"))) for key in keys)
        for row in records(table[:most])
    ]
    columns = tuple(say(f"head.{key}") if key in _SAID else Verbatim(key) for key in keys)
    shown, note = mark_not_determined(columns, rows, [k for k, key in enumerate(keys) if key in _UNCERTAIN])
    more = say("text.more", n=len(table) - len(rows)) if len(table) > len(rows) else ""
    return TextTable(title, columns, shown, together(filter(None, (about, more, note)), "; "))


def comparison_tables(comparison: Comparison | JointComparison) -> Iterator[TextTable]:
    """Where the model fails: the whole, setups, regions, approaches, trends, single readings."""
    yield _overall(comparison)
    if isinstance(comparison, Comparison):
        yield _table(say("compared.setups"), comparison.setups, ("setup", *_PART), say("compared.heads"), _MOST_PARTS)
        yield from _within(comparison)
        return
    yield _table(say("compared.sessions"), comparison.parts, ("session", *_PART))
    setups = comparison.setups
    setups["name"] = setups["session"] + "/" + setups["name"]
    yield _table(say("compared.all_setups"), setups, ("setup", *_PART), say("compared.heads"), _MOST_PARTS)
    for label, one in zip(comparison.labels, comparison.sessions, strict=True):
        for table in _within(one):
            yield replace(table, title=say("compared.of_session", label=label, table=table.title))


def _within(comparison: Comparison) -> Iterator[TextTable]:
    """What follows the setups of a session."""
    if len(comparison.runs) > len(comparison.setups):
        yield _table(say("compared.repeats"), comparison.runs, ("setup_repeat", *_PART), most=_MOST_LABELS)
    for name, parts in comparison.texts.items():
        if len(parts) > 1:
            yield _table(say("compared.by", name=name), parts, (name, *_FIGURES, "worst_row"), most=_MOST_LABELS)
    if len(comparison.regions):
        ranked = comparison.regions.sort_values("reduced_chi_square", ascending=False, kind="stable")
        worst = ranked.groupby("axis", sort=False).head(_MOST_REGIONS)
        worst = worst.sort_values("axis", kind="stable", key=lambda names: names.map([*_UNITS].index))
        yield _table(say("compared.regions"), worst, ("axis", "place_on_axis", *_FIGURES[:3], "mean_um"))
    if len(comparison.approaches):
        keys: tuple[str, ...] = ("axis", "after", "difference", "stands_apart", "p_value")
        yield _table(say("compared.approach"), comparison.approaches, keys, say("compared.apart"))
    if comparison.trends["slope"].notna().any():
        yield _trends(comparison)
    keys = ("row", "setup", "repeat", *comparison.texts, "residual_um", "times_expected")
    yield _table(say("compared.readings"), comparison.worst[:_MOST_LABELS], keys, say("compared.expected"))


def _overall(comparison: Comparison | JointComparison) -> TextTable:
    overall, noise = comparison.overall, None
    rows: list[tuple[str, str]] = [(say("compared.rms"), quantity(overall.rms_residual, "m"))]
    if isinstance(comparison, Comparison):
        noise, repeats = comparison.noise, _of_repeats(comparison.noise)
        rows += [
            (say("compared.declared"), quantity(noise.declared, "m")),
            (say("compared.repeated"), say("compared.no_repeats") if repeats is None else quantity(repeats, "m")),
        ]
    chi, dof = rounded(overall.reduced_chi_square), overall.degrees_of_freedom
    rows.append((say("compared.chi"), say("compared.freedom", chi=chi, n=dof)))
    rows.append((say("compared.p" if noise is None else "compared.p_chance"), probability(overall.p_value)))
    if noise is None:
        title = say("compared.all_sessions", n=overall.readings, count=len(comparison.sessions))
        return TextTable(title, ("", ""), tuple(rows))
    if noise.lack_of_fit_p is not None:
        rows.append((say("compared.lack_p"), probability(noise.lack_of_fit_p)))
    return TextTable(say("compared.all", n=overall.readings), ("", ""), tuple(rows), say("compared.expanded"))


def _trends(comparison: Comparison) -> TextTable:
    groups = _correlated_groups(comparison)
    clear = [group for group in groups if (group[0]["p_value"] or 0.0) < _SAYS_NOTHING]
    shown = (clear or groups[:_FEWEST_GROUPS])[:_MOST_GROUPS]
    rows = [
        first | {"over": first["covariate"], "correlated": ", ".join(sorted(others, key=lambda name: name != "time"))}
        for first, others in ((first, [row["covariate"] for row in others]) for first, *others in shown)
    ]
    keys = ("over", "correlated", "change_um", "needed_um", "p_value")
    table = pd.DataFrame(rows, columns=[*comparison.trends, *keys[:2]])
    return _table(say("compared.trends"), table, keys, _note(comparison, shown))


def _correlated_groups(comparison: Comparison) -> list[list[_Row]]:
    """Trends whose covariates changed together, in the order of the clearest of each; that one leads its group."""
    groups: list[list[_Row]] = []
    for trend in records(comparison.trends.dropna(subset=["slope"])):
        values = comparison.covariates[trend["covariate"]]
        for group in groups:
            if abs(np.corrcoef(values, comparison.covariates[group[0]["covariate"]])[0, 1]) > _TOGETHER:
                group.append(trend)
                break
        else:
            groups.append([trend])
    return groups


def _note(comparison: Comparison, shown: list[list[_Row]]) -> str:
    trends = comparison.trends
    notes = [say("compared.ends")]
    if any(len(group) > 1 for group in shown):
        notes.append(say("compared.cannot"))
    listed = {row["covariate"] for group in shown for row in group}
    rest = trends["covariate"][~trends["covariate"].isin(listed) & trends["slope"].notna()]
    if len(rest):
        notes.append(say("compared.nothing_clear", names=", ".join(rest)))
    hidden = trends["covariate"][trends["slope"].isna()]
    if len(hidden):
        notes.append(say("compared.hidden", names=", ".join(hidden)))
    notes.append(say("compared.tried", n=len(trends), p=f"{1 / (len(trends) + 1):.1g}"))
    return together(notes, "; ")


def comparison_parts(comparison: Comparison | JointComparison) -> Iterator[Part]:
    """In words first, then the tables."""
    yield in_words(comparison)
    yield from suspicion_words(suspicious_fits([one.fit for one in comparison.sessions], comparison.labels))
    if comparison.effects:
        yield say("compared.in_model", names=", ".join(comparison.effects))
    yield from comparison_tables(comparison)
