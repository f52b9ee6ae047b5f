# SPDX-License-Identifier: Apache-2.0
"""A comparison as tables of text, in micrometres."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from machine_tool_calibration.diagnosis.compare import Approach, Comparison, JointComparison, Share, Trend
from machine_tool_calibration.methods.build import suspicious_fits
from machine_tool_calibration.reports.comparison import in_words
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


_TAKEN_UP = "fully correlated with the model's own unknowns"


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


_MICRO = 1e6
_MOST = 8
# Correlation from which two covariates changed together, so that a line over one is a line over the other.
_TOGETHER = 0.9
# p-value above which a line says nothing, and how many are shown all the same.
_NOTHING, _LEAST = 0.05, 1


def _trends_table(comparison: Comparison) -> TextTable:
    """Straight lines over time, temperature and every other covariate, the clearest first."""
    known = [t for t in comparison.trends if t.slope is not None and t.added is not None]
    groups = _correlated_groups(comparison, known)
    clear = [group for group in groups if (group[0].p_value or 0.0) < _NOTHING]
    shown = (clear or groups[:_LEAST])[:_MOST]
    rows = tuple(
        (
            first.covariate,
            ", ".join(sorted((t.covariate for t in others), key=lambda name: name != "time")),
            plus_minus(first.slope, first.slope_u, _MICRO * first.span),
            plus_minus(first.added, first.added_u, _MICRO * first.span),
            probability(first.p_value),
        )
        for first, *others in shown
    )
    columns = ("over", "correlated with", "residuals change by / µm", "the model would need / µm", "p-value")
    return TextTable(
        "Straight lines over time, temperature and what else was recorded", columns, rows, _note(comparison, shown)
    )


def _correlated_groups(comparison: Comparison, trends: list[Trend]) -> list[list[Trend]]:
    """Trends whose covariates changed together, in the order of the clearest of each; that one leads its group."""
    groups: list[list[Trend]] = []
    for trend in trends:
        values = comparison.covariates[trend.covariate]
        for group in groups:
            if abs(np.corrcoef(values, comparison.covariates[group[0].covariate])[0, 1]) > _TOGETHER:
                group.append(trend)
                break
        else:
            groups.append([trend])
    return groups


def _note(comparison: Comparison, shown: list[list[Trend]]) -> str:
    tried = len(comparison.trends)
    notes = [
        "from one end of what was recorded to the other; the model would need more than the residuals show, "
        "because its other unknowns are correlated with it"
    ]
    if any(len(group) > 1 for group in shown):
        notes.append("correlated covariates cannot be distinguished here")
    listed = {t.covariate for group in shown for t in group}
    rest = [t.covariate for t in comparison.trends if t.covariate not in listed and t.slope is not None]
    if rest:
        notes.append(f"nothing clear over {', '.join(rest)}")
    hidden = [t.covariate for t in comparison.trends if t.slope is None or t.added is None]
    if hidden:
        notes.append(f"fully correlated with the model's own unknowns: {', '.join(hidden)}")
    notes.append(
        f"{tried} tried: the smallest of so many p-values is about {1 / (tried + 1):.1g} where the model is right; "
        "a diagnosis allows for that"
    )
    return "; ".join(notes)


_MOST_PARTS, _MOST_LABELS = 12, 5
_HOUR = 3600.0
_HEADS = "× declared: scatter over the declared uncertainty; of all misfit: share of the sum of squares"
# Names and factors of positions for people.
_UNITS = {"x": ("mm", 1e3), "y": ("mm", 1e3), "z": ("mm", 1e3), "c": ("°", 180.0 / np.pi)}


def comparison_tables(comparison: Comparison | JointComparison) -> Iterator[TextTable]:
    """Where the model fails: the whole, setups, regions, approaches, trends, single readings."""
    if isinstance(comparison, JointComparison):
        yield from _joint_tables(comparison)
        return
    yield _overall(comparison)
    yield _parts("Setups, worst first", "setup", comparison.setups, _MOST_PARTS, _HEADS)
    yield from _within(comparison)


def _within(comparison: Comparison) -> Iterator[TextTable]:
    """What follows the setups of a session."""
    if len(comparison.runs) > len(comparison.setups):
        yield _parts("Repeats, worst first", "setup and repeat", comparison.runs, _MOST_LABELS)
    for name, shares in comparison.labels.items():
        if len(shares) > 1:
            yield _labels(name, shares)
    if comparison.regions:
        yield _regions(comparison)
    if comparison.approaches:
        yield _approaches(comparison)
    if comparison.trends:
        yield _trends_table(comparison)
    yield _worst(comparison)


def _joint_tables(comparison: JointComparison) -> Iterator[TextTable]:
    """Sessions, setups of all, and what else is in each session."""
    joint = comparison.joint
    rows = (
        ("RMS residual (measured − predicted)", quantity(comparison.rms, "m")),
        (
            "reduced chi-square (1 if the model and the declared uncertainty are right)",
            f"{rounded(joint.reduced_chi_square)}, {joint.solution.degrees_of_freedom} degrees of freedom",
        ),
        ("p-value of the fit", probability(joint.p_value)),
    )
    yield TextTable(f"All {comparison.readings} readings of {len(comparison.labels)} sessions", ("", ""), rows)
    parts = [share for _, share in comparison.parts]
    yield _parts("Sessions, worst first", "session", parts, len(parts))
    named = [replace(share, name=f"{label}/{share.name}") for label, share in comparison.setups]
    yield _parts("Setups of all sessions, worst first", "setup", named, _MOST_PARTS, _HEADS)
    for label, one in zip(comparison.labels, comparison.sessions, strict=True):
        for table in _within(one):
            yield replace(table, title=f"{label}: {table.title[0].lower()}{table.title[1:]}")


def _overall(comparison: Comparison) -> TextTable:
    overall = comparison.overall
    repeats = overall.noise.from_repeats
    rows = [
        ("RMS residual (measured − predicted)", quantity(overall.rms, "m")),
        ("declared standard uncertainty of a reading", quantity(overall.noise.declared, "m")),
        (
            "scatter of readings repeated at one place",
            "not determined: too few repeats" if repeats is None else quantity(repeats, "m"),
        ),
        (
            "reduced chi-square (1 if the model and the declared uncertainty are right)",
            f"{rounded(overall.reduced_chi_square)}, {overall.degrees_of_freedom} degrees of freedom",
        ),
        (
            "p-value of the fit: chance of as much scatter about a right model with the declared uncertainty",
            probability(overall.p_value),
        ),
    ]
    if overall.noise.lack_of_fit_p is not None:
        asked = "p-value of the lack of fit: chance that places differ so much more than repeats at one place do"
        rows.append((asked, probability(overall.noise.lack_of_fit_p)))
    note = "every ± below is an expanded uncertainty (k = 2)"
    return TextTable(f"All {overall.readings} readings", ("", ""), tuple(rows), note)


def _parts(title: str, head: str, shares: Sequence[Share], most: int, about: str = "") -> TextTable:
    rows = tuple(
        (
            share.name,
            str(share.readings),
            micrometres(share.rms),
            rounded(share.ratio),
            f"{share.share:.0%}",
            plus_minus(share.mean, share.mean_u, _MICRO),
            plus_minus(share.slope, share.slope_u, _MICRO * _HOUR),
            "" if share.worst_row is None else str(share.worst_row),
        )
        for share in shares[:most]
    )
    columns = (head, "readings", "RMS / µm", "× declared", "of all misfit", "mean / µm", "drift / (µm/h)", "worst row")
    shown, note = mark_not_determined(columns, rows, (5, 6))
    more = f"{len(shares) - most} more" if len(shares) > most else ""
    return TextTable(title, columns, shown, "; ".join(filter(None, (about, more, note))))


def _labels(name: str, shares: Sequence[Share]) -> TextTable:
    rows = tuple(
        (s.name, str(s.readings), micrometres(s.rms), rounded(s.ratio), f"{s.share:.0%}", str(s.worst_row))
        for s in shares[:_MOST_LABELS]
    )
    more = f"{len(shares) - _MOST_LABELS} more" if len(shares) > _MOST_LABELS else ""
    columns = (name, "readings", "RMS / µm", "× declared", "of all misfit", "worst row")
    return TextTable(f"By {name}, worst first", columns, rows, more)


def _regions(comparison: Comparison) -> TextTable:
    rows = []
    for axis in dict.fromkeys(region.axis for region in comparison.regions):
        mine = [region for region in comparison.regions if region.axis == axis]
        unit, factor = _UNITS[axis]
        worst = sorted(mine, key=lambda region: -(region.fit.reduced_chi_square or 0.0))
        for region in worst[:3]:
            low, high = (f"{factor * value:.4g}" for value in (region.low, region.high))
            where = low if low == high else f"{low} to {high}"
            share = region.fit
            rows.append(
                (
                    axis,
                    f"{where} {unit}",
                    str(share.readings),
                    micrometres(share.rms),
                    rounded(share.ratio),
                    plus_minus(share.mean, share.mean_u, _MICRO),
                )
            )
    columns = ("axis", "position", "readings", "RMS / µm", "× declared", "mean / µm")
    shown, note = mark_not_determined(columns, tuple(rows), (5,))
    return TextTable("Regions of each axis, the three worst", columns, shown, note)


def _approaches(comparison: Comparison) -> TextTable:
    rows = tuple(
        (
            a.axis,
            f"{a.forward} / {a.backward}",
            plus_minus(a.difference, a.difference_u, _MICRO),
            _apart(a),
            probability(a.p_value),
        )
        for a in comparison.approaches
    )
    columns = ("axis", "readings after + / −", "residual after + minus after − / µm", "axis stands apart by", "p-value")
    shown, note = mark_not_determined(columns, rows, (2, 3))
    apart = (
        "axis stands apart by: what the two directions would have to differ by on the axis (a backlash of half width b "
        "gives −2 b)"
    )
    return TextTable("Direction of approach", columns, shown, "; ".join(filter(None, (apart, note))))


def _apart(approach: Approach) -> str:
    text = plus_minus(approach.displacement, approach.displacement_u, _MICRO)
    return text if approach.displacement is None else f"{text} {'µrad' if approach.axis == 'c' else 'µm'}"


def _worst(comparison: Comparison) -> TextTable:
    readings = comparison.fit.model.observations.readings
    ids = comparison.fit.model.observations.session.setup_ids
    labels = tuple(readings.labels)
    rows = tuple(
        (
            str(readings.row[k]),
            ids[readings.setup[k]],
            str(readings.repeat[k]),
            *(str(readings.labels[name][k]) for name in labels),
            micrometres(comparison.residual[k], signed=True),
            f"{comparison.studentized[k]:+.1f}",
        )
        for k in comparison.worst[:_MOST_LABELS]
    )
    columns = ("row", "setup", "repeat", *labels, "residual / µm", "× expected")
    note = (
        "× expected: over the scatter that the declared uncertainty lets this residual have; row 0 is the second line "
        "of observations.csv"
    )
    return TextTable("Single readings, worst first", columns, rows, note)


def show_comparison(screen: Console, comparison: Comparison | JointComparison) -> None:
    """In words first, then the tables."""
    from rich.text import Text

    if isinstance(comparison, JointComparison):
        suspicious = suspicious_fits([one.fit for one in comparison.sessions], comparison.labels)
    else:
        suspicious = suspicious_fits([comparison.fit])
    words = in_words(comparison)
    screen.print(Text(words[0].upper() + words[1:]))
    show_suspicions(screen, suspicious)
    if comparison.effects:
        screen.print(Text(f"In the model: {', '.join(comparison.effects)}."))
    for table in comparison_tables(comparison):
        show_table(screen, table)
