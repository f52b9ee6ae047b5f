# SPDX-License-Identifier: Apache-2.0
"""The model and its map: datum, figures, what is not determined, effects, bad input.
Angular errors: columns against exact geometry, what the orders of the moves determine, the paper's conclusion.
"""

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from papers.study_step_diagonal import paper_angular_uncertainty

from machine_tool_calibration.errors import ModelError, SessionError
from machine_tool_calibration.machine.chain import Chain
from machine_tool_calibration.methods.build import build_model, error_map
from machine_tool_calibration.methods.identify import identify
from machine_tool_calibration.methods.step_diagonal.build import build
from machine_tool_calibration.methods.step_diagonal.profiles import eq17
from machine_tool_calibration.methods.step_diagonal.spec import SPEC
from machine_tool_calibration.model.fit import fit_models
from machine_tool_calibration.model.model import Parameter, Term
from machine_tool_calibration.model.rigid_body import MachineTable
from machine_tool_calibration.session.checks import check_session
from machine_tool_calibration.session.folder import read_session
from machine_tool_calibration.simulation import FlawSpec, Simulated, TableSpec

EXAMPLE = Path(__file__).parents[2] / "data" / "step_diagonal"


@pytest.mark.long
def test_example_session():
    result = identify(read_session(EXAMPLE))
    document = json.loads(json.dumps(result.document(), allow_nan=False))
    content = document["error_map"]
    for letter in "xyz":
        assert np.shape(content[letter]) == (13, 3) == np.shape(content[f"{letter}_u"])
    assert document["model"] == "small_angles" == next(iter(SPEC.models))
    assert 0.7 < document["reduced_chi_square"] < 1.4
    assert set(content["squareness"]) == {"C0Y", "C0Y_u", "B0Z", "B0Z_u", "A0Z", "A0Z_u"}
    assert {p["name"] for p in document["parameters"]} >= {"ppp.tilt_1", "pnp.tilt_2", "EXX(0.01)", "C0Y", "X.offset_1"}
    assert {entry["name"] for entry in document["not_determined"]} == {f"E{c}{a}" for c in "ABC" for a in "XYZ"}


@pytest.mark.long
def test_map_is_in_the_coordinate_system_of_eq_17(exact):
    result = identify(exact(1, noise=1.0, repeats=2).session)
    content = result.error_map.content
    for letter in "xyz":
        assert content[letter][0] == pytest.approx(np.zeros(3), abs=1e-15)
        assert content[f"{letter}_u"][0] == pytest.approx(np.zeros(3), abs=1e-12)
    ends = [content["x"][-1, 1], content["x"][-1, 2], content["z"][-1, 1]]
    assert ends == pytest.approx(np.zeros(3), abs=1e-15)
    assert result.error_map.points.shape == (39, 3)
    assert result.error_map.error[13:26] == pytest.approx(content["y"])
    covariance = result.error_map.covariance
    assert np.sqrt(np.einsum("nii->ni", covariance)) == pytest.approx(result.error_map.uncertainty, rel=1e-6, abs=1e-15)


def test_squareness_and_straightness_do_not_depend_on_the_datum(exact, truth):
    simulated = exact(6)
    result = identify(simulated.session, model="translations")
    error = {letter: np.array(simulated.truth.expected["axis_errors"][letter]) for letter in "xyz"}
    at = 0.01 * np.arange(13)

    def slope(letter, component):
        return np.polyfit(at, error[letter][:, component], 1)[0]

    squareness = result.error_map.content["squareness"]
    assert squareness["C0Y"] == pytest.approx(-slope("x", 1) - slope("y", 0), abs=2e-8)
    assert squareness["B0Z"] == pytest.approx(slope("x", 2) + slope("z", 0), abs=2e-8)
    assert squareness["A0Z"] == pytest.approx(-slope("y", 2) - slope("z", 1), abs=2e-8)
    straightness = result.error_map.content["straightness"]
    bent = error["y"][:, 2] - np.polyval(np.polyfit(at, error["y"][:, 2], 1), at)
    assert straightness["EZY"] == pytest.approx(np.ptp(bent), abs=3e-9)
    assert result.error_map.content["positioning"]["EXX"] == pytest.approx(error["x"][-1, 0], abs=3e-9)


def test_tilts_are_those_of_the_mirrors(exact):
    simulated = exact(7)
    result = identify(simulated.session, model="translations")
    found = {p.name: p.value for p in result.parameters if "tilt" in p.name}
    size = [np.hypot(found[f"{run}.tilt_1"], found[f"{run}.tilt_2"]) for run in ("ppp", "npp", "pnp")]
    assert size == pytest.approx([1e-3] * 3, rel=0.05)  # the beam itself lies off the nominal diagonal


