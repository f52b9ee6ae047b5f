# SPDX-License-Identifier: Apache-2.0
"""Pictures of the error falling: its size step by step, and the residuals before and after."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.diagnosis.compare import residual_table
from machine_tool_calibration.diagnosis.improve import Improvement, Step
from machine_tool_calibration.model.observations import Observations
from machine_tool_calibration.plots.residuals import axis_label, color, grids, line_of, planes
from machine_tool_calibration.plots.style import name_axes, new_figure, round_down, save
from machine_tool_calibration.reports.documents import write_table
from machine_tool_calibration.reports.improvement import step_document
from machine_tool_calibration.reports.quantities import quantity
from machine_tool_calibration.residuals.pool import Pool
from machine_tool_calibration.session.catalogue import spec_of
from machine_tool_calibration.words import say

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from machine_tool_calibration.session.session import Session

__all__ = ["draw_improvement", "draw_steps", "residuals_before_and_after", "save_improvement", "step_table"]

_LENGTH = 0.12
_LISTED = 8
# Of the names beside each other in a legend.
_LETTERS = 56


def draw_improvement(improvement: Improvement) -> Figure:
    """The residual and the uncertainty of the map after every change, and maps of the residuals, to the same scale."""
    diagnosis = improvement.diagnosis
    return draw_steps(improvement.steps, diagnosis.chosen.sessions, diagnosis.noise.declared)


def draw_steps(steps: Sequence[Step], sessions: Sequence[Session], declared: float) -> Figure:
    """The same of any models of the same measurement, one after the other.

    Args:
        steps: the models, at least one.
        sessions: that were fitted.
        declared: standard uncertainty of a reading, m.
    """
    figure = new_figure(15, 5.2)
    fall, before, after = figure.subplots(1, 3, width_ratios=[1, 1.15, 1.15])
    _fall(fall, steps, declared)
    first, last = steps[0], steps[-1]
    # Outliers would hide everything else: the first picture is of the readings that are kept.
    if len(steps) > 2 and any(last.set_aside):
        first = steps[1]
    along = _along(first) if len(sessions) == 1 else None
    size = float(np.quantile(np.abs(Pool(first.result.joint).residuals), 0.98)) or 1e-9  # of the bulk, m
    for panel, step, when in ((before, first, "before"), (after, last, "after")):
        if along is not None:  # arrows would lie on each other
            _curves(panel, step, along, size)
        else:
            _arrows(panel, step, size)
        panel.set_title(say(f"picture.{when}", size=quantity(step.result.rms_residual, "m")), fontsize=10)
    grids(figure)
    return figure


def _along(step: Step) -> str | None:
    """What the residuals of a single session are drawn over where arrows would lie on each other."""
    observations = step.result.joint.fits[0].model.observations
    line = line_of(observations.position, observations.direction)
    spec = spec_of(observations.session)
    if spec.turns_one_axis or spec.states_runs:
        return "c" if spec.turns_one_axis else "path"
    return None if line is None else "xyz"[line]


def _fall(panel: Axes, steps: Sequence[Step], declared: float) -> None:
    at = np.arange(len(steps))
    panel.plot(
        at, [1e6 * s.result.rms_residual for s in steps], "o-", color="tab:red", label=say("picture.residual_rms")
    )
    left = [step.residual_volumetric_error(steps[-1]) for step in steps]
    tool = [np.nan if value is None else 1e6 * value for value in left]
    if np.isfinite(tool).any():
        panel.plot(at, tool, "s-", color="tab:blue", label=say("picture.volumetric"))
    panel.axhline(1e6 * declared, color="0.3", ls=":", label=say("picture.declared"))
    panel.set_xticks(at, [s.label for s in steps], rotation=20, ha="right", fontsize=8)
    panel.set_ylim(0.0)
    panel.margins(x=0.15)
    panel.set_ylabel("µm")
    panel.set_title(say("picture.falls"), fontsize=10)
    panel.legend(fontsize=8, loc="upper center", bbox_to_anchor=(0.5, -0.22), frameon=False)


def _arrows(panel: Axes, step: Step, size: float) -> None:
    """Residuals as arrows along what they sense, where the tool was."""
    pool = Pool(step.result.joint)
    a, b = (planes(pool.position, np.concatenate([o.direction for o in pool.observations])) or [(0, 1)])[0]
    place = 1e3 * pool.position[:, [a, b]]
    sense = np.concatenate([_sensed(o) for o in pool.observations])
    arrow = pool.residuals[:, None] * sense[:, [a, b]]
    extent = max(float(np.ptp(place, axis=0).max()), 1e-6)
    scale = _LENGTH * extent / size
    colors = [color(int(k)) for k in pool.setup]
    panel.plot(*place.T, ls="", marker=".", ms=2, color="0.7", zorder=0)
    quiver = panel.quiver(
        *place.T, *(scale * arrow.T), color=colors, angles="xy", scale_units="xy", scale=1.0, width=0.003, alpha=0.8
    )
    known = round_down(size)
    panel.quiverkey(quiver, 0.9, 0.95, scale * known, quantity(known, "m"), labelpos="W", color="0.2")
    names = [pool.setup_names[int(k)] for k in np.unique(pool.setup)]
    for k, name in zip(np.unique(pool.setup), names, strict=True):
        panel.plot([], [], "-", color=color(int(k)), label=name)
    if len(names) <= _LISTED:
        # As wide as the panel: a wider legend would take its place.
        columns = int(np.clip(_LETTERS // max(map(len, names)), 1, 4))
        panel.legend(fontsize=7, ncols=columns, loc="upper center", bbox_to_anchor=(0.5, -0.2), frameon=False)
    # Room for the arrows, which do not count as data.
    corners = np.array([place.min(axis=0), place.max(axis=0)]) + 1.6 * _LENGTH * extent * np.array([[-1.0], [1.0]])
    panel.plot(*corners.T, ls="")
    panel.set_aspect("equal", adjustable="datalim")
    panel.margins(0.0)
    name_axes(panel, a, b)


def _sensed(observations: Observations) -> Array:
    """(n, 3) along what a reading senses the tool, or the part where that is what moves."""
    table = observations.table_direction
    turned = spec_of(observations.session).probes_surface and np.abs(table).max(initial=0.0) > 0
    return table if turned else observations.direction


def _curves(panel: Axes, step: Step, name: str, size: float) -> None:
    """Residuals along each run of a single session."""
    fit = step.result.joint.fits[0]
    observations = fit.model.observations
    label, factor = axis_label(name)
    values = observations.path if name == "path" else observations.readings.columns[name]
    residuals = 1e6 * fit.residuals
    setups = observations.session.setup_ids
    named: set[int] = set()
    for run in np.unique(observations.run):
        mine = observations.run == run
        k = int(observations.readings.setup[mine][0])
        text = None if k in named else setups[k]
        named.add(k)
        panel.plot(factor * values[mine], residuals[mine], ".-", ms=3, lw=0.7, color=color(k), label=text)
    panel.set_ylim(-1.6e6 * size, 1.6e6 * size)
    panel.set_xlabel(label)
    panel.set_ylabel(say("picture.residual"))
    panel.legend(fontsize=7, ncols=4, loc="lower center")


def step_table(improvement: Improvement) -> pd.DataFrame:
    """One row for each step; SI units."""
    table = pd.DataFrame([step_document(step) for step in improvement.steps])
    table["change"] = table["change"].replace("", "first model")
    table["effects"] = table["effects"].map(" ".join)
    return table.drop(columns=["p_value", "parameters"])


def residuals_before_and_after(improvement: Improvement) -> pd.DataFrame:
    """One row for each reading of the first model, with its residual there and in the last one; SI units."""
    first, last = (improvement.steps[k].result.joint for k in (0, -1))
    tables = []
    for name, before, after in zip(first.assembly.labels or ("",), first.fits, last.fits, strict=True):
        whole, left = residual_table(before), residual_table(after).set_index("row")["residual"]
        kept = whole[[column for column in ("row", "setup", "repeat", "time", *"xyzc") if column in whole]]
        table = kept.assign(residual_before=whole["residual"], residual_after=whole["row"].map(left))
        tables.append(table.assign(session=name)[["session", *table]] if name else table)
    return pd.concat(tables, ignore_index=True)


def save_improvement(improvement: Improvement, folder: Path) -> list[Path]:
    """Write `improve.png`, `improve.csv` and `residuals.csv` into a folder, which is made where it is missing."""
    origin = improvement.provenance
    (picture,) = save({"improve": draw_improvement(improvement)}, folder, origin)
    tables = {"improve": step_table(improvement), "residuals": residuals_before_and_after(improvement)}
    return [picture, *(write_table(table, folder / f"{name}.csv", origin) for name, table in tables.items())]
