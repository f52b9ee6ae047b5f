# SPDX-License-Identifier: Apache-2.0
"""A drilled plate step by step, and how well what is said of it agrees with how it was made."""

from __future__ import annotations

from dataclasses import replace
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from machine_tool_calibration.methods.identify import identify
from machine_tool_calibration.session.description import StandardUncertainty


def _steps(session: Any) -> dict[str, Any]:
    return dict(identify(session).document()["error_map"]["plate"])


def _sizes(step: dict[str, Any]) -> dict[str, tuple[float, float, float]]:
    return {p["name"]: (p["value"], p["standard_uncertainty"], p["p_value"]) for p in step["parameters"]}


def test_rigid_then_scale_then_scales_and_squareness(plates: ModuleType) -> None:
    session, _ = plates.plate(1, scales=(4e-5, 2e-5), square=5e-5)
    steps = _steps(session)["steps"]
    assert [step["unknowns"] for step in steps] == [3, 4, 6, 12]
    scatter = [step["scatter"] for step in steps]
    assert scatter[0] > scatter[1] > scatter[2]
    assert scatter[2] == pytest.approx(np.hypot(6e-6, 1e-6), rel=0.12)
    assert max(step["p_value"] for step in steps[1:3]) < 1e-9
    assert steps[3]["p_value"] > 0.01
    sizes = _sizes(steps[2])
    for name, true in {"scale_x.s": 4e-5, "scale_y.s": 2e-5, "C0Y.angle": 5e-5, "scale_x.s - scale_y.s": 2e-5}.items():
        value, u, p = sizes[name]
        assert abs(value - true) < 3.0 * u
        assert p < 1e-3


def test_sizes_over_many_plates_are_as_uncertain_as_stated(plates: ModuleType, many: Any) -> None:
    errors, found = [], 0
    more = many.part(4.0)  # each tells of four values only
    for seed in range(more.count):
        declared = (1.5e-7, 1.5e-6, 6e-5)[seed % 3]
        session, _ = plates.plate(
            seed,
            holes=80,
            scales=(3e-5, 3e-5),
            square=0.0,
            declared=declared,
            origin=((0.0, 0.0), (1.5, -0.8))[seed % 2],
        )
        steps = _steps(session)["steps"]
        sizes = _sizes(steps[2])
        for name, true in {
            "scale_x.s": 3e-5,
            "scale_y.s": 3e-5,
            "C0Y.angle": 0.0,
            "scale_x.s - scale_y.s": 0.0,
        }.items():
            errors.append((sizes[name][0] - true) / sizes[name][1])
        found += steps[2]["p_value"] < 0.01
    assert np.mean(np.square(errors)) == pytest.approx(1.0, abs=more.off(0.13))
    assert np.mean(np.abs(errors) < 2.0) == pytest.approx(0.95, abs=more.off(0.026))
    # Nothing beyond one scale: a false alarm in a hundred, and sampling.
    assert found <= more.at_most(0.01)


def test_far_readings_are_named_and_do_not_count(plates: ModuleType) -> None:
    session, far = plates.plate(4, scales=(3e-5, 3e-5), far=5)
    result = identify(session)
    assert sorted(r.row for r in result.rejected) == far
    value, u, _ = _sizes(result.document()["error_map"]["plate"]["steps"][1])["scale.s"]
    assert abs(value - 3e-5) < 3.0 * u


def test_repeats_of_a_hole_are_one_hole(plates: ModuleType) -> None:
    once, _ = plates.plate(5, holes=100)
    often, _ = plates.plate(5, holes=100, repeats=6)
    assert _steps(often)["places"] == _steps(once)["places"] == 200
    u_once, u_often = (_sizes(_steps(s)["steps"][1])["scale.s"][1] for s in (once, often))
    assert u_often == pytest.approx(u_once, rel=0.15)


def test_no_steps_for_a_single_axis_or_few_holes(plates: ModuleType) -> None:
    assert "plate" not in identify(plates.axis(1)).document()["error_map"]
    few, _ = plates.plate(1, holes=5)
    assert "plate" not in identify(few).document()["error_map"]


@pytest.mark.parametrize(("declared", "source"), [(1e-7, "scatter"), (1e-6, "scatter"), (6e-5, "declared")])
def test_standard_uncertainties_use_the_scatter_where_it_is_larger(
    plates: ModuleType, declared: float, source: str
) -> None:
    session, _ = plates.plate(6, scales=(1e-3, 1e-3), declared=declared)
    result = identify(session, effects=["scale"])
    scatter = result.document()["error_map"]["scatter"]
    assert scatter["uncertainties_from"] == source
    assert scatter["found"] == pytest.approx(6.1e-6, rel=0.1)
    assert scatter["declared"] == declared
    (u,) = (p.standard_uncertainty for p in result.parameters if p.name == "scale.s")
    points = session.readings.position()[::2, :2]
    spread = np.sqrt(np.sum((points - points.mean(axis=0)) ** 2))
    assert u == pytest.approx(max(scatter["found"], declared) / spread, rel=0.02)


def test_of_uncertainties_that_differ_the_root_mean_square_is_declared(plates: ModuleType) -> None:
    session = plates.axis(2)
    alike = StandardUncertainty(displacement=2e-7)
    differing = StandardUncertainty(displacement=2e-7, per_length=3e-6)
    for said in (alike, differing):
        described = replace(session, description=session.description.model_copy(update={"standard_uncertainty": said}))
        result = identify(described)
        each = said.displacement + said.per_length * np.abs(session.readings.columns["x"])
        scatter = result.error_map.content["scatter"]
        assert scatter["declared"] == pytest.approx(np.sqrt(np.mean(each**2)), rel=1e-12)
        ratio = scatter["found"] / scatter["declared"]
        assert ratio == result.error_map.content["spread_over_declared"] == np.sqrt(result.fit.joint.reduced_chi_square)


def test_effects_that_say_the_same_leave_the_simple_one(plates: ModuleType) -> None:
    session, _ = plates.plate(7, scales=(4e-5, 2e-5), square=5e-5)
    result = identify(session, effects=["scale", "EXX", "EYY", "C0Y", "EXY"])
    found = {p.name: p for p in result.parameters}
    assert {"scale.s", "EXX.p1", "C0Y.angle"} <= set(found)
    assert {"EYY.p1", "EXY.p1"} <= {n.name for n in result.not_determined}
    assert found["C0Y.angle"].value == pytest.approx(5e-5, abs=4 * found["C0Y.angle"].standard_uncertainty)


def test_a_time_constant_that_nothing_bounds_is_no_number(plates: ModuleType) -> None:
    for seed in range(4):
        session, _ = plates.plate(seed, holes=60)
        result = identify(session, effects=["warmup_x"])
        taus = [p.value for p in result.parameters if p.name == "warmup_x.tau"]
        assert all(tau > 0.0 for tau in taus)
        assert taus or "warmup_x.tau" in {n.name for n in result.not_determined}
