# SPDX-License-Identifier: Apache-2.0
"""The models of a session that were tried, as tables."""

from __future__ import annotations

from collections.abc import Callable

from machine_tool_calibration.diagnosis.history import Entry, History
from machine_tool_calibration.reports.quantities import micrometres, quantity, rounded
from machine_tool_calibration.reports.tables import TextTable

__all__ = ["compared_models", "tried_models"]

_FIGURES: dict[str, Callable[[Entry], str]] = {
    "variant": lambda one: one.model,
    "effects": lambda one: ", ".join(one.effects) or "–",
    "readings used": lambda one: str(one.used),
    "set aside": lambda one: str(one.readings_aside),
    "RMS residual, µm": lambda one: micrometres(one.rms_residual),
    "reduced chi-square": lambda one: rounded(one.reduced_chi_square),
    "degrees of freedom": lambda one: str(one.degrees_of_freedom),
    "position error of the map, µm RMS": lambda one: micrometres(one.map_rms),
    "its uncertainty U, µm RMS (k = 2)": lambda one: micrometres(
        None if one.map_uncertainty_rms is None else 2 * one.map_uncertainty_rms
    ),
}
"""What is told of a model beside its coefficients."""


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
            rounded(entry.reduced_chi_square),
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
    both = (one, other)
    rows = [(name, *map(shown, both)) for name, shown in _FIGURES.items()]
    known = [{p.name: p for p in entry.parameters} for entry in both]
    for name in dict.fromkeys([*known[0], *known[1]]):
        texts = [
            quantity(k[name].value, k[name].unit, k[name].standard_uncertainty) if name in k else "–" for k in known
        ]
        rows.append((name, *texts))
    return TextTable(
        "Side by side",
        ("", f"model {one.number}", f"model {other.number}"),
        tuple(rows),
        "coefficients ± U (k = 2)" if len(rows) > len(_FIGURES) else "",
    )
