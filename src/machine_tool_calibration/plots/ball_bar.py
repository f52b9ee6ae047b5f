# SPDX-License-Identifier: Apache-2.0
"""Pictures of circles with a ball bar: radial deviations around the circle, both ways (ISO 230-4)."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from machine_tool_calibration.plots.style import COLORS, NOMINAL, Axes, Figure, new_figure, numbers, round_down
from machine_tool_calibration.reports.quantities import as_exact
from machine_tool_calibration.session.session import Session
from machine_tool_calibration.words import say, together

_SHARE = 0.35  # share of the drawn radius that the largest deviation takes
_EDGE = 1.1 + _SHARE
# Step between readings from which the arc has a gap, rad, and over the usual one.
_GAP, _STEPS_OF_A_GAP = 0.2, 3.0
_SHOWN = ("G_ccw", "G_cw", "G_b", "H")


def figures(session: Session, result: Mapping[str, Any]) -> dict[str, Figure]:
    """One of all circles; none where the way round was not recorded."""
    content = result["error_map"]
    circles = content.get("circles") or ()
    return {"circles": draw_circles(circles, content.get("figures") or ())} if circles else {}


def draw_circles(circles: Sequence[Mapping[str, Any]], values: Sequence[Mapping[str, Any]]) -> Figure:
    """A panel each setup: both paths, magnified, about their least-squares circle, with its figures.

    A circle has of each setup and way round `setup`, `plane`, `way`, `angle`, rad, and `deviation`, m; figures of
    ISO 230-4 have `setup`, `name`, `value` and `U`, m.
    """
    setups = list(dict.fromkeys(circle["setup"] for circle in circles))
    largest = max(float(np.abs(numbers(circle["deviation"])).max()) for circle in circles) or 1e-6
    columns = min(len(setups), 3)
    rows = -(-len(setups) // columns)
    figure = new_figure(5.2 * columns, 5.6 * rows, say("picture.circles"))
    panels = figure.subplots(rows, columns, squeeze=False).ravel()
    for panel, setup in zip(panels, setups, strict=False):
        _draw(panel, [circle for circle in circles if circle["setup"] == setup], largest)
        known = [one for one in values if one["setup"] == setup and one["name"] in _SHOWN]
        text = together((f"{one['name']} = {as_exact(one['value'], 'm', one['U'])}" for one in known), "   ")
        panel.set_title(together((setup, text), "\n"), fontsize="small")
    for panel in panels[len(setups) :]:
        panel.remove()
    return figure


def _draw(panel: Axes, circles: Sequence[Mapping[str, Any]], largest: float) -> None:
    around = np.linspace(0.0, 2.0 * np.pi, 361)
    step = round_down(largest)
    for ring, style in ((1.0, "-"), (1.0 + _SHARE * step / largest, ":"), (1.0 - _SHARE * step / largest, ":")):
        panel.plot(ring * np.cos(around), ring * np.sin(around), style, color=NOMINAL, linewidth=0.8)
    for circle, color in zip(circles, COLORS, strict=False):
        angle, deviation = numbers(circle["angle"]), numbers(circle["deviation"])
        radius = 1.0 + _SHARE * deviation / largest
        arrow = "↺" if circle["way"] == "ccw" else "↻"
        # A gap of the arc stays open.
        steps = np.diff(angle, prepend=angle[:1])
        broken = steps > max(_GAP, _STEPS_OF_A_GAP * float(np.median(steps)))
        radius = np.where(broken, np.nan, radius)
        panel.plot(radius * np.cos(angle), radius * np.sin(angle), color=color, linewidth=1.2, label=arrow)
    first, second = circles[0]["plane"]
    panel.set(xlabel=say("picture.one_division", axis=first, size=f"{1e6 * step:.3g}"), ylabel=second, aspect="equal")
    panel.set(xticks=[], yticks=[], xlim=(-_EDGE, _EDGE), ylim=(-_EDGE, _EDGE))
    panel.legend(frameon=False, loc="center")