@pytest.mark.long
def test_aligned_mirror_shows_the_missing_tilt_and_the_effect_mends_it(exact):
    session = exact(7, noise=1.0, repeats=2).session
    lacking = identify(session, model="aligned_mirror")
    assert lacking.fit.joint.reduced_chi_square > 100
    mended = identify(session, model="aligned_mirror", effects=["mirror_misalignment"])
    assert mended.fit.joint.reduced_chi_square < 1.4


@pytest.mark.long
@pytest.mark.parametrize("model", ["small_angles", "translations"])
@pytest.mark.parametrize(
    ("lost", "determined", "squareness"),
    [
        (("Z",), ["xx", "xy", "xz", "yy", "zy"], []),
        (("pnp",), ["xx", "yy", "yz", "zy", "zz"], ["A0Z"]),
        (("X", "Y", "Z"), ["xy", "xz", "zy"], []),
        (("ppp", "npp", "pnp"), ["xx", "yy", "zz"], []),
    ],
)
def test_what_missing_runs_leave_open(exact, worst, without, model, lost, determined, squareness):
    simulated = exact(8, repeats=2)
    result = identify(without(simulated.session, *lost), model=model)
    content = result.error_map.content
    found = [
        axis + component
        for axis in "xyz"
        for j, component in enumerate("xyz")
        if np.isfinite(content[axis][:, j]).all()
    ]
    assert found == determined
    assert [name for name in ("C0Y", "B0Z", "A0Z") if np.isfinite(content["squareness"][name])] == squareness
    assert worst(simulated, result.fit.model.profiles(result.fit)) < 3e-9
    gaps = {entry.name: entry.why for entry in result.error_map.not_determined}
    assert len(gaps) == 9 - len(determined)
    if lost == ("Z",):
        assert gaps["error_map.z: ez"] == "the measured runs do not determine it (no linear run of Z)"
        assert np.isfinite(content["straightness"]["EXZ"])  # its slope is open, its shape is not
    if lost == ("pnp",):
        assert "2 of 3 diagonals" in gaps["error_map.x: ey"]
    json.dumps(result.document(), allow_nan=False)


def test_readings_that_stop_early_leave_gaps_only_there(exact):
    session = exact(9).session
    keep = ~((session.readings.position()[:, 0] > 0.105) & (session.readings.setup == session.setup_ids.index("X")))
    reached = np.flatnonzero(session.readings.setup == 0)[:32]
    keep &= (session.readings.setup != 0) | np.isin(np.arange(len(keep)), reached)
    result = identify(session.with_readings(session.readings.select(keep)), model="translations")
    assert np.isfinite(result.error_map.content["y"]).any()
    json.dumps(result.document(), allow_nan=False)


def test_a_lost_last_reading_of_a_diagonal_leaves_a_gap_only_there(exact, truth):
    simulated = exact(9, repeats=2)
    position, setup = simulated.session.readings.position(), simulated.session.readings.setup
    last = (setup == simulated.session.setup_ids.index("ppp")) & (position[:, 2] > 0.1199)
    assert last.sum() == 2
    result = identify(simulated.session.without(last), model="translations")
    gaps = {axis: ~np.isfinite(result.error_map.content[axis]) for axis in "xyz"}
    assert not gaps["x"].any() and not gaps["y"].any()
    assert np.argwhere(gaps["z"]).tolist() == [[12, 0], [12, 1]]
    assert np.isfinite([result.error_map.content["squareness"][name] for name in ("C0Y", "B0Z", "A0Z")]).all()
    profiles = result.fit.model.profiles(result.fit)
    assert result.error_map.content["datum"].endswith("; here e_y(z) is zero at 110 mm")
    expected = eq17(profiles.blocks, truth(simulated, profiles.blocks), (-1, -1, -2))
    assert np.nanmax(np.abs(np.concatenate([e.ravel() for e in profiles.error]) - expected)) < 3e-9
    names = {parameter.name for parameter in result.fit.model.parameters}
    assert names & {entry.name for entry in result.not_determined} == {"EXZ(0.12)", "EYZ(0.12)"}


@pytest.mark.long
def test_dead_path_shows_and_the_effect_mends_it(exact):
    simulated = exact(10, noise=1.0, repeats=2, angular=2e-6, effects=[FlawSpec(id="dead_path", amplitude=4e-6)])
    before = identify(simulated.session)
    after = identify(simulated.session, effects=["dead_path"])
    assert before.fit.joint.p_value < 1e-6
    assert after.fit.joint.p_value > 1e-3


