# SPDX-License-Identifier: Apache-2.0
"""Two maps of one machine held against each other, in words, as a table and as a document."""

from __future__ import annotations

from dataclasses import asdict
from typing import TYPE_CHECKING, Any

import numpy as np

from machine_tool_calibration.methods.map_comparison import BY_CHANCE, MapComparison
from machine_tool_calibration.model.result import plain
from machine_tool_calibration.reports.quantities import micrometres, p_value, plus_minus, quantity
from machine_tool_calibration.reports.tables import TextTable, show_table

if TYPE_CHECKING:
    from rich.console import Console

__all__ = ["map_comparison_document", "show_map_comparison"]

# Points of a table for people: of more, those of which the maps differ most.
_MOST = 25
# Motion that is rounding, m or rad.
_NOTHING = 1e-12


def _comparison_words(comparison: MapComparison) -> str:
    """Whether the maps agree, and where they differ most."""
    size = np.abs(comparison.normalised)
    k, j = np.unravel_index(int(np.nanargmax(size)), size.shape)
    place = ", ".join(f"{1e3 * v:.6g}" for v in comparison.points[k])
    verdict = (
        "The maps agree within their joint uncertainty"
        if comparison.agree
        else "The maps contradict each other: they differ by more than their joint uncertainty"
    )
    together = "" if comparison.p_value is None else f"; all differences together have {p_value(comparison.p_value)}"
    return (
        f"{verdict}. The largest normalised difference is E_n = {comparison.normalised[k, j]:+.2f}, "
        f"along {'xyz'[j]} at ({place}) mm; {comparison.beyond} of {comparison.count} exceed 1, of which chance makes "
        f"{BY_CHANCE * comparison.count:.1f}{together}."
    )


def _map_comparison_table(comparison: MapComparison) -> TextTable:
    """The differences point by point; of many points those with the largest normalised ones."""
    told = np.isfinite(comparison.difference)
    axes = np.flatnonzero(told.any(axis=0))
    order = np.flatnonzero(told.any(axis=1))
    note = f"± U (k = 2); E_n is the difference over its U; 1 is {comparison.labels[0]}, 2 is {comparison.labels[1]}"
    if len(order) > _MOST:
        worst = np.nanmax(np.abs(comparison.normalised[order]), axis=1)
        note += f"; the {_MOST} of {len(order)} points that differ most, all with --json"
        order = np.sort(order[np.argsort(-worst, kind="stable")[:_MOST]])
    heads = ["x, y, z / mm"]
    for j in axes:
        heads += [f"{'xyz'[j]}: 1 / µm", "2 / µm", "1 − 2 / µm", "E_n"]
    rows = []
    for k in order:
        row = [", ".join(f"{1e3 * v:.6g}" for v in comparison.points[k])]
        for j in axes:
            if told[k, j]:
                row += [
                    micrometres(float(comparison.first[k, j]), signed=True),
                    micrometres(float(comparison.second[k, j]), signed=True),
                    plus_minus(float(comparison.difference[k, j]), float(comparison.u[k, j]), 1e6),
                    f"{comparison.normalised[k, j]:+.2f}",
                ]
            else:
                row += [""] * 4
        rows.append(tuple(row))
    return TextTable("Position errors by both maps", tuple(heads), tuple(rows), note)


def show_map_comparison(screen: Console, comparison: MapComparison) -> None:
    """Print the verdict, the motion between the datums and the table."""
    show_table(screen, _map_comparison_table(comparison))
    moved = [
        f"{m.name} {quantity(m.value, m.unit, m.u)}"
        for m in comparison.motion
        if np.isfinite(m.value) and max(abs(m.value), m.u) > _NOTHING
    ]
    screen.print()
    screen.print(
        f"Taken out before, as the datums differ by it: {', '.join(moved)}."
        if moved
        else "Both maps have the same datum at these points: there is no common motion to take out."
    )
    screen.print(_comparison_words(comparison))


def map_comparison_document(comparison: MapComparison) -> dict[str, Any]:
    """For programs: SI units, standard uncertainties; what is not compared is null."""
    document = {
        "format": "mtcal-map-comparison/1",
        "maps": list(comparison.labels),
        "agree": comparison.agree,
        "p_value": comparison.p_value,
        "compared": comparison.count,
        "beyond_1": comparison.beyond,
        "motion": [asdict(m) for m in comparison.motion],
        "points": comparison.points,
        "first": comparison.first,
        "first_u": comparison.u_first,
        "second": comparison.second,
        "second_u": comparison.u_second,
        "difference": comparison.difference,
        "difference_u": comparison.u,
        "normalised": comparison.normalised,
    }
    return dict(plain(document))
