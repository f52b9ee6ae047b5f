"""What each effect's residuals look like: one picture an effect."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from machine_tool_calibration.diagnosis.covariates import telling
from machine_tool_calibration.diagnosis.effect_page import gallery_page
from machine_tool_calibration.diagnosis.injected import Injected, inject
from machine_tool_calibration.diagnosis.noise import same_place
from machine_tool_calibration.effects.effect import Effect
from machine_tool_calibration.plots.residuals import axis_label, draw_arrows, draw_residuals, grids, planes
from machine_tool_calibration.plots.style import new_figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["draw_gallery", "draw_injected"]

# Advantage, in share of the residuals' variance, of covariates on which the effect depends by its formula.
_OWN = 0.15
_SAME = 0.97
_PANELS = 2


def draw_gallery(
    effects: Sequence[Effect], folder: Path, progress: Callable[[str, float], None] = lambda what, share: None
) -> list[Path]:
    """Write a picture of every effect into a folder, and a page (README.md) that shows them.

    Args:
        effects: which.
        folder: where; made if it is not there.
        progress: told the effect and the share that is finished.

    Returns:
        The files, the page last. An effect that shows in no simulated plan is on the page without a picture.
    """
    folder.mkdir(parents=True, exist_ok=True)
    found: dict[str, Injected | None] = {}
    files = []
    for k, effect in enumerate(effects):
        progress(effect.id, k / len(effects))
        found[effect.id] = injected = inject(effect)
        if injected is not None:
            files.append(folder / f"{effect.id}.png")
            draw_injected(injected).savefig(files[-1], dpi=80, pil_kwargs={"optimize": True})
    page = folder / "README.md"
    page.write_text(gallery_page(effects, found), encoding="utf-8")
    return [*files, page]


def draw_injected(injected: Injected) -> Figure:
    """Residuals against the two most telling covariates, over the effect itself, and as a map."""
    comparison = injected.comparison
    observations = comparison.fit.model.observations
    effect = injected.effect
    what = "nothing to see" if injected.taken_up else f"the model leaves {injected.left:.0%} of it"
    title = f"{effect.id}: {effect.formula}\n{injected.plan}, no noise, no other error; {what}"
    figure = new_figure(11.0, 3.7, title)
    panels = figure.subplots(1, _PANELS + 1, width_ratios=(1,) * _PANELS + (1.05,))
    setup = observations.readings.setup
    for panel, name in zip(panels, _names(injected), strict=False):
        values, factor = comparison.covariates[name], axis_label(name)[1]
        panel.plot(factor * values, 1e6 * injected.change, ls="", marker=".", ms=3, color="0.8", zorder=1)
        draw_residuals(panel, name, values, comparison.residual, setup)
        panel.set_ylabel("µm (gray: the effect itself)" if panel is panels[0] else "")
    if injected.taken_up:
        where = {"ha": "center", "va": "center", "fontsize": 11, "color": "0.3"}
        panels[-1].text(0.5, 0.5, "taken up by the model:\nnothing to see", transform=panels[-1].transAxes, **where)
        panels[-1].set_axis_off()
    else:
        a, b = planes(observations.position, observations.direction)[0]
        arrow = comparison.residual[:, None] * observations.direction
        same = same_place(observations)
        draw_arrows(panels[-1], observations.position[:, [a, b]], arrow[:, [a, b]], comparison.residual, same)
        panels[-1].set(xlabel=f"{'xyz'[a]}, mm", ylabel=f"{'xyz'[b]}, mm")
    grids(figure)
    return figure


def _names(injected: Injected) -> list[str]:
    """Two covariates that show most and differ from each other."""
    comparison, effect = injected.comparison, injected.effect
    values = dict(comparison.covariates)
    values.pop("repeat", None)
    seen = injected.change if injected.taken_up else comparison.residual
    own = {*effect.covariates, *effect.needs} - {"order"}
    shares = telling(values, seen)
    ranked = sorted(shares, key=lambda entry: -(entry[1] + (_OWN if set(entry[0].split(" along ")) & own else 0.0)))
    out: list[str] = []
    for name, _ in ranked:
        if all(abs(np.corrcoef(values[name], values[other])[0, 1]) < _SAME for other in out):
            out.append(name)
    return out[:_PANELS]
