# SPDX-License-Identifier: Apache-2.0
"""Pictures of the error falling: its size step by step, and the residuals before and after."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from machine_tool_calibration.diagnosis.compare import residual_table
from machine_tool_calibration.diagnosis.improve import Improvement, Step
from machine_tool_calibration.model.fit import JointFit
from machine_tool_calibration.plots.residuals import color, draw_residuals, grids
from machine_tool_calibration.plots.style import new_figure, save
from machine_tool_calibration.reports.documents import write_table
from machine_tool_calibration.reports.improvement import step_document
from machine_tool_calibration.reports.quantities import quantity
from machine_tool_calibration.residuals.covariates import covariates, rank_covariates
from machine_tool_calibration.residuals.pool import Pool
from machine_tool_calibration.words import say

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


# Setups of a legend.
_LISTED = 8


def draw_improvement(improvement: Improvement) -> Figure:
    """The residual and the uncertainty of the map after every change, and the residuals before and after."""
    return draw_steps(improvement.steps, improvement.diagnosis.noise.declared)


def draw_steps(steps: Sequence[Step], declared: float) -> Figure:
    """The same of any models of one measurement, with the declared standard uncertainty of a reading, m."""
    figure = new_figure(15, 5.2)
    fall, before, after = figure.subplots(1, 3, width_ratios=[1, 1.15, 1.15])
    _fall(fall, steps, declared)
    first, last = steps[0], steps[-1]
    # Outliers would hide everything else: the first picture is of the readings that are kept.
    if len(steps) > 2 and any(last.set_aside):
        first = steps[1]
    after.sharex(before)
    after.sharey(before)
    name = _followed(first.result.joint)
    for panel, step, when in ((before, first, "before"), (after, last, "after")):
        _over(panel, step.result.joint, name)
        panel.set_title(say(f"picture.{when}", size=quantity(step.result.rms_residual, "m")), fontsize=10)
    grids(figure)
    return figure


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


def _followed(joint: JointFit) -> str:
    """The covariate of all sessions that the residuals follow most; the order of the readings where there is none."""
    every = [dict(rank_covariates(covariates(fit.model.observations), fit.residuals)) for fit in joint.fits]
    shared = {name: min(own[name] for own in every) for name in every[0] if all(name in own for own in every)}
    return max(shared, key=lambda name: shared[name], default="order")


def _over(panel: Axes, joint: JointFit, name: str) -> None:
    pool = Pool(joint)
    none = [np.full(len(one), np.nan) for one in pool.observations]  # where what is left does not vary any more
    own = [covariates(one).get(name, nan) for one, nan in zip(pool.observations, none, strict=True)]
    values = np.concatenate(own)
    draw_residuals(panel, name, values, pool.residuals, pool.setup)
    for k in np.unique(pool.setup)[:_LISTED]:
        panel.plot([], [], ".", color=color(int(k)), label=pool.setup_names[int(k)])
    panel.legend(fontsize=7, ncols=4, loc="upper center", bbox_to_anchor=(0.5, -0.2), frameon=False)


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
        kept = whole[[column for column in ("row", "setup", "repeat", "time", *"xyzabc") if column in whole]]
        table = kept.assign(residual_before=whole["residual"], residual_after=whole["row"].map(left))
        tables.append(table.assign(session=name)[["session", *table]] if name else table)
    return pd.concat(tables, ignore_index=True)


def save_improvement(improvement: Improvement, folder: Path) -> list[Path]:
    """Write `improve.png`, `improve.csv` and `residuals.csv` into a folder, which is made where it is missing."""
    origin = improvement.provenance
    (picture,) = save({"improve": draw_improvement(improvement)}, folder, origin)
    tables = {"improve": step_table(improvement), "residuals": residuals_before_and_after(improvement)}
    return [picture, *(write_table(table, folder / f"{name}.csv", origin) for name, table in tables.items())]
