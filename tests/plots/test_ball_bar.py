# SPDX-License-Identifier: Apache-2.0
"""Circles as they are drawn: whole where they were read all around, however far apart."""

import numpy as np
import pytest

from machine_tool_calibration.methods.identify import identify
from machine_tool_calibration.plots.ball_bar import figures
from machine_tool_calibration.simulation import SimulationSpec, simulate
from machine_tool_calibration.simulation.circle_run import CirclePlan


@pytest.mark.parametrize("count", [12, 40])
def test_no_point_of_a_circle_is_a_gap(count: int) -> None:
    session = simulate(SimulationSpec(plan=CirclePlan(count=count), seed=3)).session
    panel = figures(session, identify(session).document())["circles"].axes[0]
    drawn = [np.asarray(line.get_ydata(), float) for line in panel.lines if line.get_label() in ("↺", "↻")]
    assert drawn
    assert all(np.isfinite(one).all() for one in drawn)
