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

if TYPE_CHECKING:
    from rich.console import Console

__all__ = [
    "comparison_tables",
    "mark_not_determined",
    "show_comparison",
]

_Row = dict[str, Any]
_TAKEN_UP = "fully correlated with the model's own unknowns"
_MICRO, _HOUR = 1e6, 3600.0
_MOST = 8
# Correlation from which two covariates changed together, so that a line over one is a line over the other.
_TOGETHER = 0.9
# p-value above which a line says nothing, and how many are shown all the same.
_NOTHING, _LEAST = 0.05, 1
_MOST_PARTS, _MOST_LABELS, _MOST_REGIONS = 12, 5, 3
_HEADS = "× declared: scatter over the declared uncertainty; of all misfit: share of the sum of squares"
_APART = (
    "axis stands apart by: what the two directions would have to differ by on the axis (a backlash of half width b "
    "gives −2 b)"
)
_EXPECTED = (
    "× expected: over the scatter that the declared uncertainty lets this residual have; row 0 is the second line of "
    "observations.csv"
)
# Names and factors of positions for people.
_UNITS = {"x": ("mm", 1e3), "y": ("mm", 1e3), "z": ("mm", 1e3), "c": ("°", 180.0 / np.pi)}


def mark_not_determined(
    heads: Sequence[str], rows: Sequence[tuple[str, ...]], columns: Sequence[int]
) -> tuple[tuple[tuple[str, ...], ...], str]:
    """Empty those columns of uncertain values that hold no number at all, and say what dashes mean.

    Args:
        heads: of the table.
        rows: of the table.
        columns: those that hold values with an uncertainty.

    Returns:
        The rows, and a note.
    """
    nowhere = [k for k in columns if all(row[k] == NOT_DETERMINED for row in rows)]
    shown = tuple(tuple("" if k in nowhere else cell for k, cell in enumerate(row)) for row in rows)
    notes = []
    if any(row[k] == NOT_DETERMINED for row in shown for k in columns):
        notes.append(f"{NOT_DETERMINED}: {_TAKEN_UP}")
    if nowhere:
        names = " and ".join(heads[k].split(" / ")[0] for k in nowhere)
        notes.append(f"{names}: not determined, {_TAKEN_UP}")
    return shown, "; ".join(notes)


def _uncertain(name: str, factor: float = _MICRO) -> Callable[[_Row], str]:
    """A column with its expanded uncertainty."""
    return lambda row: plus_minus(row[name], row[f"{name}_u"], factor)


def _apart(row: _Row) -> str:
    text = _uncertain("displacement")(row)
    return text if row["displacement"] is None else f"{text} {'µrad' if row['axis'] == 'c' else 'µm'}"


def _position(row: _Row) -> str:
    unit, factor = _UNITS[row["axis"]]
    low, high = (f"{factor * row[end]:.4g}" for end in ("low", "high"))
    return f"{low if low == high else f'{low} to {high}'} {unit}"


_UNCERTAIN: dict[str, Callable[[_Row], str]] = {
    "mean / µm": _uncertain("mean"),
    "drift / (µm/h)": _uncertain("slope", _MICRO * _HOUR),
    "residual after + minus after − / µm": _uncertain("difference"),
    "axis stands apart by": _apart,
}
"""Cells of columns of which a row may leave the figure undetermined, by the column's head."""
_CELLS: dict[str, Callable[[_Row], str]] = _UNCERTAIN | {
    "RMS / µm": lambda row: micrometres(row["rms"]),
    "× declared": lambda row: times_declared(row["reduced_chi_square"]),
    "of all misfit": lambda row: f"{row['share']:.0%}",
    "worst row": lambda row: "" if row["worst_row"] is None else str(row["worst_row"]),
    "position": _position,
    "readings after + / −": lambda row: f"{row['forward']} / {row['backward']}",
    "residuals change by / µm": lambda row: _uncertain("slope", _MICRO * row["span"])(row),
    "the model would need / µm": lambda row: _uncertain("added", _MICRO * row["span"])(row),
    "residual / µm": lambda row: micrometres(row["residual"], signed=True),
    "× expected": lambda row: NOT_DETERMINED if row["studentized"] is None else f"{row['studentized']:+.1f}",
    "p-value": lambda row: probability(row["p_value"]),
}
_FIGURES = ("readings", "RMS / µm", "× declared", "of all misfit")
_PART = (*_FIGURES, "mean / µm", "drift / (µm/h)", "worst row")


def _table(
    title: str, table: pd.DataFrame, heads: Sequence[str], about: str = "", most: int | None = None
) -> TextTable:
    """A table of text of the first rows; a head that is neither of `_CELLS` nor a column's name stands over names."""
    rows = [
        tuple(_CELLS[head](row) if head in _CELLS else str(row.get(head, row.get("name"))) for head in heads)
        for row in records(table[:most])
    ]
    shown, note = mark_not_determined(heads, rows, [k for k, head in enumerate(heads) if head in _UNCERTAIN])
    more = f"{len(table) - len(rows)} more" if len(table) > len(rows) else ""
    return TextTable(title, tuple(heads), shown, "; ".join(filter(None, (about, more, note))))


def comparison_tables(comparison: Comparison | JointComparison) -> Iterator[TextTable]:
    """Where the model fails: the whole, setups, regions, approaches, trends, single readings."""
    yield _overall(comparison)
    if isinstance(comparison, Comparison):
        yield _table("Setups, worst first", comparison.setups, ("setup", *_PART), _HEADS, _MOST_PARTS)
        yield from _within(comparison)
        return
    yield _table("Sessions, worst first", comparison.parts, ("session", *_PART))
    setups = comparison.setups
    setups["name"] = setups["session"] + "/" + setups["name"]
    yield _table("Setups of all sessions, worst first", setups, ("setup", *_PART), _HEADS, _MOST_PARTS)
    for label, one in zip(comparison.labels, comparison.sessions, strict=True):
        for table in _within(one):
            yield replace(table, title=f"{label}: {table.title[0].lower()}{table.title[1:]}")


