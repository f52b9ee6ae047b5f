# SPDX-License-Identifier: Apache-2.0
"""The models of a session that were tried, as tables."""

from __future__ import annotations

from machine_tool_calibration.diagnosis.history import Entry, History
from machine_tool_calibration.reports.quantities import NOT_DETERMINED, micrometres, quantity, rounded
from machine_tool_calibration.reports.tables import TextTable

__all__ = ["compared_models", "tried_models"]

# Rows of a comparison before the coefficients.
_FIGURES = 9


def tried_models(history: History) -> TextTable:
    """Every model of the history, one a row."""
    rows = tuple(
        (
            f"{'→' if entry.number == history.current else ' '} {entry.number}",
            "" if entry.parent is None else str(entry.parent),
            entry.made.replace("T", " ")[:16],
            entry.model,
            ", ".join(entry.effects) or "–",
            entry.change or "first model",
            str(entry.used),
            micrometres(entry.rms_residual),
            _chi_square(entry),
            micrometres(entry.map_change_rms),
        )
        for entry in history.models
    )
    heads = (
        *("model", "from", "made (UTC)", "variant", "effects", "change", "readings"),
        *("residual", "chi²/ν", "map moves"),
    )
    return TextTable("Models tried; → is the current one", heads, rows, "residual and map in µm RMS")


def compared_models(one: Entry, other: Entry) -> TextTable:
    """Two models side by side: figures first, then each coefficient with its expanded uncertainty."""

    def row(name: str, first: str, second: str) -> tuple[str, str, str]:
        return (name, first, second)

    both = (one, other)
    rows = [
        row("variant", one.model, other.model),
        row("effects", ", ".join(one.effects) or "–", ", ".join(other.effects) or "–"),
        row("readings used", str(one.used), str(other.used)),
        row("set aside", str(one.readings_aside), str(other.readings_aside)),
        row("RMS residual, µm", micrometres(one.rms_residual), micrometres(other.rms_residual)),
        row("reduced chi-square", _chi_square(one), _chi_square(other)),
        row("degrees of freedom", str(one.degrees_of_freedom), str(other.degrees_of_freedom)),
        row("position error of the map, µm RMS", micrometres(one.map_rms), micrometres(other.map_rms)),
        row(
            "its uncertainty U, µm RMS (k = 2)",
            *(micrometres(None if e.map_uncertainty_rms is None else 2 * e.map_uncertainty_rms) for e in both),
        ),
    ]
    known = [{p.name: p for p in entry.estimates()} for entry in both]
    for name in dict.fromkeys([*known[0], *known[1]]):
        texts = [
            quantity(k[name].value, k[name].unit, k[name].standard_uncertainty) if name in k else "–" for k in known
        ]
        rows.append(row(name, *texts))
    return TextTable(
        "Side by side",
        ("", f"model {one.number}", f"model {other.number}"),
        tuple(rows),
        "coefficients ± U (k = 2)" if len(rows) > _FIGURES else "",
    )


def _chi_square(entry: Entry) -> str:
    return NOT_DETERMINED if entry.reduced_chi_square is None else rounded(entry.reduced_chi_square)
