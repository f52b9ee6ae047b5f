# SPDX-License-Identifier: Apache-2.0
"""Which unknowns of a model take up what one would add to it."""

import numpy as np
import pytest

from machine_tool_calibration.methods.build import build_model
from machine_tool_calibration.model.fit import absorbed_by, fit_models, screen
from machine_tool_calibration.model.model import POINTS
from machine_tool_calibration.simulation import PRESETS, SimulationSpec, simulate


@pytest.mark.parametrize("size", [1e-9, 1e-6, 1e-3])
def test_what_moves_the_points_is_theirs_and_an_offset_of_a_setup_its_dead_paths(size: float) -> None:
    """Whatever unit the columns have: what is seen of them is a share, and no number of standard uncertainties."""
    fit = fit_models([build_model(simulate(SimulationSpec(plan=PRESETS["tracking_2d"], seed=3)).session)[0]]).fits[0]
    observations = fit.model.observations
    x, y, _ = observations.position.T
    bent = np.column_stack([np.sin(9.0 * x), np.cos(8.0 * y) * x, 0.0 * x])
    moved = np.einsum("nj,nj->n", bent, observations.direction)
    # Of another sign in the second repeat, so that no place of a point does that; more in the first.
    readings = observations.readings
    offset = (readings.setup == 2) * np.where(readings.repeat == 0, 2.0, -1.0)
    projected = screen(fit, size * np.array([moved, offset]))
    assert absorbed_by(fit.joint, projected, slice(0, 1)) == (POINTS,)
    assert [p.name for p in absorbed_by(fit.joint, projected, slice(1, 2))][:1] == ["C.dead_path"]
