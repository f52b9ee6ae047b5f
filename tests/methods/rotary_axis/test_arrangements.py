# SPDX-License-Identifier: Apache-2.0
"""Fewer and more stations and targets than the paper's, other axes, and places that are hardly known.
The procedures that come with the package say what the method needs.
"""

import itertools
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from machine_tool_calibration.errors import ModelError
from machine_tool_calibration.machine.chain import Chain
from machine_tool_calibration.methods.build import build_model
from machine_tool_calibration.methods.identify import identify
from machine_tool_calibration.model.fit import fit_models
from machine_tool_calibration.procedure.description import Path as Targets
from machine_tool_calibration.procedure.description import Spread, read_procedure
from machine_tool_calibration.session.checks import check_session
from machine_tool_calibration.session.description import Direct, RotaryAxis
from machine_tool_calibration.session.session import Session
from machine_tool_calibration.simulation import PRESETS, FlawSpec, SimulationSpec, simulate

STATIONS = (
    *((-0.7, -0.5, 0.2), (0.8, -0.6, 0.35), (0.65, 0.75, 0.15), (-0.3, 0.35, 1.1)),
    *((0.2, -0.9, 0.6), (-0.8, 0.5, 0.5)),
)
TARGETS = {
    "P": (-0.1058046, 0.1353414, 0.0),
    "Q": (0.1288513, 0.0878158, 0.0399797),
    "K": (0.0249026, -0.1108575, 0.0152662),
    "R": (-0.12, -0.09, 0.06),
    "S": (0.05, 0.15, 0.05),
}
LEVEL = {"P": (-0.1, 0.13, 0.03), "Q": (0.12, 0.09, 0.03)}


@pytest.mark.long
@pytest.mark.parametrize(
    ("axis", "plan"),
    [
        ("C", {"stations": STATIONS[:3]}),
        ("C", {"stations": STATIONS, "targets": TARGETS}),
        ("C", {"targets": {name: TARGETS[name] for name in "PQKR"}, "hidden": {"P": (1.0, 1.8)}}),
        ("A", {}),
        ("B", {"repeats": 2}),
    ],
)
def test_normalised_errors_over_some_runs(
    rotary: SimpleNamespace, axis: str, plan: dict[str, object], many: Any
) -> None:
    some = many.part(0.4)
    error, u, _ = rotary.judged(some.count, axis, **plan)
    assert np.mean((error / u) ** 2) == pytest.approx(1.0, abs=some.off(0.055))
    # motion by motion
    ratio = np.sqrt(np.mean(error**2, axis=(0, 2)) / np.mean(u**2, axis=(0, 2)))
    assert ratio.max() < 1.0 + some.off(0.055)


@pytest.mark.long
def test_two_targets_at_one_height_show_how_the_table_turns(rotary: SimpleNamespace, many: Any) -> None:
    errors, stated = [], []
    some = many.part(0.5)
    for seed in range(some.count):
        simulated = rotary.measured(seed, targets=LEVEL)
        result = identify(simulated.session)
        assert {entry.name for entry in result.not_determined} == {"EXC", "EYC", "EZC", "EAC", "EBC"}
        content = result.error_map.content
        truth = simulated.truth.machine.motion("ECC", np.asarray(content["c"]))
        errors.append(content["ECC"] - content["ECC"].mean() - truth + truth.mean())
        stated.append(content["ECC_u"])
        assert np.isfinite(content["position_error"]).all()
    assert np.mean((np.array(errors) / np.array(stated)) ** 2) == pytest.approx(1.0, abs=some.off(0.055))


def test_targets_on_a_line_say_how_little_they_know(rotary: SimpleNamespace) -> None:
    line = {"P": (0.1, 0.0, 0.0), "Q": (0.2, 0.0, 0.0), "K": (-0.1, 0.0, 0.0)}
    simulated = rotary.measured(3, targets=line)
    check_session(simulated.session)
    content = identify(simulated.session).error_map.content
    assert np.max(content["ECC_u"]) < 5e-6 and np.min(content["EAC_u"][3:6]) > 1e-4


@pytest.mark.long
def test_one_station_after_another_sees_a_machine_that_does_not_repeat(rotary: SimpleNamespace, many: Any) -> None:
    some = many.part(0.2)
    one, four = (rotary.judged(some.count, repeats=repeats, repeatability=1e-6)[0][:, :3] for repeats in (1, 4))
    assert np.sqrt(np.mean(one**2) / np.mean(four**2)) == pytest.approx(2.0, rel=some.off(0.035))


@pytest.mark.long
def test_readings_of_other_places(rotary: SimpleNamespace) -> None:
    session: Session = rotary.measured(1, angles=tuple(np.radians(np.arange(0.0, 360.0, 40.0)))).session
    shuffled = np.random.default_rng(5).permutation(session.readings.displacement)
    lost = session.with_readings(replace(session.readings, displacement=shuffled))
    with pytest.raises(ModelError, match="state the stations to a decimetre") as caught:
        identify(lost)
    assert "\n" not in str(caught.value)


