# SPDX-License-Identifier: Apache-2.0
"""The paper's uncertainty figures (Section 6) with assumed points: the same shape and size, not the same digits."""

from pathlib import Path

import numpy as np
import pytest

from machine_tool_calibration.methods.probing.forecast import forecast, planned_session
from machine_tool_calibration.procedure.workpiece import read_workpiece, workpiece_entries
from machine_tool_calibration.session.checks import check_session
from machine_tool_calibration.session.description import Probing

PART = Path(__file__).parents[3] / "config" / "workpieces" / "cross_pocket.yaml"
ANGLES = (0, 75, 130, 210)


@pytest.fixture(scope="module")
def plan():
    points = read_workpiece(PART)
    assert len(points) == 92
    nodes = [round(0.022 * k, 3) for k in range(-5, 6)]

    def described(count=4, touch=1.38e-6, spheres=True):
        kept = tuple(p for p in points if spheres or p.feature == "work")
        return Probing.model_validate(
            {
                "format": "mtcal-session/1",
                "method": "probing",
                "machine": {"chain": "w-C-b-Y-X-Z-t", "rotation_sign": -1, "table_grid": {"x": nodes, "y": nodes}},
                "workpiece": workpiece_entries(kept),
                "setups": [{"id": f"C{k + 1}", "c": float(np.radians(a))} for k, a in enumerate(ANGLES[:count])],
                "known": {"EXX": {"position": 0.11, "value": 0.0, "standard_uncertainty": 0.0}},
                "standard_uncertainty": {"displacement": touch},
            }
        )

    return described


def expanded(description):
    content = forecast(description).error_map.content
    return {key[:-2]: 2e6 * content[key] for key in content if key.endswith("_u")} | {"grid": content["grid"]}


def test_more_angles_lessen_the_uncertainty(plan):
    two, three, four = (expanded(plan(count))["workpiece_form"].max() for count in (2, 3, 4))
    assert two > 1.5 * three > 2.0 * four
    # Fig. 18(c): 2.1 um
    assert 1.0 < four < 4.2


def test_axes_are_least_certain_at_the_edges(plan):
    ours = expanded(plan())
    error, grid = ours["position_error"], ours["grid"]
    edge = np.abs(grid[:, 1]) > 0.109
    assert error[edge].max() == error.max()
    # Fig. 20(a): 28 um at Y = +-110 mm, below 10 um in a large portion
    assert 20 < error.max() < 40
    assert np.mean(error.max(axis=1) < 10) > 0.75
    assert np.all(error[np.all(np.abs(grid) < 1e-9, axis=1)] < 1e-6)


def test_angle_of_c(plan):
    ours = expanded(plan())
    assert ours["ECC"][0] == ours["EXC"][0] == ours["EYC"][0] == 0.0
    # Table 2: 8.9, 9.3, 8.2 urad
    np.testing.assert_allclose(ours["ECC"][1:], [8.9, 9.3, 8.2], rtol=0.15)


def test_spheres_help_at_the_edges_more_than_on_the_part(plan):
    with_spheres, without = expanded(plan()), expanded(plan(spheres=False))
    work = slice(0, 76)
    assert np.max(without["workpiece_form"] - with_spheres["workpiece_form"][work]) < 4.0  # Fig. 19
    assert without["position_error"].max() > 1.3 * with_spheres["position_error"].max()  # Fig. 20(b)


def test_uncertainty_is_in_proportion_to_that_of_a_touch(plan, reproducible):
    once, twice = expanded(plan()), expanded(plan(touch=2.76e-6))
    np.testing.assert_allclose(twice["workpiece_error"], 2 * once["workpiece_error"], rtol=1e-9)


def test_planned_session_is_a_session(plan):
    session = planned_session(plan())
    check_session(session)
    assert len(session.readings) == 4 * 92