def _within(comparison: Comparison) -> Iterator[TextTable]:
    """What follows the setups of a session."""
    if len(comparison.runs) > len(comparison.setups):
        yield _table("Repeats, worst first", comparison.runs, ("setup and repeat", *_PART), most=_MOST_LABELS)
    for name, parts in comparison.texts.items():
        if len(parts) > 1:
            yield _table(f"By {name}, worst first", parts, (name, *_FIGURES, "worst row"), most=_MOST_LABELS)
    if len(comparison.regions):
        ranked = comparison.regions.sort_values("reduced_chi_square", ascending=False, kind="stable")
        worst = ranked.groupby("axis", sort=False).head(_MOST_REGIONS).sort_values("axis", kind="stable", key=_as_axes)
        yield _table("Regions of each axis, the three worst", worst, ("axis", "position", *_FIGURES[:3], "mean / µm"))
    if len(comparison.approaches):
        heads = ("axis", "readings after + / −", *[*_UNCERTAIN][2:], "p-value")
        yield _table("Direction of approach", comparison.approaches, heads, _APART)
    if len(comparison.trends):
        yield _trends(comparison)
    yield _worst(comparison)


def _as_axes(names: pd.Series[Any]) -> pd.Series[Any]:
    return names.map([*_UNITS].index)


def _overall(comparison: Comparison | JointComparison) -> TextTable:
    overall, noise, sessions = comparison.overall, None, len(comparison.sessions)
    rows = [("RMS residual (measured − predicted)", quantity(overall.rms_residual, "m"))]
    title, p_value = f"All {overall.readings} readings", "p-value of the fit"
    if isinstance(comparison, JointComparison):
        title += f" of {sessions} sessions"
    else:
        noise = comparison.noise
        repeats = noise.from_repeats
        scatter = "not determined: too few repeats" if repeats is None else quantity(repeats, "m")
        rows += [
            ("declared standard uncertainty of a reading", quantity(noise.declared, "m")),
            ("scatter of readings repeated at one place", scatter),
        ]
        p_value += ": chance of as much scatter about a right model with the declared uncertainty"
    rows += [
        (
            "reduced chi-square (1 if the model and the declared uncertainty are right)",
            f"{rounded(overall.reduced_chi_square)}, {overall.degrees_of_freedom} degrees of freedom",
        ),
        (p_value, probability(overall.p_value)),
    ]
    if noise is not None and noise.lack_of_fit_p is not None:
        asked = "p-value of the lack of fit: chance that places differ so much more than repeats at one place do"
        rows.append((asked, probability(noise.lack_of_fit_p)))
    note = "" if noise is None else "every ± below is an expanded uncertainty (k = 2)"
    return TextTable(title, ("", ""), tuple(rows), note)


def _trends(comparison: Comparison) -> TextTable:
    """Straight lines over time, temperature and every other covariate, the clearest first."""
    groups = _correlated_groups(comparison)
    clear = [group for group in groups if (group[0]["p_value"] or 0.0) < _NOTHING]
    shown = (clear or groups[:_LEAST])[:_MOST]
    rows = [
        first
        | {"over": first["covariate"], "correlated with": ", ".join(sorted(others, key=lambda name: name != "time"))}
        for first, others in ((first, [row["covariate"] for row in others]) for first, *others in shown)
    ]
    heads = ("over", "correlated with", "residuals change by / µm", "the model would need / µm", "p-value")
    title = "Straight lines over time, temperature and what else was recorded"
    return _table(title, pd.DataFrame(rows, columns=[*comparison.trends, *heads[:2]]), heads, _note(comparison, shown))


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
    notes = [
        "from one end of what was recorded to the other; the model would need more than the residuals show, "
        "because its other unknowns are correlated with it"
    ]
    if any(len(group) > 1 for group in shown):
        notes.append("correlated covariates cannot be distinguished here")
    listed = {row["covariate"] for group in shown for row in group}
    rest = trends["covariate"][~trends["covariate"].isin(listed) & trends["slope"].notna()]
    if len(rest):
        notes.append(f"nothing clear over {', '.join(rest)}")
    hidden = trends["covariate"][trends["slope"].isna() | trends["added"].isna()]
    if len(hidden):
        notes.append(f"{_TAKEN_UP}: {', '.join(hidden)}")
    notes.append(
        f"{len(trends)} tried: the smallest of so many p-values is about {1 / (len(trends) + 1):.1g} where the model "
        "is right; a diagnosis allows for that"
    )
    return "; ".join(notes)


def _worst(comparison: Comparison) -> TextTable:
    heads = ("row", "setup", "repeat", *comparison.texts, "residual / µm", "× expected")
    return _table("Single readings, worst first", comparison.worst[:_MOST_LABELS], heads, _EXPECTED)


def show_comparison(screen: Console, comparison: Comparison | JointComparison) -> None:
    """In words first, then the tables."""
    from rich.text import Text

    screen.print(Text(in_words(comparison)))
    show_suspicions(screen, suspicious_fits([one.fit for one in comparison.sessions], comparison.labels))
    if comparison.effects:
        screen.print(Text(f"In the model: {', '.join(comparison.effects)}."))
    for table in comparison_tables(comparison):
        show_table(screen, table)