@pytest.mark.long
def test_the_size_of_the_angles_is_estimated_again_when_a_term_is_added(exact):
    nodes = tuple(0.01 * k for k in range(13))
    bow = TableSpec(nodes=nodes, values=tuple(4e-4 * x * (0.12 - x) / 0.06 for x in nodes))
    model = build(exact(10, noise=1.0, orders=("xyz", "yzx", "zxy"), motions={"EAX": bow}).session)
    known = next(term for term in model.spread.terms if term.name == "angle.EAX")
    names = tuple(Parameter(f"EAX({x:g})", "rad") for x in nodes[1:])
    mended = model.with_terms([Term("EAX", names, known.columns[1:])]).reestimated()
    assert model.spread.size > 5e-6
    assert mended.spread.size < 3e-6
    assert model.with_terms([]).spread.size == model.spread.size


def test_observations_tell_effects_what_the_mirror_does(exact):
    observations = build(exact(1).session, "translations").observations
    assert observations.rotation_direction.shape == (len(observations), 3)
    assert np.einsum("nj,nj->n", observations.rotation_direction, observations.direction) == pytest.approx(0, abs=1e-15)
    assert observations.path.min() == pytest.approx(0.0, abs=1e-15)
    assert observations.path.max() == pytest.approx(0.12 * np.sqrt(3))
    assert len(np.unique(observations.run)) == 6


def test_bad_requests(exact, without):
    session = exact(1).session
    with pytest.raises(ModelError, match="step_diagonal has no model 'best'; known are small_angles"):
        build_model(session, "best")
    with pytest.raises(ModelError, match="no reading to identify from"):
        build(without(session, *session.setup_ids))
    with pytest.raises(ModelError, match="too few readings"):
        fit_models([build(without(session, "npp", "pnp", "X", "Y", "Z"))])


def test_an_axis_that_the_chain_lacks(written):
    path = np.array([[0.0, 0, 0], [0.01, 0, 0], [0.02, 0, 0]])
    setup = {"id": "X", "kind": "linear", "direction": [1, 0, 0], "start": [0, 0, 0]}
    session = written([setup], [path], np.zeros_like, step=[0.01] * 3, blocks=2, chain="w-Y-b-Z-t")
    with pytest.raises(ModelError, match="the runs move x, which the chain w-Y-b-Z-t does not have"):
        build(session)


def test_a_place_between_the_halts_of_its_run_is_refused(exact: Callable[..., Simulated]) -> None:
    """Half a step off along X, read as it is there: within the run's ends, and not on its way."""
    session = exact().session
    columns, displacement = dict(session.readings.columns), session.readings.displacement.copy()
    columns["x"] = columns["x"].copy()
    columns["x"][7] += 0.5 * 0.01
    displacement[7] += 0.5 * 0.01 / np.sqrt(3.0)
    moved = replace(session.readings, columns=columns, displacement=displacement)
    check_session(session)
    with pytest.raises(SessionError, match="the place"):
        check_session(session.with_readings(moved))


ORDERS = ("xyz", "yzx", "zxy")
NODES = tuple(0.01 * k for k in range(13))
NINE = tuple(f"E{turn}{axis}" for axis in "XYZ" for turn in "ABC")
FIVE = ("EAX", "ECX", "EAZ", "EBZ", "ECZ")


def _table(seed: int, size: float = 1e-6) -> TableSpec:
    walk = np.random.default_rng(seed).normal(size=13).cumsum()
    walk -= walk[0]
    return TableSpec(nodes=NODES, values=tuple(size * walk / np.abs(walk).max()), interpolation="linear")


@pytest.mark.parametrize("chain", ["w-Y-X-b-Z-t", "w-X-Y-b-Z-t", "w-Y-b-X-Z-t"])
@pytest.mark.parametrize("name", NINE)
def test_columns_are_what_exact_geometry_reads(exact, name, chain):
    table = _table(7)
    corner = (0.02, 0.01, 0.03)
    nodes = np.array(NODES) + corner["XYZ".index(name[2])]
    motions = {name: TableSpec(nodes=tuple(nodes), values=table.values, interpolation="linear")}
    session = exact(
        1, motions=motions, position=0.0, squareness=0.0, tilt=0.0, orders=ORDERS, corner=corner, chain=chain
    ).session
    model = build(session, "translations")
    angle = MachineTable(Chain.parse(chain), name, nodes).term(model.observations)
    expected = np.array(table.values) @ angle.columns
    left = session.readings.displacement - model.observations.path - expected
    assert np.abs(expected).max() > 1e-9
    for run in np.unique(model.observations.run):
        mine = model.observations.run == run
        # The laser lies on the actual diagonal, and the mirror across it: a small tilt against the nominal ones.
        moved = model.observations.position[mine] - model.observations.position[mine][0]
        known = np.column_stack([np.ones(mine.sum()), moved])
        assert left[mine] - known @ np.linalg.lstsq(known, left[mine])[0] == pytest.approx(0.0, abs=2e-11)


