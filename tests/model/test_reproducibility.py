# SPDX-License-Identifier: Apache-2.0
"""What belongs together of what does not reproduce.
Error motions as tables: against a machine of rigid bodies with real rotations, and their datum.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tests import plates

import machine_tool_calibration as mtcal
from machine_tool_calibration.machine.chain import Chain
from machine_tool_calibration.methods.build import build_model
from machine_tool_calibration.methods.fitted import FitRequest, fit_sessions
from machine_tool_calibration.methods.identify import identify
from machine_tool_calibration.model.fit import fit_models
from machine_tool_calibration.model.reproducibility import (
    DRIFT,
    PureError,
    _ways_round,
    offsets_apart,
    reproducibility,
    with_drift,
)
from machine_tool_calibration.model.rigid_body import (
    MachineTable,
    axis_nodes,
    determined_part,
    distinct_nodes,
    in_space,
    linear_axis_errors,
    map_field,
    position_errors,
    read_nodes,
    table_datum,
    tables_content,
    thinned,
)
from machine_tool_calibration.session.folder import read_session
from machine_tool_calibration.simulation import PRESETS, MachineSpec, SimulationSpec, simulate
from machine_tool_calibration.simulation.machine_file import build_machine

HEAD = """format: mtcal-session/1
method: direct
machine: {chain: w-X-b-t, travel: {x: [0.0, 0.5]}}
repeats: 2
standard_uncertainty: {displacement: 1.0e-06}
datum: offset
terms: [EXX]
setups:
- {id: A}
"""


def test_the_way_back_to_the_beginning_of_the_next_repeat_is_no_pass(tmp_path: Path) -> None:
    places = np.linspace(0.0, 0.5, 6)
    there_and_back = [*places, *places[::-1]]
    rows = [(k, x) for k, run in enumerate((there_and_back, there_and_back[6:] + there_and_back[:6])) for x in run]
    lines = ["setup,repeat,x,gx,gy,gz,displacement"]
    lines += [f"A,{k},{x:.2f},1,0,0,{1e-6 * j:.9f}" for j, (k, x) in enumerate(rows)]
    (tmp_path / "session.yaml").write_text(HEAD, encoding="utf-8")
    (tmp_path / "observations.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
    (family,) = reproducibility(build_model(read_session(tmp_path))[0].observations)
    assert family.name == "pass"
    assert family.group.tolist() == np.repeat(np.arange(4), 6).tolist()


@pytest.mark.parametrize("both_ways", [True, False])
def test_runs_over_an_axis_that_begin_elsewhere_hide_no_reversal(tmp_path: Path, both_ways: bool) -> None:
    """Both passes of a run are off by the same: what lies between them is the same in every run."""
    rng = np.random.default_rng(3)
    places = np.linspace(0.0, 0.5, 9)
    lines = ["setup,repeat,x,dir_x,gx,gy,gz,displacement"]
    for run, offset in enumerate(rng.normal(scale=2e-6, size=6)):
        for way in (1, -1)[: 1 + both_ways]:
            read = offset - 1e-6 * way + 1e-6 * rng.normal(size=9)
            lines += [f"A,{run},{x:.4f},{way},1,0,0,{value:.9f}" for x, value in zip(places[::way], read, strict=True)]
    (tmp_path / "session.yaml").write_text(HEAD.replace("repeats: 2", "repeats: 6"), encoding="utf-8")
    (tmp_path / "observations.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
    session = read_session(tmp_path)
    families = reproducibility(build_model(session)[0].observations)
    assert [family.name for family in families] == ["run", "pass"][: 1 + both_ways]
    if both_ways:
        assert mtcal.identify(session).diagnose().effects == ("backlash_x",)


def test_of_very_many_passes_those_of_one_direction_are_held_together() -> None:
    """250 cycles of which every pass has an offset of its own: these, not the noise, say how sure a backlash is."""
    rng = np.random.default_rng(5)
    cycles, places = 250, np.linspace(0.0, 0.4, 6)
    way = np.tile(np.repeat([1.0, -1.0], 6), cycles)
    x = np.tile(np.r_[places, places[::-1]], cycles)
    read = np.repeat(rng.normal(scale=1e-6, size=2 * cycles), 6) + 2e-7 * rng.normal(size=len(x))
    columns = {"time": 5.0 * np.arange(len(x)), "x": x, "dir_x": way, "displacement": read}
    measured = plates.session(columns, 2e-7, terms=["EXX"], repeat=np.repeat(np.arange(cycles), 12))
    fit = fit_sessions(FitRequest((measured,), effects=("backlash_x",))).joint.fits[0]
    families = {family.name: family for family in reproducibility(fit.model.observations)}
    assert families["pass"].count < 2 * cycles
    for group in range(families["pass"].count):
        assert len(set(way[families["pass"].group == group])) == 1
    place = [p.name for p in fit.model.parameters].index("backlash_x.b")
    # Half the difference of the directions' means, each of 250 offsets.
    expected = 1e-6 / np.sqrt(2.0 * cycles)
    assert np.sqrt(fit.covariance[place, place]) == pytest.approx(expected, rel=0.25)


def test_a_way_round_a_circle_ends_where_it_turns_and_with_its_run() -> None:
    """There, twice the last reading, and back; the next run goes the same way as the one before it ended."""
    angle = np.r_[np.linspace(0.0, 3.0, 7), np.linspace(3.0, 0.0, 6), np.linspace(2.9, 0.1, 5)]
    direction = np.column_stack([np.cos(angle), np.sin(angle), 0.0 * angle])
    found = _ways_round(direction, np.repeat([0, 1], [13, 5]))
    assert found.tolist() == [0] * 7 + [1] * 6 + [2] * 5


@pytest.mark.parametrize(("between", "within"), [(10.0, 4.0), (0.0, 4.0)])
def test_setups_that_differ_are_no_better_known_by_repeats(between: float, within: float) -> None:
    """Six setups read the same five places ten times each: repeats say nothing of what the setups differ by."""
    found, true = [], np.sqrt(between**2 / 6 + within**2 / 60 + 2.0**2 / 300)
    for seed in range(6):
        rng = np.random.default_rng(seed)
        setup, repeat, place = (a.ravel() for a in np.meshgrid(range(6), range(10), range(5), indexing="ij"))
        read = between * rng.normal(size=6)[setup] + within * rng.normal(size=(6, 10))[setup, repeat]
        columns = {"x": 0.05 * place, "gz": 1.0, "displacement": 1e-6 * (read + 2.0 * rng.normal(size=300))}
        names = [f"lot{k}" for k in range(6)]
        measured = plates.session(columns, 3e-6, "none", ["EZX"], repeat, *names, setup=setup.tolist())
        found.append(1e6 * identify(measured).error_map.uncertainty[:, 2].mean())
    assert np.mean(found) == pytest.approx(true, rel=0.4)  # slopes of runs are possible, too


@pytest.mark.parametrize(("runs", "told"), [(1, False), (2, True), (3, True), (5, True)])
def test_how_runs_over_a_plane_differ_is_told_by_several_that_read_the_same_places(
    tmp_path: Path, runs: int, told: bool
) -> None:
    """One run alone shows no difference: its slope and its bow in time are the machine's, or noise."""
    rng = np.random.default_rng(4)
    places = np.array([(x, y) for x in np.linspace(0.0, 0.5, 6) for y in np.linspace(0.0, 0.4, 5)])
    lines = ["time,setup,repeat,x,y,gx,gy,gz,displacement"]
    for run in range(runs):
        slow = 5e-6 * np.outer(rng.normal(size=2), np.linspace(-1.0, 1.0, 30)).sum(axis=0)
        for k, (x, y) in enumerate(places):
            value = slow[k] + 1e-6 * rng.normal()
            lines.append(f"{1e4 * run + 10.0 * k},A,{run},{x:.2f},{y:.2f},0,0,1,{value:.9f}")
    plane = HEAD.replace("w-X-b-t, travel: {x: [0.0, 0.5]}", "w-X-Y-b-t, travel: {x: [0.0, 0.5], y: [0.0, 0.4]}")
    plane = plane.replace("repeats: 2", f"repeats: {runs}").replace("[EXX]", "[EZX]")
    (tmp_path / "session.yaml").write_text(plane, encoding="utf-8")
    (tmp_path / "observations.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
    session = read_session(tmp_path)
    assert ("run" in [f.name for f in reproducibility(build_model(session)[0].observations)]) == told
    assert bool(identify(session).document()["spread"]) == told


def test_offsets_that_show_have_a_size_of_their_own() -> None:
    family = np.array([0, 0, 0, 0, 1, 1, 1, 1, 2])
    offset = np.array([1, 0, 1, 0, 1, 0, 1, 0, 1], dtype=bool)
    seen = np.array([0, 1, 0, 1, 0, 1, 1, 1, 1], dtype=bool)
    # The first family's are the model's; the last one has nothing else.
    found, was = offsets_apart(family, offset, seen)
    assert found.tolist() == [0, 0, 0, 0, 3, 1, 3, 1, 2]
    assert was.tolist() == [0, 1, 2, 1]


def test_what_many_runs_share_is_a_drift_and_no_spread_of_theirs() -> None:
    """Runs of a step diagonal, through which everything warms up: its map is as far off as that of least squares."""
    session = simulate(SimulationSpec(plan=PRESETS["step_diagonal"], seed=5)).session
    model = build_model(session)[0]
    assert [family.name for family in with_drift(model.observations)] == ["run", DRIFT]
    # Four mountings do not tell a drift from slopes of their own, nor does what is read directly.
    for plan in ("tracking_2d", "probing_cross", "iso230_2"):
        few = build_model(simulate(SimulationSpec(plan=PRESETS[plan], seed=5)).session)[0]
        assert DRIFT not in [family.name for family in with_drift(few.observations)]
    time = session.readings.columns["time"]
    warming = 100.0 * session.sigma * (1.0 - np.exp(-time / 1500.0)) * model.observations.direction[:, 2]
    readings = replace(session.readings, displacement=session.readings.displacement + warming)
    (runs,) = fit_models([build_model(session.with_readings(readings))[0]]).marginal.sizes
    assert runs.name == "run"
    assert runs.size < 0.3 * session.sigma


@pytest.mark.parametrize("size", [1e-6, 1.0, 1e6])
def test_pure_error_beside_what_the_model_has_is_that_of_least_squares(size: float) -> None:
    """Of three functions that the model has two are alike: they take up two degrees of freedom."""
    rng = np.random.default_rng(3)
    functions = rng.normal(size=(5, 40))
    functions[2] = 2.0 * functions[0]
    own, residual = np.array([True, False, True, True, False]), rng.normal(size=40)
    columns = size * np.vstack([functions, residual])
    found = PureError(columns @ columns.T, 40).outside(own, np.array([0, 1, 0, 0, 1]))
    basis = functions[own].T
    left = columns[[1, 4, 5]] - (basis @ np.linalg.lstsq(basis, columns[[1, 4, 5]].T, rcond=None)[0]).T
    expected = left @ left.T
    np.testing.assert_allclose(found.inner[np.ix_(~own, ~own)], expected[:2, :2], rtol=1e-9)
    np.testing.assert_allclose(found.data[~own], expected[:2, 2], rtol=1e-9)
    assert found.squares == pytest.approx(expected[2, 2], rel=1e-9)
    assert found.dof == 38 and not found.inner[own].any() and not found.data[own].any()


NODES = {"X": np.array([-0.1, 0.05, 0.3]), "Y": np.array([0.0, 0.2]), "Z": np.array([-0.05, 0.0, 0.02, 0.1])}
OFFSET = (0.07, -0.04, -0.2)


def tables(text: str) -> list[MachineTable]:
    return list(linear_axis_errors(replace(Chain.parse(text), tool_offset=OFFSET), NODES))


@pytest.mark.parametrize("chain", ["w-Y-X-b-Z-t", "w-C-b-Y-X-Z-t", "w-b-Z-X-Y-t"])
def test_errors_and_uncertainties_of_positions_are_those_of_rigid_bodies(chain: str) -> None:
    """To first order in errors of micrometres; what an axis has at its zero turns nothing."""
    rng = np.random.default_rng(3)
    every = tables(chain)
    assert len(every) == 21 and [t.is_rotation for t in every] == [False] * 9 + [True] * 12
    theta = np.concatenate([(1e-7 if t.is_rotation else 1e-6) * rng.normal(size=len(t.labels)) for t in every])
    motions, squareness, first = {}, {}, 0
    for table in every:
        values = theta[first : first + len(table.labels)]
        first += len(values)
        if table.is_squareness:
            squareness[table.name] = float(values[0])
        else:
            own = {"nodes": table.nodes.tolist(), "values": values.tolist(), "interpolation": "linear"}
            motions[table.name] = own
    content = {"chain": chain, "random": None, "tool_offset": OFFSET, "motions": motions, "squareness": squareness}
    travel = {axis: (float(nodes[0]), float(nodes[-1])) for axis, nodes in NODES.items()}
    machine = build_machine(MachineSpec.model_validate(content), travel=travel)
    point = np.column_stack([rng.uniform(nodes[0], nodes[-1], 40) for nodes in NODES.values()])
    field = map_field(every, point)
    root = rng.normal(size=(len(theta), len(theta))) * 1e-7
    error, covariance = position_errors(field, theta, root @ root.T)
    exact = machine.position_error(point)
    # The errors are counted from where all axes stand at zero, or from nowhere: a shift of everything.
    np.testing.assert_allclose(error - error[0], exact - exact[0], atol=1e-11)
    drawn = np.einsum("sk,knd->snd", rng.normal(size=(4000, len(theta))) @ root.T, field)
    np.testing.assert_allclose(np.einsum("nii->ni", covariance), drawn.var(axis=0), rtol=0.2)
    np.testing.assert_allclose(
        covariance[:, 0, 1], np.mean(drawn[:, :, 0] * drawn[:, :, 1], axis=0), atol=0.1 * covariance.max()
    )


def test_the_datum_is_zero_next_to_the_axiss_zero_and_no_slope() -> None:
    by_name = {t.name: t for t in tables("w-Y-X-b-Z-t")}
    zero, slope = table_datum([by_name["EYX"]])
    assert zero.weights == {"EYX(0.05)": 1.0}
    weights = np.array([slope.weights.get(f"EYX({x})", 0.0) for x in (-0.1, 0.05, 0.3)])
    assert weights @ np.ones(3) == pytest.approx(0.0)
    # A straight line through its middle is all that it sees.
    assert np.linalg.matrix_rank([weights, NODES["X"] - NODES["X"].mean()]) == 1
    assert [c.weights for c in table_datum([by_name["EXX"], by_name["C0Y"], by_name["EAZ"]])] == [
        {"EXX(0.05)": 1.0}, {"EAZ(0)": 1.0},
    ]  # fmt: skip
    # Of the nodes that the readings place.
    (first,) = table_datum([by_name["EYX"]], [np.array([False, False, True])])[:1]
    assert first.weights == {"EYX(0.05)": 1.0}
    placed = table_datum([by_name["EYX"]], [np.array([True, False, True])])
    assert placed[0].weights == {"EYX(-0.1)": 1.0} and placed[1].weights == {"EYX(-0.1)": -1.0, "EYX(0.3)": 1.0}


def test_nodes() -> None:
    assert axis_nodes(np.array([0.3, 0.1, 0.3 + 1e-12])).tolist() == [0.1, 0.3]
    assert axis_nodes(np.linspace(0.0, 1.0, 21)).tolist() == np.linspace(0.0, 1.0, 21).round(9).tolist()
    assert axis_nodes(np.linspace(-1.0, 1.0, 22)).tolist() == np.linspace(-1.0, 1.0, 21).tolist()
    assert distinct_nodes(np.array([0.0, 0.9999, 0.0005, 1.0, -0.0])).tolist() == [0.0, 0.9999]
    assert distinct_nodes(np.array([0.0, 0.5, 0.502, 1.0])).tolist() == [0.0, 0.5, 0.502, 1.0]
    assert thinned(np.array([0.0, 0.1, 0.4, 0.6, 0.9, 1.0]), 3).tolist() in ([0.0, 0.4, 1.0], [0.0, 0.6, 1.0])
    # Of places in pairs one each, and both ends.
    pairs = np.sort(np.concatenate([np.arange(0.0, 1.0, 0.1), np.arange(0.0, 1.0, 0.1) + 0.003]))
    apart = thinned(pairs, 19)
    assert len(apart) == 10 and apart[0] == 0.0 and apart[-1] == pairs[-1] and np.diff(apart).min() > 0.09


def test_a_node_that_no_reading_reaches_but_by_rounding_is_not_read() -> None:
    columns = np.array([[0.0, 0.0], [1e-12, 0.0], [1e-6, 0.0], [0.5, -1.0]])
    assert read_nodes(columns).tolist() == [False, False, True, True]
    assert not read_nodes(0.0 * columns).any()


def test_what_is_not_determined_is_no_number() -> None:
    error, covariance = np.arange(6.0).reshape(2, 3), np.tile(np.diag([4.0, 9.0, -1e-20]), (2, 1, 1))
    loose = np.array([[False, False, False], [True, False, False]])
    value, u, whole = determined_part(error, covariance, loose)
    np.testing.assert_array_equal(value, [[0.0, 1.0, 2.0], [np.nan, 4.0, 5.0]])
    np.testing.assert_array_equal(u, [[2.0, 3.0, 0.0], [np.nan, 3.0, 0.0]])
    assert np.isfinite(whole[0]).all() and np.isnan(whole[1]).all()
    np.testing.assert_array_equal(in_space(np.array([[1.0, 2.0]])), [[1.0, 2.0, np.nan]])
    flat = in_space(np.ones((1, 2, 2)))[0]
    assert np.isfinite(flat[:2, :2]).all() and np.isnan(flat).sum() == 5
    every = tables("w-Y-X-b-Z-t")[8:11]
    content = tables_content(every, np.arange(6.0), 0.5 * np.arange(6.0))
    assert list(content) == ["EZZ", "C0Y", "B0Z"]
    assert content["EZZ"]["value"].tolist() == [0, 1, 2, 3] and content["B0Z"] == {"value": 5.0, "value_u": 2.5}


def test_runs_with_slopes_of_their_own_are_known_no_better_without_times() -> None:
    """At the end of the axis runs differ by their slopes: what the mean of ten is uncertain by."""
    rng, x, found, true = np.random.default_rng(7), np.linspace(0.0, 0.4, 9), [], []
    for _ in range(6):
        slopes = 1e-5 * rng.normal(size=(10, 1))
        read = (slopes * (x - 0.2) + 1e-7 * rng.normal(size=(10, 9))).ravel()
        columns = {"x": np.tile(x, 10), "displacement": read}
        measured = plates.session(columns, 1e-7, "offset", ["EXX"], np.repeat(np.arange(10), 9))
        found.append(identify(measured).error_map.uncertainty[-1, 0])
        true.append(0.2 * slopes.std(ddof=1) / np.sqrt(10))
    assert np.mean(found) == pytest.approx(np.mean(true), rel=0.25)


@pytest.mark.parametrize(("each", "families"), [(1, []), (2, ["run"]), (5, ["run"])])
def test_runs_at_one_place_are_a_family_where_each_reads_it_more_than_once(each: int, families: list[str]) -> None:
    columns = {"x": 0.0, "y": 0.0, "z": 0.0, "displacement": np.zeros(6 * each)}
    session = plates.session(columns, 1e-6, "offset", [], np.repeat(np.arange(6), each), repeats=6)
    found = reproducibility(build_model(session)[0].observations)
    assert [family.name for family in found if family.count == 6] == families


@pytest.mark.parametrize("seed", [0, 5, 11])
def test_a_slope_that_all_runs_share_is_the_maps_and_not_theirs(seed: int) -> None:
    """Times that jitter leave a trace of it outside the model, on which falls what the first readings were off."""
    rng, place, repeat = np.random.default_rng(seed), np.tile(np.arange(40), 3), np.repeat(np.arange(3), 40)
    true = 1e-6 * (20.0 * np.sin(2.0 * np.pi * place / 40.0) + 0.25 * place)
    start = 30e-6 * np.exp(-place / 3.0) * (repeat == 0)
    columns = {"time": np.cumsum(10.0 + 0.5 * rng.normal(size=120)), "x": 0.009 * place, "dir_x": np.ones(120)}
    columns["displacement"] = true - start + 5e-7 * rng.normal(size=120)
    found = identify(plates.session(columns, 5e-7, "offset", ("EXX",), repeat)).error_map
    off = found.error[:, 0] - true[:40]
    assert np.std(off) < 3e-6 and found.uncertainty[:, 0].max() < 5e-6
