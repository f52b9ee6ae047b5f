# SPDX-License-Identifier: Apache-2.0
"""Pictures of papers done anew: what each study hands over is drawn by the function for records of its kind."""

from __future__ import annotations

from functools import singledispatch
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from machine_tool_calibration.methods.map_comparison import MapComparison
from machine_tool_calibration.methods.step_diagonal.compare import Comparison
from machine_tool_calibration.plots.map_comparison import draw_map_comparison
from machine_tool_calibration.plots.rotary_axis import draw_motions
from machine_tool_calibration.plots.step_diagonal import draw_comparison
from machine_tool_calibration.plots.style import COLORS, save
from machine_tool_calibration.plots.tracking_study import draw_profiles, draw_target_uncertainty
from machine_tool_calibration.validation.record import Study
from machine_tool_calibration.validation.study_rotary_axis import Repeated
from machine_tool_calibration.validation.study_tracking import Profiles, TargetUncertainty

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["draw", "save_pictures"]


@singledispatch
def draw(record: Any) -> Figure:
    """The picture of a record.

    Raises:
        TypeError: nothing draws records of this kind.
    """
    raise TypeError(f"nothing draws {type(record).__name__}")


draw.register(Comparison, draw_comparison)
draw.register(MapComparison, draw_map_comparison)
draw.register(Profiles, draw_profiles)
draw.register(TargetUncertainty, draw_target_uncertainty)


@draw.register(Repeated)
def _repeated(record: Repeated) -> Figure:
    """The six error motions of the first measurement (Fig. 6), and one of them from all (Fig. 7)."""
    figure = draw_motions(record.content)
    panel = figure.axes[0]
    angle = np.degrees(np.asarray(record.content["c"]))
    for values in record.each:
        panel.plot(angle, 1e6 * values, ls="", marker="_", ms=8, color="0.3")
    panel.plot(angle, 1e6 * record.true, color=COLORS[1], lw=1.0, label="simulated axis")
    panel.plot([], [], ls="", marker="_", color="0.3", label=f"{len(record.each)} measurements")
    panel.legend(fontsize="small")
    return figure


def save_pictures(study: Study, folder: Path) -> list[Path]:
    """Draw all pictures of a study into files of a folder; names begin with the study's."""
    return save({f"{study.id}_{name}": draw(record) for name, record in study.pictures.items()}, folder)
