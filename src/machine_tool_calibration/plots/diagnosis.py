# SPDX-License-Identifier: Apache-2.0
"""Pictures of a diagnosis, with what the best candidate explains and residuals depend on, and of the error falling."""

from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from machine_tool_calibration.arrays import Array, rms
from machine_tool_calibration.diagnosis.compare import residual_table
from machine_tool_calibration.diagnosis.consequence import Consequence
from machine_tool_calibration.diagnosis.diagnose import Diagnosis
from machine_tool_calibration.diagnosis.improve import Improvement, Step
from machine_tool_calibration.model.fit import JointFit
from machine_tool_calibration.plots.residuals import axis_label, color, draw_residuals, grids
from machine_tool_calibration.plots.style import Axes, Figure, new_figure, save
from machine_tool_calibration.reports.diagnosis import ROWS_SHOWN
from machine_tool_calibration.reports.diagnosis_document import candidate_document
from machine_tool_calibration.reports.documents import write_table
from machine_tool_calibration.reports.improvement import step_document
from machine_tool_calibration.reports.quantities import probability, quantity
from machine_tool_calibration.reports.verdict import verdict_line
from machine_tool_calibration.residuals.covariates import bins, covariates, rank_covariates
from machine_tool_calibration.residuals.pool import Pool
from machine_tool_calibration.words import named, say, together

_LISTED = 8
_MEANS = 16
_BELOW: dict[str, Any] = {
    "fontsize": 7, "loc": "upper center", "bbox_to_anchor": (0.5, -0.13), "ncols": 3, "frameon": False
}  # fmt: skip
_COLUMNS = ["effect", "probability", "p_value", "delta_bic", "plausible", "rms_before", "rms_after", "map_change_rms"]


def draw_diagnosis(diagnosis: Diagnosis, changes: Mapping[str, Consequence]) -> Figure:
    """Three panels: the residual with each candidate, what the best explains, residuals over a covariate."""
    figure = new_figure(15, 4.8)
    ranking, added, over = figure.subplots(1, 3)
    figure.suptitle(_title(diagnosis))
    _ranking(ranking, diagnosis, changes)
    _added(added, diagnosis, changes)
    _over(over, diagnosis)
    grids(figure)
    return figure


def _title(diagnosis: Diagnosis) -> str:
    methods = dict.fromkeys(named("method", one.method.replace("_", " ")) for one in diagnosis.chosen.sessions)
    pool = Pool(diagnosis.fits[0])
    said = {"residual": quantity(rms(pool.residuals), "m"), "verdict": verdict_line(diagnosis)}
    return say("picture.residual_with", method=together(methods, " + "), n=len(pool.residuals), **said)


def _ranking(panel: Axes, diagnosis: Diagnosis, changes: Mapping[str, Consequence]) -> None:
    """Residual without and with each candidate, and the probability that it is the cause."""
    table = candidate_table(diagnosis, changes)[: len(diagnosis.accepted) + ROWS_SHOWN]
    place = np.arange(len(table))[::-1]
    before, after = 1e6 * table["rms_before"].to_numpy(), 1e6 * table["rms_after"].to_numpy()
    colors = ["tab:green" if name in diagnosis.accepted else "tab:blue" for name in table["effect"]]
    panel.barh(place, before, color="0.88", label=say("picture.without_it"))
    panel.barh(place, after, height=0.55, color=colors, label=say("picture.with_it"))
    for y, value, p in zip(place, before, table["probability"], strict=True):
        panel.text(value, y, f" {probability(p)}", va="center", fontsize=8, color="0.3")
    panel.axvline(1e6 * diagnosis.noise.declared, color="0.3", ls=":", label=say("picture.declared_u"))
    panel.set_yticks(place, table["effect"], fontsize=8)
    most = max(float(before.max(initial=0.0)), 1e6 * diagnosis.noise.declared)
    panel.set(xlabel=say("head.residual_um_rms"), xlim=(0.0, 1.12 * most))
    panel.set_title(say("picture.candidates"), fontsize=10)
    panel.legend(**_BELOW)


