# SPDX-License-Identifier: Apache-2.0
"""Angular errors: columns against exact geometry, what the orders of the moves determine, the paper's conclusion."""

import numpy as np
import pytest
from papers.study_step_diagonal import paper_angular_uncertainty

from machine_tool_calibration.errors import ModelError
from machine_tool_calibration.machine.chain import Chain
from machine_tool_calibration.methods.build import error_map
from machine_tool_calibration.methods.identify import identify
from machine_tool_calibration.methods.step_diagonal.build import build
from machine_tool_calibration.model.fit import fit_models
from machine_tool_calibration.model.rigid_body import MachineTable
from machine_tool_calibration.simulation import TableSpec

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
    assert any(entry.name.startswith("3 slopes of ") for entry in model.left_out)
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
