# SPDX-License-Identifier: Apache-2.0
"""Who contributes what to the uncertainty of a result."""

from collections.abc import Sequence

import numpy as np

from machine_tool_calibration.budget.propagate import Budget, Sum
from machine_tool_calibration.plots.style import BAND, COLORS, FOUND, Axes, Figure, new_figure
from machine_tool_calibration.reports.budget import chosen_sums, sum_name, unit_of
from machine_tool_calibration.words import named, say, together

# Contributors with a colour of their own, and quantities below each other.
_MOST_COLORS, _MOST_BARS = 6, 24
# Share below which a contributor is one of all others, and number that is shown as next to nothing.
_LEAST_SHARE, _LEAST_NUMBER = 0.001, 1e-3
_HEIGHT = 0.7


def draw_budget(budget: Budget, names: Sequence[str] = ()) -> Figure:
    """Bars of the contributions to the first quantity, and of the shares in every quantity.

    A ModelError if one of the names is not published.
    """
    sums = chosen_sums(budget, names)[:_MOST_BARS]
    rows = max(len(budget.lines) + 2, len(sums))
    figure = new_figure(11.0, 1.8 + 0.28 * rows, say("budget.title"))
    if not sums:
        figure.text(0.5, 0.5, say("budget.nothing"), ha="center")
        return figure
    left, right = figure.subplots(1, 2)
    _contributions(left, budget, sums[0])
    _shares(right, budget, sums)
    return figure


def _contributions(panel: Axes, budget: Budget, one: Sum) -> None:
    """Standard uncertainties, the largest on top, and below them their sum and what the readings show."""
    factor, unit = unit_of(one)
    order = np.argsort([-part.u for part in one.shares], kind="stable")
    names = [named("contributor", budget.lines[k].name) for k in order]
    names += [say("budget.combined_short"), say("budget.readings_show")]
    values = [one.shares[k].u for k in order] + [one.u, one.u_identification]
    colors = [FOUND] * len(order) + [COLORS[6], BAND]
    place = np.arange(len(names))
    shown = factor * np.nan_to_num(np.array(values))
    panel.barh(place, shown, color=colors)
    for y, value in zip(place, shown, strict=True):
        text = f"{value:.3g}" if value >= _LEAST_NUMBER else f"< {_LEAST_NUMBER:g}"
        panel.annotate(text, (value, y), (3, 0), textcoords="offset points", va="center", fontsize="x-small")
    panel.set_yticks(place, names, fontsize="small")
    panel.invert_yaxis()
    panel.margins(x=0.15)
    panel.set_xlabel(say("budget.axis_u", unit=unit))
    where = [one.where] if one.index is not None else []
    panel.set_title(together([sum_name(one), *where], "\n"), fontsize="small")


def _shares(panel: Axes, budget: Budget, sums: Sequence[Sum]) -> None:
    shares = np.array([[part.share for part in one.shares] for one in sums])
    order = np.argsort(-shares.max(axis=0), kind="stable")
    place, begin = np.arange(len(sums)), np.zeros(len(sums))
    largest = [k for k in order[:_MOST_COLORS] if shares[:, k].max() >= _LEAST_SHARE]
    for number, k in enumerate(largest):
        name = named("contributor", budget.lines[k].name)
        panel.barh(place, 100 * shares[:, k], _HEIGHT, begin, color=COLORS[number], label=name)
        begin += 100 * shares[:, k]
    rest = np.maximum(100.0 * shares.sum(axis=1) - begin, 0.0)
    if len(order) > len(largest):
        panel.barh(place, rest, _HEIGHT, begin, color="0.8", label=say("budget.others"))
    panel.set_yticks(place, [sum_name(one) for one in sums], fontsize="small")
    panel.set(xlabel=say("budget.axis_share"), xlim=(0, 100), ylim=(max(len(sums), 4) - 0.4, -0.6))
    panel.figure.legend(*panel.get_legend_handles_labels(), fontsize="small", loc="outside lower center", ncols=4)