def test_five_of_nine_are_told_by_the_orders(exact):
    model = build(exact(1, orders=ORDERS).session, "angular_one_mirror")
    assert sorted(table.name for table in model.angles) == sorted(FIVE)
    left = {entry.name for entry in model.left_out}
    assert left == set(NINE) - set(FIVE)


def test_the_five_are_recovered_exactly_where_the_mirror_was_not_touched(exact, worst):
    motions = {name: _table(k) for k, name in enumerate(FIVE)}
    simulated = exact(2, motions=motions, tilt=0.0, orders=ORDERS)
    result = identify(simulated.session, model="angular_one_mirror")
    for name, table in motions.items():
        found = result.error_map.content[f"{name[2].lower()}_angular"][:, "ABC".index(name[1])]
        assert found == pytest.approx(np.array(table.values), abs=2e-9)
    assert worst(simulated, result.fit.model.profiles(result.fit)) < 1e-9


def test_a_mirror_set_anew_leaves_three_slopes_open_and_says_so(exact):
    simulated = exact(3, orders=ORDERS, noise=1.0)
    model = build(simulated.session, "angular")
    (slopes,) = (entry.name for entry in model.left_out if "slopes" in entry.name)
    count, _, names = slopes.partition(" slopes of ")
    assert count == "3" and sorted(names.split(", ")) == sorted(FIVE)
    fit = fit_models([model]).fits[0]
    assert fit.undetermined.shape[1] == 0
    assert np.isfinite(error_map(fit).error).all()


def test_one_mirror_is_refuted_by_chi_square_where_it_was_touched(exact):
    result = identify(exact(3, orders=ORDERS, noise=1.0).session, model="angular_one_mirror")
    assert result.fit.joint.reduced_chi_square > 100


def test_the_others_are_not_determined_and_null(exact):
    content = identify(exact(1, orders=ORDERS, noise=1.0).session, model="angular").error_map.content
    assert np.isnan(content["y_angular"]).all()
    assert np.isnan(content["x_angular"][:, 1]).all()
    assert np.isfinite(content["x_angular_u"][:, [0, 2]]).all()


def test_one_order_is_not_enough(exact):
    with pytest.raises(ModelError, match=r"several orders of the moves.*this session has xyz$"):
        build(exact(1).session, "angular")


def test_the_papers_conclusion_comes_out_as_a_number():
    paper = paper_angular_uncertainty(0.01, 1e-7, 12)
    assert paper.worst == pytest.approx(3.46e-5, rel=1e-2)
    assert paper.accumulated == pytest.approx(4.2e-4, rel=2e-2)
    assert paper.standard == pytest.approx(paper.worst / 2)


def test_least_squares_over_all_orders_is_better_but_the_conclusion_stands(exact, reproducible):
    """0.1 um per block is 0.07 um per reading; Eq. (29) takes four of 27 displacements a block."""
    session = exact(1, orders=ORDERS, noise=1.0).session
    model = build(session, "angular_one_mirror")
    fit = fit_models([model]).fits[0]
    names = [p.name for p in model.parameters]
    for table in model.angles:
        at = [names.index(label) for label in table.labels]
        # That of the declared uncertainty: the mirror was in fact set anew for each order.
        own = fit.places[at]
        covariance = fit.solution.covariance[np.ix_(own, own)] / 2.0
        change = np.diff(np.eye(13), axis=0)
        standard = np.sqrt(np.diag(change @ covariance @ change.T))
        assert standard.max() < paper_angular_uncertainty(0.01, 1e-7, 12).standard
        assert standard.max() > 5e-6
        assert np.sqrt(covariance[-1, -1]) > 1.5e-5


def test_of_one_axis_alone_no_turn_about_it_is_known():
    micrometres = [[0.0, 0.0, 0.0], [1.0, 2.0, -1.0], [5.0, 6.0, -3.0], [0.0, 0.0, 0.0], [0.0, 0.0, 0.0]]
    of_x = eq17([np.array([0.0, 0.1, 0.3]), np.zeros(1), np.zeros(1)], np.ravel(micrometres))
    assert of_x.reshape(-1, 3)[:3] == pytest.approx(np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [5.0, 0.0, 0.0]]))
    assert not of_x[9:].any()
