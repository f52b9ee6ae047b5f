# SPDX-License-Identifier: Apache-2.0
"""Features of a probed workpiece, as a table for people and as a document for programs."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from machine_tool_calibration.arrays import COVERAGE
from machine_tool_calibration.methods.probing.features import Features, Quantity
from machine_tool_calibration.methods.probing.propagation import MonteCarlo
from machine_tool_calibration.methods.probing.shapes import Circle, Element
from machine_tool_calibration.reports.quantities import NOT_DETERMINED, decimals, fixed, quantity
from machine_tool_calibration.reports.tables import TextTable, show_table

if TYPE_CHECKING:
    from rich.console import Console

__all__ = ["features_document", "kind_of", "show_features"]

# Standard uncertainty of what the datum lays down, m and rad: rounding alone.
_NOTHING = 1e-12


def kind_of(one: Element) -> str:
    """Circle (pin, disc or sphere), hole or line."""
    if not isinstance(one, Circle):
        return "line"
    return "hole" if one.hole else "circle"


def show_features(screen: Console, found: Features, drawn: MonteCarlo | None) -> None:
    """Print the features, their frame, and what gives none."""
    show_table(screen, _features_table(found, drawn))
    for name, why in found.left_out.items():
        screen.print(f"Not a feature: {name}: {why}.")


def _features_table(found: Features, drawn: MonteCarlo | None) -> TextTable:
    """Nominal value and deviation of every quantity, with expanded uncertainty (k = 2)."""
    heads = ("feature", "quantity", "nominal", "actual − nominal")
    rows = []
    for k, (asked, deviation, u) in enumerate(zip(found.quantities, found.deviation, found.uncertainty, strict=True)):
        row = [", ".join(asked.of), asked.what, _nominal(asked), NOT_DETERMINED]
        interval = ""
        if math.isfinite(deviation):
            row[3] = "0 (datum)" if u < _NOTHING else quantity(deviation, asked.unit, u)
            if drawn is not None and u >= _NOTHING:
                ends = (fixed(1e6 * (deviation + end[k]), decimals(2e6 * u)) for end in (drawn.low, drawn.high))
                interval = f"{' to '.join(ends)} µ{asked.unit}"
        rows.append((*row, interval))
    by_draws = "" if drawn is None else f"{100 * COVERAGE:.4g} % of {drawn.draws} draws, touches {drawn.distribution}"
    title = "Features of the workpiece, ± U (k = 2)"
    return TextTable(title, (*heads, by_draws), tuple(rows), f"frame: {found.datum}")


def _nominal(asked: Quantity) -> str:
    if asked.unit == "m":
        return f"{fixed(1e3 * asked.nominal, 4)} mm"
    return f"{fixed(math.degrees(asked.nominal), 4)}°"


def features_document(found: Features, drawn: MonteCarlo | None = None) -> dict[str, Any]:
    """For programs, SI; what the touches do not determine is NaN."""
    quantities = []
    for k, (asked, deviation, u) in enumerate(zip(found.quantities, found.deviation, found.uncertainty, strict=True)):
        entry: dict[str, Any] = {
            "features": list(asked.of),
            "quantity": asked.what,
            "unit": asked.unit,
            "nominal": asked.nominal,
            "deviation": float(deviation),
            "standard_uncertainty": float(u),
        }
        if drawn is not None:
            entry["draws"] = {
                "standard_uncertainty": float(drawn.uncertainty[k]),
                "interval": [float(deviation + end[k]) for end in (drawn.low, drawn.high)],
            }
        quantities.append(entry)
    document: dict[str, Any] = {
        "format": "mtcal-features/1",
        "datum": found.datum,
        "features": [{"name": one.name, "kind": kind_of(one), "points": len(one.index)} for one in found.elements],
        "left_out": [{"name": name, "why": why} for name, why in found.left_out.items()],
        "quantities": quantities,
        "covariance": found.covariance,
    }
    if drawn is not None:
        document |= {
            "draws": drawn.draws,
            "distribution": drawn.distribution,
            "coverage_probability": COVERAGE,
        }
    return document