def _added(panel: Axes, diagnosis: Diagnosis, changes: Mapping[str, Consequence]) -> None:
    """Added-variable plot: a slope of one through the points if the effect is the cause."""
    if (name := next((r.name for r in diagnosis.ranked if r.name in changes), None)) is None:
        panel.set_axis_off()
        return
    explained = 1e6 * changes[name].explained
    pool = Pool(diagnosis.fits[0])
    residuals, setup = 1e6 * pool.residuals, pool.setup
    used = np.unique(setup)
    for k in used:
        mine = setup == k
        label = pool.setup_names[int(k)] if len(used) <= _LISTED else None
        panel.plot(explained[mine], residuals[mine], ".", ms=4, alpha=0.7, color=color(int(k)), label=label)
    ends = [float(explained.min()), float(explained.max())]
    panel.plot(ends, ends, color="0.3", lw=0.8)
    panel.set(xlabel=say("picture.takes_out", name=name), ylabel=say("picture.residual_without"))
    panel.set_title(say("picture.first_candidate"), fontsize=10)
    if len(used) <= _LISTED:
        panel.legend(fontsize=7)


def _over(panel: Axes, diagnosis: Diagnosis) -> None:
    """Residuals over what they depend on most, before and after."""
    first, last = Pool(diagnosis.fits[0]), Pool(diagnosis.fits[-1])
    name, values = _covariate(diagnosis)
    label, factor = axis_label(name)
    shown: list[tuple[str, Pool, str]] = [(say("compensation.before"), first, "tab:red")]
    if diagnosis.accepted:
        shown.append((say("picture.with", names=", ".join(diagnosis.accepted)), last, "tab:green"))
    number = bins(values, _MEANS)
    for text, fit, shade in shown:
        drawn = pd.DataFrame({"at": factor * values, "residual": 1e6 * fit.residuals})
        panel.plot(drawn["at"], drawn["residual"], ".", ms=4, color=shade, alpha=0.5, label=text)
        mean = drawn.groupby(number).mean()
        panel.plot(mean["at"], mean["residual"], "o-", ms=3, lw=1.2, color=shade, mec="black", mew=0.5, zorder=5)
    band = 2e6 * diagnosis.noise.declared
    panel.axhspan(-band, band, color="0.92", zorder=0, label=say("picture.declared_U"))
    panel.set(xlabel=label, ylabel=say("picture.residual"))
    panel.locator_params(axis="x", nbins=6)
    panel.set_title(say("picture.over_acts" if diagnosis.accepted else "picture.over_follow"), fontsize=10)
    panel.legend(**_BELOW)


def _covariate(diagnosis: Diagnosis) -> tuple[str, Array]:
    """What the picture is drawn over.

    The covariate, among those through which the first accepted effect acts, that what was taken out follows best;
    without one, that of the structure found first; else the one that the residuals follow; else the order.
    """
    first, last = Pool(diagnosis.fits[0]), Pool(diagnosis.fits[-1])
    every = [covariates(observations) for observations in first.observations]
    known = {name: np.concatenate([own[name] for own in every]) for name in every[0] if all(name in o for o in every)}
    known = {name: values for name, values in known.items() if np.isfinite(values).all()}
    if not diagnosis.accepted:
        for structure in diagnosis.search.structure:
            if structure.covariate in known:
                return structure.covariate, known[structure.covariate]
    what = first.residuals - last.residuals if diagnosis.accepted else first.residuals
    own = _acts_through(diagnosis, known)
    best = rank_covariates({name: known[name] for name in own} if own else known, what)
    name = best[0][0] if best else own[0] if own else "order"
    return name, known.get(name, np.arange(len(what), dtype=float))


def _acts_through(diagnosis: Diagnosis, known: Collection[str]) -> list[str]:
    """Covariates through which the first accepted effect acts, as it states itself."""
    first = diagnosis.accepted[0] if diagnosis.accepted else None
    if (effect := next((r.candidate.effect for r in diagnosis.ranked if r.name == first), None)) is None:
        return []
    # Where no times were recorded the order of the readings serves.
    needed = [name if name in known else name.replace("time", "order") for name in effect.covariates or effect.needs]
    # A direction of approach shows as the sign of the step along what the reading senses.
    along = [name for name in known if name.split(" along ")[0] in needed and " along " in name]
    return along or [name for name in known if name in needed]


