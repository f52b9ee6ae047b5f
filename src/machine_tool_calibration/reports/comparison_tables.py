# SPDX-License-Identifier: Apache-2.0
"""A comparison as tables of text, in micrometres."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from machine_tool_calibration.diagnosis.compare import Comparison, JointComparison
from machine_tool_calibration.methods.build import suspicious_fits
from machine_tool_calibration.reports.comparison import in_words, records, times_declared
from machine_tool_calibration.reports.quantities import (
    NOT_DETERMINED,
    micrometres,
    plus_minus,
    probability,
    quantity,
    rounded,
)
from machine_tool_calibration.reports.tables import TextTable, show_suspicions, show_table
from machine_tool_calibration.words import Verbatim, say, together

if TYPE_CHECKING:
    from rich.console import Console

__all__ = [
    "comparison_tables",
    "mark_not_determined",
    "show_comparison",
]

_Row = dict[str, Any]
_MICRO, _HOUR = 1e6, 3600.0
_MOST = 8
# Correlation from which two covariates changed together, so that a line over one is a line over the other.
_TOGETHER = 0.9
# p-value above which a line says nothing, and how many are shown all the same.
_NOTHING, _LEAST = 0.05, 1
_MOST_PARTS, _MOST_LABELS, _MOST_REGIONS = 12, 5, 3
# Names and factors of positions for people.
_UNITS = {"x": ("mm", 1e3), "y": ("mm", 1e3), "z": ("mm", 1e3), "c": ("°", 180.0 / np.pi)}


def mark_not_determined(
    columns: Sequence[str], rows: Sequence[tuple[str, ...]], uncertain: Sequence[int]
) -> tuple[tuple[tuple[str, ...], ...], str]:
    """Empty those columns of uncertain values that hold no number at all, and say what dashes mean.

    Args:
        columns: heads of the table.
        rows: of the table.
        uncertain: columns that hold values with an uncertainty.

    Returns:
        The rows, and a note.
    """
    nowhere = [k for k in uncertain if all(row[k] == NOT_DETERMINED for row in rows)]
    shown = tuple(tuple("" if k in nowhere else cell for k, cell in enumerate(row)) for row in rows)
    notes = []
    if any(row[k] == NOT_DETERMINED for row in shown for k in uncertain):
        notes.append(say("compared.dash"))
    if nowhere:
        notes.append(say("compared.nowhere", names=together((columns[k] for k in nowhere), say("text.and"))))
    return shown, together(notes, "; ")


def _uncertain(name: str, factor: float = _MICRO) -> Callable[[_Row], str]:
    """A column with its expanded uncertainty."""
    return lambda row: plus_minus(row[name], row[f"{name}_u"], factor)


def _apart(row: _Row) -> str:
    text = _uncertain("displacement")(row)
    return text if row["displacement"] is None else f"{text} {'µrad' if row['axis'] == 'c' else 'µm'}"


def _position(row: _Row) -> str:
    unit, factor = _UNITS[row["axis"]]
    low, high = (f"{factor * row[end]:.4g}" for end in ("low", "high"))
    return f"{low} {unit}" if low == high else say("text.range", low=low, high=f"{high} {unit}")


_UNCERTAIN: dict[str, Callable[[_Row], str]] = {
    "mean_um": _uncertain("mean"),
    "drift": _uncertain("slope", _MICRO * _HOUR),
    "difference": _uncertain("difference"),
    "stands_apart": _apart,
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
    "needed_um": lambda row: _uncertain("added", _MICRO * row["span"])(row),
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
        worst = ranked.groupby("axis", sort=False).head(_MOST_REGIONS).sort_values("axis", kind="stable", key=_as_axes)
        yield _table(say("compared.regions"), worst, ("axis", "place_on_axis", *_FIGURES[:3], "mean_um"))
    if len(comparison.approaches):
        keys = ("axis", "after", *[*_UNCERTAIN][2:], "p_value")
        yield _table(say("compared.approach"), comparison.approaches, keys, say("compared.apart"))
    if len(comparison.trends):
        yield _trends(comparison)
    yield _worst(comparison)


def _as_axes(names: pd.Series[Any]) -> pd.Series[Any]:
    return names.map([*_UNITS].index)


def _overall(comparison: Comparison | JointComparison) -> TextTable:
    overall, noise, sessions = comparison.overall, None, len(comparison.sessions)
    rows: list[tuple[str, str]] = [(say("compared.rms"), quantity(overall.rms_residual, "m"))]
    joint = isinstance(comparison, JointComparison)
    title = say("compared.all_sessions" if joint else "compared.all", n=overall.readings, count=sessions)
    if not isinstance(comparison, JointComparison):
        noise = comparison.noise
        repeats = noise.from_repeats
        rows += [
            (say("compared.declared"), quantity(noise.declared, "m")),
            (say("compared.repeated"), say("compared.no_repeats") if repeats is None else quantity(repeats, "m")),
        ]
    chi, dof = rounded(overall.reduced_chi_square), overall.degrees_of_freedom
    rows.append((say("compared.chi"), say("compared.freedom", chi=chi, n=dof)))
    rows.append((say("compared.p" if joint else "compared.p_chance"), probability(overall.p_value)))
    if noise is not None and noise.lack_of_fit_p is not None:
        rows.append((say("compared.lack_p"), probability(noise.lack_of_fit_p)))
    note = "" if noise is None else say("compared.expanded")
    return TextTable(title, ("", ""), tuple(rows), note)


def _trends(comparison: Comparison) -> TextTable:
    """Straight lines over time, temperature and every other covariate, the clearest first."""
    groups = _correlated_groups(comparison)
    clear = [group for group in groups if (group[0]["p_value"] or 0.0) < _NOTHING]
    shown = (clear or groups[:_LEAST])[:_MOST]
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
    for trend in records(comparison.trends.dropna(subset=["slope", "added"])):
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
    hidden = trends["covariate"][trends["slope"].isna() | trends["added"].isna()]
    if len(hidden):
        notes.append(say("compared.hidden", names=", ".join(hidden)))
    notes.append(say("compared.tried", n=len(trends), p=f"{1 / (len(trends) + 1):.1g}"))
    return together(notes, "; ")


def _worst(comparison: Comparison) -> TextTable:
    keys = ("row", "setup", "repeat", *comparison.texts, "residual_um", "times_expected")
    return _table(say("compared.readings"), comparison.worst[:_MOST_LABELS], keys, say("compared.expected"))


def show_comparison(screen: Console, comparison: Comparison | JointComparison) -> None:
    """In words first, then the tables."""
    from rich.text import Text

    screen.print(Text(in_words(comparison)))
    show_suspicions(screen, suspicious_fits([one.fit for one in comparison.sessions], comparison.labels))
    if comparison.effects:
        screen.print(Text(say("compared.in_model", names=", ".join(comparison.effects))))
    for table in comparison_tables(comparison):
        show_table(screen, table)
