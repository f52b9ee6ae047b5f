"""Tables of error motions against their axis, each with its band of expanded uncertainty."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.plots.style import COLORS, MARKERS, new_figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["draw_tables", "read_tables"]

_ENTRY = re.compile(r"E([XYZABC])([XYZABC])\(([-+.0-9e]+)\)")
_SQUARENESS = ("A0Z", "B0Z", "C0Y")


def read_tables(parameters: Iterable[Mapping[str, Any]]) -> dict[str, Array]:
    """Tables among the parameters of a result's document.

    Returns:
        By name of the error motion, (k, 3): position, value and standard uncertainty, in the order of the position.
    """
    rows: dict[str, list[tuple[float, float, float]]] = {}
    for entry in parameters:
        match = _ENTRY.fullmatch(entry["name"])
        if match:
            row = (float(match[3]), float(entry["value"]), float(entry["standard_uncertainty"]))
            rows.setdefault(f"E{match[1]}{match[2]}", []).append(row)
    return {name: np.array(sorted(entries)) for name, entries in rows.items()}


def draw_tables(parameters: Iterable[Mapping[str, Any]], title: str = "Error motions") -> Figure | None:
    """One row of panels for each axis: positioning, straightness, angles; bands are U (k = 2).

    Args:
        parameters: of a result's document.
        title: of the picture.

    Returns:
        The picture; None where no table is among the parameters.
    """
    entries = list(parameters)
    tables = read_tables(entries)
    if not tables:
        return None
    axes = [axis for axis in "XYZABC" if any(name[2] == axis for name in tables)]
    kinds = [kind for kind in (_positioning, _straightness, _angles) if any(kind(name) for name in tables)]
    figure = new_figure(4.6 * len(kinds), 3.0 * len(axes) + 0.7, _with_squareness(title, entries))
    panels = figure.subplots(len(axes), len(kinds), squeeze=False)
    for row, axis in zip(panels, axes, strict=True):
        for panel, kind in zip(row, kinds, strict=True):
            _panel(panel, axis, {n: t for n, t in tables.items() if n[2] == axis and kind(n)})
    return figure


def _positioning(name: str) -> bool:
    return name[1] == name[2] and name[1] in "XYZ"


def _straightness(name: str) -> bool:
    return name[1] in "XYZ" and name[1] != name[2]


def _angles(name: str) -> bool:
    return name[1] in "ABC"


def _panel(panel: Axes, axis: str, tables: Mapping[str, Array]) -> None:
    if not tables:
        panel.set_axis_off()
        return
    rotary = axis in "ABC"
    factor, unit = (180 / np.pi, "°") if rotary else (1e3, "mm")
    for k, (name, table) in enumerate(sorted(tables.items())):
        where, value, band = table[:, 0] * factor, table[:, 1] * 1e6, 2e6 * table[:, 2]
        color = COLORS[k % len(COLORS)]
        panel.fill_between(where, value - band, value + band, color=color, alpha=0.2, lw=0)
        panel.plot(where, value, MARKERS[k % len(MARKERS)] + "-", color=color, ms=3.5, lw=1.2, label=name)
    panel.axhline(0.0, color="0.75", lw=0.8, zorder=0)
    panel.set_xlabel(f"{axis}, {unit}")
    panel.set_ylabel("µrad" if next(iter(tables))[1] in "ABC" else "µm")
    panel.legend(fontsize="small", frameon=False, ncols=len(tables), loc="lower left", bbox_to_anchor=(0.0, 0.99))
    panel.margins(x=0.03)


def _with_squareness(title: str, parameters: Iterable[Mapping[str, Any]]) -> str:
    found = {entry["name"]: entry for entry in parameters if entry["name"] in _SQUARENESS}
    parts = [
        f"{name} = {1e6 * entry['value']:.1f} ± {2e6 * entry['standard_uncertainty']:.2g} µrad"
        for name, entry in sorted(found.items())
    ]
    text = f"{title}, bands: U (k = 2)"
    return f"{text}\nsquareness: {', '.join(parts)}" if parts else text
