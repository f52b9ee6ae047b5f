# SPDX-License-Identifier: Apache-2.0
"""What a demonstration hides is found by its own measurement, and what it says of its map and the truth."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from machine_tool_calibration.cli.demo import _HIDDEN, COMPARED, _hidden, error_against_truth, map_error
from machine_tool_calibration.diagnosis.diagnose import diagnose
from machine_tool_calibration.methods.identify import identify
from machine_tool_calibration.simulation import PRESETS, FlawSpec, SimulationSpec, simulate
from machine_tool_calibration.simulation.site import Site, SiteSpec

SIZE = 3e-6


@pytest.fixture(scope="module")
def axis(tmp_path_factory: pytest.TempPathFactory) -> Any:
    """An axis with backlash, read without noise as the simulated nodes would read it."""
    folder = tmp_path_factory.mktemp("site")
    (folder / "site.yaml").write_text(f"seed: 4\neffects:\n- {{id: backlash_x, size: {SIZE}}}\n")
    site = Site(SiteSpec(seed=4, effects=(FlawSpec(id="backlash_x", size=SIZE),)))
    session = simulate(SimulationSpec(plan=PRESETS["iso230_2"], seed=3)).session
    readings = session.readings
    deviation = []
    for k, position in enumerate(readings.position()):
        commanded = dict(zip("xyz", map(float, position), strict=True))
        approach = {a: int(readings.column(f"dir_{a}")[k]) for a in "xyz"}
        moment = site.moment(float(readings.column("time")[k]), commanded, approach)
        deviation.append(site.functional_point(moment)[0, 0] - position[0])
    return SimpleNamespace(
        output=folder, session=session.with_readings(replace(readings, displacement=np.array(deviation)))
    )


def test_every_method_of_the_demonstration_is_compared() -> None:
    methods = {"tracking": "tracking_interferometer"}
    assert {methods.get(name, name) for name in _HIDDEN} == set(COMPARED)


def test_direct_deviations_are_judged_in_both_directions(axis: Any) -> None:
    without = error_against_truth(axis, identify(axis.session))
    found = error_against_truth(axis, identify(axis.session, effects=["backlash_x"]))
    # The first model has the mean of both directions: it is off by the half width in each.
    assert without.rms == pytest.approx(SIZE, rel=1e-3)
    assert found.rms < 1e-3 * SIZE
    assert found.before == without.before > SIZE


def test_what_a_measurement_leaves_open_is_no_error() -> None:
    rng = np.random.default_rng(3)
    points = rng.normal(size=(12, 3))
    true, free = 1e-6 * rng.normal(size=(12, 3)), rng.normal(size=(2, 12, 3))
    shifted = true + 1e-5 + 3e-6 * free[0] - 2e-6 * free[1]
    assert map_error(points, shifted, true, free).rms < 1e-12
    assert map_error(points, shifted, true).rms > 1e-6


def test_points_without_a_value_are_left_out() -> None:
    points = np.random.default_rng(4).normal(size=(9, 2))
    found = np.zeros((9, 2))
    found[3] = np.nan
    assert len(map_error(points, found, np.zeros((9, 2)), np.ones((1, 9, 2))).difference) == 8


_PLANS = {"step_diagonal": "step_diagonal", "direct": "iso230_2"}


def test_every_method_hides_something() -> None:
    for method in _HIDDEN:
        hidden = _hidden(method, 5, None)
        assert hidden is not None and hidden == _hidden(method, 5, None)
        assert _hidden(method, 5, "none") is None


@pytest.mark.long
@pytest.mark.parametrize("method", _PLANS)
def test_the_smallest_size_is_found(method: str) -> None:
    for name, (smallest, _) in _HIDDEN[method].items():
        spec = SimulationSpec(plan=PRESETS[_PLANS[method]], seed=2, effects=(FlawSpec(id=name, size=smallest),))
        assert diagnose(simulate(spec).session).accepted == (name,)
