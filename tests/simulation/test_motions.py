# SPDX-License-Identifier: Apache-2.0
import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from machine_tool_calibration.errors import ModelError
from machine_tool_calibration.simulation.motions import AxisMotion, Table, random_periodic, random_smooth


def test_linear_table_joins_its_nodes_by_straight_lines():
    table = Table((0.0, 0.1, 0.3), (0.0, 2e-6, -2e-6), "linear")
    assert table(0.05) == pytest.approx(1e-6, abs=1e-20)
    assert table(0.2) == pytest.approx(0.0, abs=1e-20)


def test_motions_of_an_axis_are_evaluated_together_as_each_alone():
    rng = np.random.default_rng(1)
    smooth = random_smooth(rng, -0.2, 0.3, [4e-6])[0]
    broken = Table((-0.1, 0.0, 0.2), (1e-6, 0.0, 3e-6), "linear")
    other = random_smooth(rng, -0.2, 0.3, [1e-5], knots=11)[0]
    axis = AxisMotion("X", (("EXX", smooth), ("EYX", broken), ("ECX", other), ("EXX", broken)))
    x = np.linspace(-0.3, 0.4, 351)
    values = axis(x)
    held = np.clip(x, -0.1, 0.2)
    ramp = np.interp(held, [-0.1, 0.0, 0.2], [1e-6, 0.0, 3e-6])
    spline = CubicSpline(smooth.nodes, smooth.values, bc_type="natural")
    np.testing.assert_allclose(values[:, 0], spline(np.clip(x, -0.2, 0.3)) + ramp, atol=1e-18)
    np.testing.assert_allclose(values[:, 1], ramp, atol=1e-18)
    np.testing.assert_allclose(
        values[:, 5], CubicSpline(other.nodes, other.values, bc_type="natural")(np.clip(x, -0.2, 0.3)), atol=1e-17
    )
    assert not values[:, 2:5].any()


def test_outside_its_nodes_a_motion_keeps_its_end_value():
    axis = AxisMotion("Y", (("EYY", Table((0.0, 0.1), (1e-6, 5e-6))),))
    np.testing.assert_allclose(axis(np.array([-1.0, 9.0]))[:, 1], [1e-6, 5e-6])


def test_random_motion_has_the_stated_size_and_its_zero():
    table = random_smooth(np.random.default_rng(3), -0.1, 0.4, [5e-6])[0]
    x = np.linspace(-0.1, 0.4, 2001)
    assert abs(table(0.0)) < 1e-18
    assert np.max(np.abs(table(x))) == pytest.approx(5e-6, rel=1e-3)


def test_random_periodic_motion_repeats_after_a_turn():
    table = random_periodic(np.random.default_rng(4), [2e-6])[0]
    axis = AxisMotion("C", (("EXC", table),))
    c = np.linspace(-1.0, 1.0, 50)
    np.testing.assert_allclose(axis(c), axis(c + 2 * np.pi), atol=1e-17)
    assert abs(axis(np.zeros(1))[0, 0]) < 1e-18
    slope = np.diff(axis(np.array([2 * np.pi - 1e-6, 2 * np.pi, 2 * np.pi + 1e-6]))[:, 0])
    assert slope[0] == pytest.approx(slope[1], rel=1e-3)


@pytest.mark.parametrize(
    ("nodes", "values", "kind"),
    [
        ((0.0, 0.0), (1.0, 2.0), "linear"),
        ((0.0, 1.0), (1.0,), "cubic"),
        ((0.0,), (1.0,), "cubic"),
        ((0.0, 1.0), (1.0, float("nan")), "linear"),
        ((0.0, 1.0, 2.0), (0.0, 1.0, 2.0), "periodic"),
    ],
)
def test_unfit_tables_are_refused(nodes, values, kind):
    with pytest.raises(ModelError):
        Table(nodes, values, kind)


def test_a_motion_of_another_axis_is_refused():
    with pytest.raises(ModelError, match="EXY is not an error motion of the X axis"):
        AxisMotion("X", (("EXY", Table((0.0, 1.0), (0.0, 0.0))),))
