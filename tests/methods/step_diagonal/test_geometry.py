# SPDX-License-Identifier: Apache-2.0
"""Runs, their orders and block positions.
Against exact geometry, without noise: what each estimator leaves.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from papers.formulations import identify_by_formulation

from machine_tool_calibration.errors import SessionError
from machine_tool_calibration.methods.identify import identify
from machine_tool_calibration.methods.step_diagonal.build import build, second_order
from machine_tool_calibration.methods.step_diagonal.geometry import (
    _distinct,
    across,
    block_positions,
    halts_of,
    runs_of,
)
from machine_tool_calibration.model.fit import fit_models
from machine_tool_calibration.session.checks.suspicion import suspicions
from machine_tool_calibration.simulation import PRESETS, Simulated, SimulationSpec, simulate


def _setup(name: str, direction: list[float], start: list[float], kind: str = "diagonal") -> dict[str, object]:
    return {"id": name, "kind": kind, "direction": direction, "start": start}


@pytest.mark.parametrize(
    ("name", "order"),
    [
        ("ppp", "xyz"),
        ("ppp_yzx", "yzx"),
        ("ppp-ZXY", "zxy"),
        ("first_run", "xyz"),
        ("a_zyx", "zyx"),
        ("side_yz", "xyz"),
        ("a_xxy", "xyz"),
    ],
)
def test_order_of_moves_is_read_from_the_id(written, name, order):
    path = np.array([[0.0, 0, 0], [0, 0, 0], [0, 0, 0], [1, 1, 1]])
    setup = _setup(name, [1, 1, 1], [0, 0, 0])
    session = written([setup], [path], np.zeros_like, step=[0.01, 0.01, 0.01], blocks=2)
    (run,) = runs_of(session.description)
    assert run.order == order
    halts = halts_of(session.description.setups[0], session.description)
    assert halts.shape == (7, 3)
    assert np.flatnonzero(halts[1])[0] == "xyz".index(order[0])


def test_path_agrees_with_the_simulated_positions(exact):
    session = exact(orders=("xyz", "yzx", "zxy")).session
    for number, setup in enumerate(session.description.setups):
        mine = session.readings.setup == number
        halts = halts_of(setup, session.description)
        assert session.readings.position()[mine] == pytest.approx(halts, abs=1e-12)


def test_block_positions_of_a_shifted_volume(exact):
    session = exact(corner=(-0.1, 0.2, 0.0), step=(0.02, 0.01, 0.03), blocks=5).session
    x, y, z = block_positions(session.description, session.readings)
    assert x == pytest.approx(-0.1 + 0.02 * np.arange(6))
    assert y == pytest.approx(0.2 + 0.01 * np.arange(6))
    assert z == pytest.approx(0.03 * np.arange(6))


def test_a_place_at_zero_is_one_without_a_sign():
    """Whose name is EXX(0), wherever it was counted from."""
    found = _distinct(np.array([0.02, -0.0, -1e-13, 0.01, 1e-13]))
    assert [f"{x:g}" for x in found] == ["0", "0.01", "0.02"]


def test_unequal_steps_are_taken_from_the_commanded_positions(written):
    places = np.array([0.0, 0.008, 0.021, 0.03])
    path = places[:, None] * [1.0, 0.0, 0.0]
    session = written([_setup("X", [1, 0, 0], [0, 0, 0], "linear")], [path], np.zeros_like, step=[0.01] * 3, blocks=3)
    assert block_positions(session.description, session.readings)[0] == pytest.approx(places)


def test_directions_across_a_beam():
    for beam in ([1.0, 1.0, 1.0], [-1.0, 1.0, 0.0], [0.0, 0.0, 1.0]):
        unit = np.array(beam) / np.linalg.norm(beam)
        first, second = across(unit)
        frame = np.array([unit, first, second])
        assert frame @ frame.T == pytest.approx(np.eye(3), abs=1e-12)
        assert np.linalg.det(frame) == pytest.approx(1.0)


@pytest.mark.parametrize(
    ("setup", "message"),
    [
        (_setup("X", [1, 1, 0], [0, 0, 0], "linear"), "setup 'X': a linear run moves one axis"),
        (_setup("ppp", [1, 0, 0], [0, 0, 0]), "setup 'ppp': a diagonal moves two or three axes"),
    ],
)
def test_setups_that_cannot_be(written, setup, message):
    session = written([setup], [np.array([[0.0, 0, 0], [0.1, 0.1, 0.1]])], np.zeros_like, step=[0.01] * 3, blocks=2)
    with pytest.raises(SessionError, match=message):
        runs_of(session.description)


def test_blocks_are_where_they_were_commanded_to_be_if_not_where_they_are_stated():
    from machine_tool_calibration.simulation import DiagonalPlan, SimulationSpec, simulate

    session = simulate(SimulationSpec(plan=DiagonalPlan(repeats=1, blocks=5, corner=(0.0, 0.1, -0.03)))).session
    stated = [corner + 0.012 * np.arange(6) for corner in (0.0, 0.1, -0.03)]

    def moved(shift):
        x = session.readings.columns["x"]
        readings = replace(session.readings, columns={**session.readings.columns, "x": x + shift(x)})
        return block_positions(session.description, readings)

    for shift in (lambda x: 0.0, lambda x: 1e-6 * (np.arange(len(x)) % 2), lambda x: 1e-3 * np.arange(len(x)) / len(x)):
        # Each reading somewhere else, or next to where it is stated: no steps of their own.
        for found, expected in zip(moved(shift), stated, strict=True):
            assert found == pytest.approx(expected)
    unequal = moved(lambda x: 0.2 * x)
    assert unequal[0] == pytest.approx(1.2 * stated[0]) and unequal[1] == pytest.approx(stated[1])


def test_diagonals_by_iso_230_6_are_those_of_the_machine(exact: Callable[..., Simulated]) -> None:
    simulated = exact(position=1e-6, squareness=3e-5, repeats=2)
    found = identify(simulated.session).error_map.content["iso230_6"]
    (test,) = found["tests"]
    assert (test["measured"], test["of"]) == (3, 4)
    assert np.isnan(test["E_D"]) and np.isnan(test["B_D"])  # the runs went one way
    extents = []
    for run, sign in zip(found["runs"], ([1, 1, 1], [-1, 1, 1], [1, -1, 1]), strict=True):
        assert run["axis"] == "".join("N P"[part + 1] for part in sign)
        assert (len(run["runs_up"]), len(run["runs_down"])) == (2, 0)
        path = np.linspace(0.0, 0.12, 13)[:, None] * sign + 0.06 * (1 - np.array(sign))
        along = simulated.truth.machine.position_error(path) @ sign / np.sqrt(3.0)
        np.testing.assert_allclose(run["mean_up"], along - along[0], atol=3e-8)
        extents.append(np.ptp(along))
    assert test["E_D_up"] == pytest.approx(max(extents), abs=3e-8)


@pytest.mark.parametrize(("blocks", "finer"), [(39, 1), (30, 3)])
def test_a_run_of_which_most_places_were_never_read_is_suspicious(blocks: int, finer: int) -> None:
    session = simulate(SimulationSpec(plan=PRESETS["step_diagonal"], seed=3)).session
    assert suspicions([session]) == []
    description = session.description
    stated = {"blocks": blocks, "step": [step / finer for step in description.step]}
    found = suspicions([replace(session, description=description.model_copy(update=stated))])
    assert len(found) == 1 and f"runs of {blocks} blocks" in found[0]


NANOMETRE = 1e-9


def test_a_tilt_of_1_mrad_ruins_the_conventional_formulation_only(exact, worst):
    left = {name: [] for name in ("conventional", "new", "least_squares")}
    for seed in range(5):
        simulated = exact(seed)
        for name, values in left.items():
            values.append(worst(simulated, identify_by_formulation(simulated.session, name)))
    assert np.median(left["conventional"]) > 50e-6
    assert max(left["conventional"]) < 400e-6
    assert max(left["new"]) < 5 * NANOMETRE
    assert max(left["least_squares"]) < 3 * NANOMETRE


def test_without_a_tilt_the_conventional_formulation_is_right_to_the_nominal_beam(exact, worst):
    simulated = exact(3, tilt=0.0)
    assert worst(simulated, identify_by_formulation(simulated.session, "conventional")) < 50e-6
    assert worst(simulated, identify_by_formulation(simulated.session, "new")) < NANOMETRE


@pytest.mark.parametrize("model", ["small_angles", "translations"])
@pytest.mark.parametrize(
    "plan",
    [
        {"step": (0.03, 0.01, 0.02), "corner": (-0.1, 0.2, -0.3), "blocks": 8},
        {"diagonals": ("ppn", "npp", "nnn")},
        {"diagonals": ("ppp", "npp", "pnp", "ppn")},
        {"orders": ("xyz", "yzx", "zxy")},
        {"missing": 0.08, "repeats": 2},
    ],
)
def test_other_plans(exact, worst, plan, model):
    simulated = exact(5, **plan)
    fitted = build(simulated.session, model)
    assert worst(simulated, fitted.profiles(fit_models([fitted]).fits[0])) < 5 * NANOMETRE


def test_squareness_alone_is_exact_even_with_a_large_tilt(exact, worst):
    simulated = exact(2, position=0.0, squareness=1e-4, tilt=5e-3)
    model = build(simulated.session, "translations")
    fit = fit_models([model]).fits[0]
    assert worst(simulated, model.profiles(fit)) < 1e-3 * NANOMETRE
    assert np.abs(fit.residuals).max() < 1e-3 * NANOMETRE


def test_second_order_is_what_the_first_order_reading_leaves_out(exact):
    simulated = exact(4, position=3e-5, squareness=1e-4, tilt=5e-3)
    model = build(simulated.session, "translations")
    machine, observations, setup = simulated.truth.machine, model.observations, model.observations.readings.setup
    start = np.array([run.start for run in model.runs])
    motion = np.array([run.motion for run in model.runs])
    at_start = machine.position_error(start)
    error = machine.position_error(observations.position) - at_start[setup]
    end_error = machine.position_error(start + motion) - at_start
    actual = motion + end_error
    beam = actual / np.linalg.norm(actual, axis=1)[:, None]
    tilt = np.array([0.003, -0.004, 0.002])
    normal = beam + tilt
    g = normal / np.einsum("rj,rj->r", normal, beam)[:, None]
    nominal = np.array([run.beam for run in model.runs])
    t = g - np.einsum("rj,rj->r", g, nominal)[:, None] * nominal
    displacement = observations.position - start[setup]
    exactly = np.einsum("nj,nj->n", g[setup], displacement + error)
    first = np.einsum("nj,nj->n", nominal[setup], displacement + error) + np.einsum("nj,nj->n", t[setup], displacement)
    diagonal = np.array([run.diagonal for run in model.runs])[setup]
    left = exactly - first - second_order(model.runs, setup, displacement, error, end_error, t)
    assert np.abs(exactly - first)[diagonal].max() > 100 * NANOMETRE
    assert np.abs(left)[diagonal].max() < 1e-4 * NANOMETRE
