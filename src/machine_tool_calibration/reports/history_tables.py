# SPDX-License-Identifier: Apache-2.0
"""The models of a session that were tried, as tables: quick to load, without any calculation."""

from collections.abc import Callable, Sequence

from machine_tool_calibration.diagnosis.history import Entry
from machine_tool_calibration.reports.quantities import micrometres, of_map, quantity, rounded
from machine_tool_calibration.reports.tables import TextTable, table
from machine_tool_calibration.words import say

_FIGURES: dict[str, Callable[[Entry], str]] = {
    "head.variant": lambda one: one.model,
    "head.effects": lambda one: ", ".join(one.effects) or "–",
    "result.readings_used": lambda one: str(one.used),
    "history.set_aside": lambda one: str(one.readings_aside),
    "improved.rms": lambda one: micrometres(one.rms_residual),
    "result.chi": lambda one: rounded(one.reduced_chi_square),
    "history.freedom": lambda one: str(one.degrees_of_freedom),
    "improved.map": lambda one: of_map(one.map_rms, one.map_uncertainty_rms)[0],
    "history.U_map": lambda one: of_map(one.map_rms, one.map_uncertainty_rms)[1],
}
"""What is told of a model beside its coefficients, by the key of what it is."""


def tried_models(models: Sequence[Entry], current: int | None) -> TextTable:
    """Models of a history, one a row, with a mark at the one in use; a model stands twice where one went back to it."""
    return table(
        say("history.tried"),
        models,
        say("history.note"),
        model=lambda entry: f"{'→' if entry.number == current else ' '} {entry.number}",
        **{"from": lambda entry: "" if entry.parent is None else str(entry.parent)},
        made=lambda entry: entry.made.replace("T", " ")[:16],
        variant=lambda entry: entry.model,
        effects=lambda entry: ", ".join(entry.effects) or "–",
        change=lambda entry: entry.change or say("step.first"),
        readings=lambda entry: str(entry.used),
        residual=lambda entry: micrometres(entry.rms_residual),
        chi=lambda entry: rounded(entry.reduced_chi_square),
        map_moves=lambda entry: micrometres(entry.map_change_rms),
    )


def compared_models(one: Entry, other: Entry) -> TextTable:
    """Two models side by side: figures first, then each coefficient with its expanded uncertainty."""
    both = (one, other)
    rows: list[tuple[str, ...]] = [(say(key), *map(shown, both)) for key, shown in _FIGURES.items()]
    known = [{p.name: p for p in entry.parameters} for entry in both]
    for name in dict.fromkeys([*known[0], *known[1]]):
        texts = [
            quantity(k[name].value, k[name].unit, k[name].standard_uncertainty) if name in k else "–" for k in known
        ]
        rows.append((name, *texts))
    return TextTable(
        say("history.side"),
        ("", *(say("history.model", n=entry.number) for entry in both)),
        tuple(rows),
        say("history.coefficients") if len(rows) > len(_FIGURES) else "",
    )
