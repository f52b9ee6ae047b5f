# SPDX-License-Identifier: Apache-2.0
"""What each effect's residuals look like: one picture an effect."""

from collections.abc import Sequence
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path

import numpy as np

from machine_tool_calibration.arrays import Array, BoolArray
from machine_tool_calibration.effects.effect import Effect
from machine_tool_calibration.files import save
from machine_tool_calibration.planning.injected import Injected, inject
from machine_tool_calibration.plots import residuals
from machine_tool_calibration.plots.style import Figure, new_figure
from machine_tool_calibration.progress import Progress, untold
from machine_tool_calibration.reports.effect_page import gallery_page
from machine_tool_calibration.residuals.covariates import rank_covariates, sensed
from machine_tool_calibration.session.session import ENVIRONMENT_COLUMNS
from machine_tool_calibration.words import say

_OWN = 0.2  # advantage, in share of the residuals' variance, of each column on which the effect depends by its formula
_PANELS = 2
# Bins of the running mean: enough for the period of a screw. A displacement is read where it counts so much.
_BINS, _LEAST_SENSITIVITY = 24, 0.5
# Size of a picture: dots per inch, and colours.
_DPI, _HUES = 85, 96


def draw_gallery(effects: Sequence[Effect], folder: Path, progress: Progress = untold) -> list[Path]:
    """Write a picture of every effect into a folder, and a page (README.md) that shows them; it is the last file.

    An effect that shows in no simulated plan is on the page without a picture.
    """
    folder.mkdir(parents=True, exist_ok=True)
    found: dict[str, Injected | None] = {}
    files = []
    for k, effect in enumerate(effects):
        progress(effect.id, k / len(effects))
        found[effect.id] = injected = inject(effect)
        if injected is not None:
            files.append(folder / f"{effect.id}.png")
            _save(_draw_injected(injected), files[-1])
    return [*files, save(folder / "README.md", gallery_page(effects, found))]


def _draw_injected(injected: Injected) -> Figure:
    """Residuals against the first two covariates of their ranking, over the effect itself, and as a map."""
    comparison = injected.comparison
    observations = comparison.fit.model.observations
    effect = injected.effect
    what = say("picture.takes_it_up" if injected.taken_up else "picture.leaves", share=f"{injected.left:.0%}")
    title = say("picture.injected", id=effect.id, formula=effect.formula, plan=injected.plan, what=what)
    figure = new_figure(11.0, 3.7, title)
    panels = figure.subplots(1, _PANELS + 1, width_ratios=(1,) * _PANELS + (1.05,))
    setup = observations.readings.setup
    for panel, view in zip(panels, _views(injected), strict=False):
        values, factor = comparison.covariates[view.name][view.shown], residuals.axis_label(view.name)[1]
        panel.plot(factor * values, 1e6 * view.change, ls="", marker=".", ms=3, color="0.8", zorder=1)
        residuals.draw_residuals(panel, view.name, values, view.residual, setup[view.shown], _BINS)
        panel.set_ylabel(view.what)
    if injected.taken_up:
        where = {"ha": "center", "va": "center", "fontsize": 11, "color": "0.3"}
        panels[-1].text(0.5, 0.5, say("picture.taken_up"), transform=panels[-1].transAxes, **where)
        panels[-1].set_axis_off()
    else:
        plane = residuals.planes(observations.position, observations.direction)[0]
        same = residuals.repeat_groups(observations)
        residuals.draw_arrows(panels[-1], observations, comparison.fit.residuals, same, plane)
    residuals.grids(figure)
    return figure


def _save(figure: Figure, file: Path) -> None:
    """Write a picture with few colours, so that many of them stay small."""
    from PIL import Image

    drawn = BytesIO()
    figure.savefig(drawn, dpi=_DPI)
    Image.open(drawn).convert("RGB").quantize(_HUES).save(file, optimize=True)


@dataclass(frozen=True)
class _View:
    """Residuals against a covariate: those of all readings, or as displacements of an axis that these sense."""

    name: str
    what: str
    shown: BoolArray
    residual: Array
    change: Array


def _views(injected: Injected) -> list[_View]:
    """Two covariates that show most and differ from each other."""
    comparison, effect = injected.comparison, injected.effect
    observations = comparison.fit.model.observations
    own = {*effect.covariates, *effect.needs}
    # What the effect does not depend on, but happens to go with what it does, would only mislead.
    left_out = {"repeat", "order", *(name for name in ENVIRONMENT_COLUMNS if name not in own)}
    values = {name: v for name, v in comparison.covariates.items() if name not in left_out and np.isfinite(v).all()}
    everything = np.ones(len(observations), dtype=bool)
    ranked: list[tuple[float, _View]] = []
    for what, axis in ((say("picture.reading"), ""), *((say("picture.displacement_of", axis=a), a) for a in "xyz")):
        along = sensed(observations, axis) if axis else np.ones(len(observations))
        shown = np.abs(along) > _LEAST_SENSITIVITY if axis else everything
        # A displacement only where the effect is one of this axis, and enough readings sense it.
        if axis and (axis not in own or shown.sum() < len(observations) // 8):
            continue
        parts = [np.asarray(v[shown] / along[shown]) for v in (comparison.fit.residuals, injected.change)]
        told = (name for name in values if not (axis and " along " in name))
        picked = {name: values[name][shown] for name in told if np.ptp(values[name][shown]) > 0}
        for name, share in rank_covariates(picked, parts[1] if injected.taken_up else parts[0], _BINS):
            bonus = _OWN * len(set(name.split(" along ")) & own)
            ranked.append((share + bonus, _View(name, what, shown, *parts)))
    ranked.sort(key=lambda entry: -entry[0])
    out: list[_View] = []
    for _, view in ranked:
        if all(abs(np.corrcoef(values[view.name], values[other.name])[0, 1]) < residuals.SAME_PICTURE for other in out):
            out.append(view)
    return out[:_PANELS]