def test_axis_average_line_in_the_machine(rotary: SimpleNamespace, many: Any) -> None:
    normalised = []
    some = many.part(0.2)
    for axis, seed in itertools.product("ABC", range(some.count)):
        along = "ABC".index(axis)
        across, other = "XYZ"[(along + 1) % 3], "ABC"[(along + 2) % 3]
        line = {f"{across}0{axis}": 2e-4, f"{other}0{axis}": 3e-4}
        simulated = rotary.measured(seed, {"average_line": line}, axis=axis)
        found = identify(simulated.session).error_map.content["axis_average_line"]
        names = [name for name in found if not name.endswith("_u")]
        normalised.append([(found[n] - line.get(n, 0.0)) / found[f"{n}_u"] for n in names])
    # of 600 measurements, four values each, it may be off by 0.1
    assert np.mean(np.square(normalised)) == pytest.approx(1.0, abs=some.off(0.1))


def _moved(plan: str, *flaws: FlawSpec, effects: tuple[str, ...] = ()) -> tuple[np.ndarray, np.ndarray]:
    """Angles of the map, and by how much effects move its positions, m."""
    clean, flawed = (
        identify(simulate(SimulationSpec(plan=PRESETS[plan], seed=6, noise_factor=0.0, effects=put_in)).session,
                 effects=added).error_map
        for put_in, added in (((), ()), (flaws, effects))
    )  # fmt: skip
    return np.asarray(flawed.content["c"]), np.asarray(flawed.error - clean.error)


@pytest.mark.long
@pytest.mark.parametrize("effect", ["linear_drift", "dead_path"])
def test_what_changes_with_time_is_not_taken_for_an_error_of_the_angle(effect: str) -> None:
    drift = FlawSpec(id=effect, amplitude=3e-6)
    angles, moved = _moved("rotary_axis", drift)
    assert len(angles) == len(np.unique(angles)) == 18
    _, one_way = _moved("rotary_axis_one_way", drift)
    assert np.sqrt(np.mean(moved**2)) < 0.1 * np.sqrt(np.mean(one_way**2))
    assert np.sqrt(np.mean(one_way**2)) > 2e-7


@pytest.mark.usefixtures("reproducible")
def test_backlash_is_told_and_the_map_is_the_mean_of_both_directions() -> None:
    play = FlawSpec(id="backlash_c", size=1e-5)
    _, moved = _moved("rotary_axis", play)
    _, told = _moved("rotary_axis", play, effects=("backlash_c",))
    # Half the play on each side: their mean is where the axis stands without it.
    assert np.abs(moved).max() < 2e-9
    assert np.abs(told).max() < 2e-9


CONFIG = Path(__file__).parents[3] / "config" / "procedures"


def _positions(path: Targets, axis: str) -> np.ndarray:
    if path.points is not None:
        return np.array([point[axis] for point in path.points])
    entry = (path.grid or {})[axis]
    return np.array(entry.values() if isinstance(entry, Spread) else entry)


@pytest.mark.parametrize("name", ["rotary_axis", "rotary_axis_one_way"])
def test_rotary_axis(name: str) -> None:
    procedure = read_procedure(CONFIG / f"{name}.yaml")
    session = procedure.session
    assert procedure.name == name
    assert isinstance(session, RotaryAxis)
    angles = _positions(procedure.path, "c")
    low, high = session.machine.travel["c"]
    assert low <= angles.min() - procedure.motion.approach and angles.max() + procedure.motion.approach <= high
    assert len(session.setups) == 4 and len(session.targets) == 3
    distinct = len(np.unique(np.round(angles, 9)))
    # six motions an angle, stations, targets and zeros of the runs, less the twelve that the datum fixes
    assert distinct * 12 > 6 * distinct + 12 + 9 + 12 - 12
    np.testing.assert_allclose(np.diff(angles), np.radians(20.0))
    assert procedure.path.both_ways == (name == "rotary_axis")


def test_iso230_2() -> None:
    procedure = read_procedure(CONFIG / "direct_iso230_2.yaml")
    session = procedure.session
    assert isinstance(session, Direct)
    assert session.terms == ("EXX",) and session.repeats == 5
    assert "X" in Chain.parse(session.machine.chain).linear
    positions = _positions(procedure.path, "x")
    low, high = session.machine.travel["x"]
    assert low <= positions.min() - procedure.motion.approach and positions.max() + procedure.motion.approach <= high
    # Not all intervals are alike: a periodic error of the scale would go unseen.
    assert np.ptp(np.diff(positions)) > 1e-4


@pytest.mark.parametrize("seed", [507, 509, 511])
def test_a_fit_with_a_long_valley_converges(seed: int, rotary: SimpleNamespace) -> None:
    """Targets of one height, stations nearly so: a step after a damped one is too long again if it is free at once."""
    targets = {"P": (-0.18, 0.18, 0.0), "Q": (0.18, -0.18, 0.0), "K": (0.18, 0.18, 0.0)}
    stations = ((0.8, -0.8, 0.1), (0.8, 0.8, 1.1), (-0.8, 0.0, 1.1), (0.0, -0.8, 1.1), (-0.8, -0.8, 1.1))
    session = rotary.measured(seed, targets=targets, stations=stations).session
    assert fit_models([build_model(session)[0]]).solution.steps <= 20
