# SPDX-License-Identifier: Apache-2.0
"""Pictures of a model against its readings."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from machine_tool_calibration.diagnosis.compare import Comparison, JointComparison
from machine_tool_calibration.plots import residuals
from machine_tool_calibration.plots.style import COLORS, Axes, Figure, new_figure, save
from machine_tool_calibration.reports.quantities import rounded
from machine_tool_calibration.words import say

_PANELS = 6
_LISTED = 24  # setups that a legend names
_CANCELLED = 1e-6  # share of the largest residual below which what repeats leave in common is nothing


def draw(comparison: Comparison | JointComparison, folder: Path, against: Sequence[str] = ()) -> list[Path]:
    """Write all pictures into a folder; of several sessions those of each into one of its label there. The files.

    Residuals are drawn over the covariates `against` in the sessions that have them, by default over the first of their
    ranking; a ModelError if no session has one.
    """
    if isinstance(comparison, Comparison):
        return save(figures(comparison, against), folder, comparison.provenance)
    for name in against:
        if all(name not in one.covariates for one in comparison.sessions):
            comparison.sessions[0].covariate(name)
    files = save({"setups": draw_setups(comparison)}, folder, comparison.provenance)
    for label, one in zip(comparison.labels, comparison.sessions, strict=True):
        files += draw(one, folder / label, [name for name in against if name in one.covariates])
    return files


def figures(comparison: Comparison, against: Sequence[str] = ()) -> dict[str, Figure]:
    """The same pictures by name, not written."""
    return {
        "measured_predicted": _draw_fit(comparison),
        "residuals": draw_against(comparison, list(against) or chosen_covariates(comparison)),
        "residual_map": draw_map(comparison),
        "setups": draw_setups(comparison),
    }


def chosen_covariates(comparison: Comparison, most: int = _PANELS) -> list[str]:
    """Covariates whose running mean follows the residuals best, without those that would make the same picture."""
    values = {name: pd.Series(own) for name, own in comparison.covariates.items()}
    out: list[str] = []
    for name, _ in comparison.ranked:
        if not any(abs(values[name].corr(values[other], min_periods=3)) >= residuals.SAME_PICTURE for other in out):
            out.append(name)
    return out[:most]


def _draw_fit(comparison: Comparison) -> Figure:
    """Measured against predicted, the residuals against predicted, and their distribution beside the expected one."""
    from scipy import special

    figure = new_figure(13, 4.4)
    left, middle, right = figure.subplots(1, 3)
    table = comparison.residuals
    predicted = table["predicted"]
    factor, unit = (1e3, "mm") if np.ptp(predicted) > 1e-2 else (1e6, "µm")
    for k, (name, own) in enumerate(table.groupby("setup", observed=True)):
        style: dict[str, Any] = {"ls": "", "marker": ".", "ms": 3, "color": residuals.color(k), "label": name}
        left.plot(factor * own["predicted"], factor * own["measured"], **style)
        middle.plot(factor * own["predicted"], 1e6 * own["residual"], **style)
    ends = factor * np.array([predicted.min(), predicted.max()])
    left.plot(ends, ends, color="0.6", lw=0.8, zorder=0)
    predicted_in, measured_in = (say(f"picture.{what}", unit=unit) for what in ("predicted", "measured_unit"))
    left.set(xlabel=predicted_in, ylabel=measured_in, title=say("picture.against"))
    middle.set(xlabel=predicted_in, ylabel=say("picture.measured_less"), title=say("picture.left"))
    _noise_band(middle, comparison)
    if len(comparison.setups) <= _LISTED:
        left.legend(title=say("head.setup"), fontsize="small", markerscale=3)
    normal = np.sort(table["studentized"].dropna())
    if len(normal):
        expected = special.ndtri((np.arange(len(normal)) + 0.5) / len(normal))
        right.plot(expected, normal, ls="", marker=".", ms=3, color=COLORS[0])
        right.plot(expected[[0, -1]], expected[[0, -1]], color="0.6", lw=0.8, zorder=0)
    right.set(xlabel=say("picture.normal_noise"), ylabel=say("picture.over_declared"))
    right.set_title(say("picture.studentized", ratio=rounded(comparison.overall.ratio)))
    residuals.grids(figure)
    return figure


def draw_against(comparison: Comparison, names: Sequence[str]) -> Figure:
    """Residuals against covariates, which must be known, with their running mean and twice its standard uncertainty."""
    from matplotlib.lines import Line2D

    columns = min(3, max(1, len(names)))
    rows = -(-len(names) // columns) or 1
    figure = new_figure(4.4 * columns, 3.5 * rows)
    panels = figure.subplots(rows, columns, squeeze=False).ravel()
    setup = comparison.residuals["setup"].cat
    ids, number = setup.categories, np.asarray(setup.codes, dtype=np.int64)
    for panel, name in zip(panels, names, strict=False):
        residuals.draw_residuals(panel, name, comparison.covariate(name), comparison.fit.residuals, number)
        _noise_band(panel, comparison)
    for panel in panels[len(names) :]:
        panel.remove()
    if len(ids) <= _LISTED:
        handles = [Line2D([], [], ls="", marker="o", ms=5, color=residuals.color(k)) for k in range(len(ids))]
        title, across = say("head.setup"), min(len(ids), 3 * columns)
        figure.legend(handles, ids, loc="outside upper center", ncols=across, frameon=False, title=title)
    residuals.grids(figure)
    return figure


def draw_map(comparison: Comparison) -> Figure:
    """Residuals as arrows along the sensed direction where they were read, seen along one or three axes.

    Of readings along a line, in its direction, they stand up from it.
    """
    observations = comparison.fit.model.observations
    residual, position = comparison.fit.residuals, observations.position
    same = residuals.repeat_groups(observations)
    if not np.abs(np.bincount(same, residual)).max(initial=0.0) > _CANCELLED * np.abs(residual).max(initial=0.0):
        same = np.arange(len(residual))  # the model is of the places themselves: its repeats alone differ
    line = residuals.line_of(position, observations.direction)
    views = residuals.planes(position, observations.direction)
    if line is not None:
        figure = new_figure(9.0, 3.6)
        panel = figure.subplots()
        sign = residuals.sense_along(observations.direction, line)
        more = residual >= 0
        for which, own in ((more, residuals.color(1)), (~more, residuals.color(0))):
            place, shown = 1e3 * position[which, line], 1e6 * (sign * residual)[which]
            panel.vlines(place, 0.0, shown, colors=own, lw=0.6, alpha=0.5)
            panel.plot(place, shown, ".", color=own, ms=4)
        panel.axhline(0.0, color="0.6", lw=0.8)
        panel.set(xlabel=f"{'xyz'[line]}, mm", ylabel=say("picture.residual_along", axis="xyz"[line]))
    else:
        figure = new_figure(6.4 * len(views), 6.0)
        for panel, plane in zip(figure.subplots(1, len(views), squeeze=False).ravel(), views, strict=True):
            residuals.draw_arrows(panel, observations, residual, same, plane)
    figure.suptitle(say("picture.arrows"), fontsize=11, wrap=True)
    residuals.grids(figure)
    return figure


def draw_setups(comparison: Comparison | JointComparison) -> Figure:
    """Residuals of every setup in the order of the readings, worst first, with each repeat's mean; of all sessions."""
    of = dict(zip(comparison.labels or ("",), comparison.sessions, strict=True))
    setups = comparison.setups
    lines = [(of[row.get("session", "")], row) for row in setups.to_dict("records")]
    sizes = comparison.residuals["residual"].abs()
    figure = new_figure(11, max(3.2, 1.0 + 0.62 * len(lines)))
    strip, bars = figure.subplots(1, 2, sharey=True, width_ratios=(3, 1))
    spread = float(sizes.quantile(0.98)) or 1e-12
    for line, (one, part) in enumerate(lines):
        own = one.residuals[one.residuals["setup"] == part["name"]]
        number = residuals.color(own["setup"].cat.codes.iloc[0])
        at = line + pd.Series(0.5 * (np.arange(len(own)) / max(len(own) - 1, 1) - 0.5), own.index)
        strip.plot(1e6 * own["residual"], at, ls="", marker=".", ms=3, color=number)
        for _, repeat in own.groupby("repeat"):
            mean, mine = 1e6 * repeat["residual"].mean(), at[repeat.index]
            strip.plot([mean, mean], [mine.min() - 0.03, mine.max() + 0.03], color="black", lw=1.2)
        bars.barh(line, 1e6 * part["rms"], height=0.5, color=number, alpha=0.8)
        times = part["reduced_chi_square"] ** 0.5
        ratio = f"{rounded(times)} ×" if np.isfinite(times) else ""
        bars.annotate(f" {ratio}", (1e6 * part["rms"], line), va="center", fontsize=8)
        sigma = 2e6 * one.noise.declared
        strip.fill_betweenx([line - 0.5, line + 0.5], -sigma, sigma, color="0.92", lw=0, zorder=0)
    if sizes.max() > 2.5 * spread:
        strip.set_xlim(-2.5e6 * spread, 2.5e6 * spread)
        beyond = say("picture.beyond", n=int((sizes > 2.5 * spread).sum()))
        strip.text(0.99, 0.02, beyond, transform=strip.transAxes, ha="right", fontsize=8, color="0.4")
    strip.set_yticks(range(len(lines)), ["/".join(names) for names in setups.filter(["session", "name"]).to_numpy()])
    strip.invert_yaxis()
    strip.set(xlabel=say("picture.measured_less"), ylabel=say("picture.worst_first"))
    strip.set_title(say("picture.downwards"), fontsize=10)
    bars.set(xlabel=say("picture.rms"), title=say("picture.rms_declared"))
    bars.title.set_fontsize(10)
    bars.margins(x=0.4)
    residuals.grids(figure)
    return figure


def _noise_band(panel: Axes, comparison: Comparison) -> None:
    sigma = 2e6 * comparison.noise.declared
    panel.axhspan(-sigma, sigma, color="0.92", zorder=0)
