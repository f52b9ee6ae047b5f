# SPDX-License-Identifier: Apache-2.0
"""The sizes of a machine's errors over time."""

from datetime import datetime

from machine_tool_calibration.plots.style import BAND, COLORS, MARKERS, Axes, Figure, new_figure
from machine_tool_calibration.trends.trend import Course, Trend
from machine_tool_calibration.words import say

# Numbers that are drawn, in the order of the table, and panels beside each other.
_MOST_DRAWN, _ACROSS = 12, 3


def draw_trend(trend: Trend) -> Figure:
    """Each number over time with U (95 %), a colour for each instrument; what changed first, when it began shaded."""
    shown = trend.courses[:_MOST_DRAWN]
    across = min(_ACROSS, len(shown))
    down = -(-len(shown) // across)
    figure = new_figure(1.0 + 3.8 * across, 1.2 + 2.4 * down, say("trend.picture", machine=trend.machine))
    panels = figure.subplots(down, across, squeeze=False).reshape(-1)
    for panel, course in zip(panels, shown, strict=False):
        _draw(panel, course)
    for panel in panels[len(shown) :]:
        panel.set_axis_off()
    if any(len(course.ways) > 1 for course in shown):
        panels[0].legend(frameon=False, fontsize="x-small")
    return figure


def _draw(panel: Axes, course: Course) -> None:
    from matplotlib.dates import AutoDateLocator, ConciseDateFormatter, date2num

    when = [float(date2num(datetime.fromisoformat(date).replace(tzinfo=None))) for date in course.dates]  # type: ignore[no-untyped-call]
    scale, unit = {"m": (1e6, "µm"), "rad": (1e6, "µrad")}.get(
        course.unit, (1.0, course.unit if course.unit != "1" else "")
    )
    for k, way in enumerate(course.ways):
        rows = [i for i, own in enumerate(course.way) if own == k]
        panel.errorbar(
            [when[i] for i in rows], scale * course.value[rows], 2.0 * scale * course.u[rows],
            fmt=MARKERS[k % len(MARKERS)], color=COLORS[k % len(COLORS)], ms=4, lw=1.0, capsize=2, label=way,
        )  # fmt: skip
    if course.changed and course.explanation is not None:
        panel.axvspan(when[course.explanation.first], when[course.explanation.last], color=BAND, alpha=0.3, lw=0)
    if course.limit is not None:
        for sign in (1.0, -1.0) if course.value.min() < 0.0 else (1.0,):
            panel.axhline(sign * scale * course.limit, color=COLORS[1], lw=1.0, ls="--")
    locator = AutoDateLocator(maxticks=6)  # type: ignore[no-untyped-call]
    panel.xaxis.set_major_locator(locator)
    panel.xaxis.set_major_formatter(ConciseDateFormatter(locator))  # type: ignore[no-untyped-call]
    panel.tick_params(labelsize="x-small")
    panel.set_ylabel(unit, fontsize="small")
    kind = say(f"trend.possible_{course.kind}" if course.suspected else f"trend.{course.kind}")
    panel.set_title(f"{course.name}: {kind}", fontsize="small", fontweight="bold" if course.alarm else "normal")