def candidate_table(diagnosis: Diagnosis, changes: Mapping[str, Consequence]) -> pd.DataFrame:
    """One row for each candidate, best first; SI units."""
    rows = [candidate_document(diagnosis, found, changes) for found in diagnosis.ranked if found.rank]
    return pd.DataFrame(rows, columns=_COLUMNS)


def save_diagnosis(diagnosis: Diagnosis, changes: Mapping[str, Consequence], folder: Path) -> list[Path]:
    """Write `diagnosis.png` and `candidates.csv` into a folder, which is made where it is missing."""
    origin = diagnosis.fitted[0].provenance
    (picture,) = save({"diagnosis": draw_diagnosis(diagnosis, changes)}, folder, origin)
    return [picture, write_table(candidate_table(diagnosis, changes), folder / "candidates.csv", origin)]


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
        _residuals_over(panel, step.result.joint, name)
        panel.set_title(say(f"picture.{when}", size=quantity(step.result.rms_residual, "m")), fontsize=10)
    grids(figure)
    return figure


def _fall(panel: Axes, steps: Sequence[Step], declared: float) -> None:
    at, left_over = np.arange(len(steps)), [1e6 * step.result.rms_residual for step in steps]
    panel.plot(at, left_over, "o-", color="tab:red", label=say("picture.residual_rms"))
    left = [step.residual_volumetric_error(steps[-1]) for step in steps]
    tool = [np.nan if value is None else 1e6 * value for value in left]
    if np.isfinite(tool).any():
        panel.plot(at, tool, "s-", color="tab:blue", label=say("picture.volumetric"))
    panel.axhline(1e6 * declared, color="0.3", ls=":", label=say("picture.declared"))
    panel.set_xticks(at, [s.label for s in steps], rotation=20, ha="right", fontsize=8)
    panel.set(ylabel="µm", ylim=0.0)
    panel.margins(x=0.15)
    panel.set_title(say("picture.falls"), fontsize=10)
    panel.legend(fontsize=8, loc="upper center", bbox_to_anchor=(0.5, -0.22), frameon=False)


def _followed(joint: JointFit) -> str:
    """The covariate of all sessions that the residuals follow most; the order of the readings where there is none."""
    every = [dict(rank_covariates(covariates(fit.model.observations), fit.residuals)) for fit in joint.fits]
    shared = {name: min(own[name] for own in every) for name in every[0] if all(name in own for own in every)}
    return max(shared, key=lambda name: shared[name], default="order")


def _residuals_over(panel: Axes, joint: JointFit, name: str) -> None:
    pool = Pool(joint)
    none = [np.full(len(one), np.nan) for one in pool.observations]  # where what is left does not vary any more
    own = [covariates(one).get(name, nan) for one, nan in zip(pool.observations, none, strict=True)]
    draw_residuals(panel, name, np.concatenate(own), pool.residuals, pool.setup)
    for k in np.unique(pool.setup)[:_LISTED]:
        panel.plot([], [], ".", color=color(int(k)), label=pool.setup_names[int(k)])
    panel.legend(fontsize=7, ncols=4, loc="upper center", bbox_to_anchor=(0.5, -0.2), frameon=False)


def step_table(improvement: Improvement) -> pd.DataFrame:
    """One row for each step; SI units."""
    table = pd.DataFrame([step_document(step) for step in improvement.steps])
    table["change"] = table["change"].replace("", "first model")
    table["effects"] = table["effects"].map(" ".join)
    return table.drop(columns=["p_value", "parameters"])


def residuals_by_reading(improvement: Improvement) -> pd.DataFrame:
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
    tables = {"improve": step_table(improvement), "residuals": residuals_by_reading(improvement)}
    return [picture, *(write_table(table, folder / f"{name}.csv", origin) for name, table in tables.items())]
