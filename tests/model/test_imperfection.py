# SPDX-License-Identifier: Apache-2.0
"""What every model lacks a little: smooth functions of place whose sum has the size of its coefficients."""

import numpy as np
import pytest

from machine_tool_calibration.methods.build import build_model
from machine_tool_calibration.model.imperfection import imperfection, scaled_values
from machine_tool_calibration.model.observations import Observations
from machine_tool_calibration.simulation import PRESETS, SimulationSpec, simulate


def observed(plan: str) -> Observations:
    return build_model(simulate(SimulationSpec(plan=PRESETS[plan], seed=2)).session)[0].observations


@pytest.mark.parametrize(
    ("plan", "count"),
    [
        # Four degrees of a coordinate, three products of a pair, four waves of an angle by sine and cosine.
        ("tracking_2d", 2 * 4 + 3 + 8),
        ("tracking_3d", 3 * 4 + 3 * 3 + 8),
        ("step_diagonal", 3 * 4 + 3 * 3),
        ("probing_cross", 2 * 4 + 3 + 2 * 8),
        ("iso230_2", 0),
    ],
)
def test_there_are_smooth_functions_of_size_one(plan: str, count: int) -> None:
    shapes = imperfection(observed(plan))
    assert shapes.shape == (count, len(observed(plan)))
    if count:
        rng = np.random.default_rng(1)
        drawn = rng.normal(size=(2000, count)) @ shapes
        assert np.sqrt(np.mean(drawn**2)) == pytest.approx(1.0, rel=0.03)


def test_they_are_legendre_polynomials_their_products_and_waves() -> None:
    own = observed("tracking_2d")
    shapes = imperfection(own)
    u, v = (2 * own.position[:, j] / own.position[:, j].max() - 1 for j in (0, 1))
    azimuth = np.arctan2(own.direction[:, 1], own.direction[:, 0])
    p2, q3 = (3 * u**2 - 1) / 2, (5 * v**3 - 3 * v) / 2
    unit = shapes[0] @ u / (u @ u)
    # The higher the degree or the order the smaller, in the inverse proportion.
    for row, expected in (
        (0, u), (1, p2 / 2), (6, q3 / 3), (8, u * v / 2), (9, u * (3 * v**2 - 1) / 2 / 3), (10, p2 * v / 3),
        (11, np.sin(azimuth)), (12, np.cos(azimuth)), (17, np.sin(4 * azimuth) / 4), (18, np.cos(4 * azimuth) / 4),
    ):  # fmt: skip
        np.testing.assert_allclose(shapes[row], unit * expected, atol=1e-12)


def test_values_between_their_ends() -> None:
    scaled = scaled_values(np.array([3.0, 5.0, 4.0]))
    assert scaled is not None and scaled.tolist() == [-1.0, 1.0, 0.0]
    small = scaled_values(np.array([-1e-10, 0.0, 3e-10]))
    assert small is not None and np.ptp(small) == 2.0
    for nothing in ([], [1.0, np.nan], [7.0, 7.0], [1e6, 1e6 + 1e-4]):
        assert scaled_values(np.array(nothing)) is None
