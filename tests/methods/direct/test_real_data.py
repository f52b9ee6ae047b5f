# SPDX-License-Identifier: Apache-2.0
"""Hundreds of holes with more spread than declared, effects in the map, and mistakes."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from machine_tool_calibration.errors import ModelError
from machine_tool_calibration.methods.identify import identify

ALL = ("EXX", "EYX", "EXY", "EYY", "C0Y")


def _scattered_plate(direct: SimpleNamespace, seed: int, holes: int, spread: float) -> object:
    """Holes at random places, x and y of each measured on a coordinate measuring machine."""
    rng = np.random.default_rng(seed)
    place = np.repeat(np.column_stack([rng.uniform(0.01, 0.39, (holes, 2)), np.zeros(holes)]), 2, axis=0)
    sense = np.tile(np.eye(3)[:2], (holes, 1))
    return direct.measured(
        "points", seed, points=place.tolist(), directions=sense.tolist(), datum="rigid", terms=ALL,
        noise=2e-7, repeatability=spread,
    )  # fmt: skip


@pytest.mark.parametrize("holes", [150, 600])
def test_drilled_plate_with_more_spread_than_declared(direct: SimpleNamespace, holes: int) -> None:
    simulated = _scattered_plate(direct, 3, holes, 2e-6)
    result = identify(simulated.session)
    assert result.fit.joint.reduced_chi_square > 50
    assert result.error_map.content["spread_over_declared"] == pytest.approx(10.0, rel=0.15)
    content = result.error_map.content
    truth = simulated.truth.machine.position_error(content["points"])[:, :2]
    motions = direct.rigid_motions(content["points"])[:, :2]
    before = np.sqrt(np.mean(direct.fitted_out(truth, motions) ** 2))
    after = np.sqrt(np.mean(direct.fitted_out(content["position_error"][:, :2] - truth, motions) ** 2))
    expected = np.sqrt(np.mean(content["position_error_u"][:, :2] ** 2))
    assert after < 1.2 * expected
    assert after < before
    assert len(content["points"]) == holes


def test_scale_is_in_the_map(direct: SimpleNamespace) -> None:
    simulated = direct.measured("drilled_plate", 2, {"random": None}, effects=[{"id": "scale", "size": 2e-5}])
    result = identify(simulated.session, effects=["scale"])
    assert {p.name: p.value for p in result.parameters}["scale.s"] == pytest.approx(2e-5, abs=5e-7)
    points, error = result.error_map.points, result.error_map.error
    expected = direct.fitted_out(2e-5 * points[:, :2], direct.rigid_motions(points)[:, :2])
    np.testing.assert_allclose(error[:, :2], expected, atol=1.5e-7)


def test_backlash_gives_every_point_once_for_each_approach(direct: SimpleNamespace) -> None:
    simulated = direct.measured("iso230_2", repeats=4, effects=[{"id": "backlash_x", "size": 2e-6}])
    result = identify(simulated.session, effects=["backlash_x"])
    assert len(result.error_map.points) == 22
    assert result.fit.joint.reduced_chi_square < 1.5
    by_place: dict[float, list[float]] = {}
    for point, error in zip(result.error_map.points, result.error_map.error, strict=True):
        by_place.setdefault(round(float(point[0]), 9), []).append(float(error[0]))
    reversals = [abs(errors[0] - errors[1]) for errors in by_place.values()]
    np.testing.assert_allclose(reversals, 4e-6, atol=2e-7)


def test_positions_for_deviations(direct: SimpleNamespace) -> None:
    session = direct.measured("grid_plate").session
    readings = session.readings
    along = sum(readings.columns[a] * readings.columns[f"g{a}"] for a in "xyz")
    with pytest.raises(ModelError, match="displacement looks like the actual position;"):
        identify(session.with_readings(replace(readings, displacement=readings.displacement + along)))
    with pytest.raises(ModelError, match="actual position in millimetres"):
        identify(session.with_readings(replace(readings, displacement=1e3 * (readings.displacement + along))))
