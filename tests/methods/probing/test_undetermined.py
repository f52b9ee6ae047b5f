# SPDX-License-Identifier: Apache-2.0
"""What the touches do not determine is named and null, all the rest comes back; the null space by the whole system."""

import numpy as np
import pytest

from machine_tool_calibration.machine.chain import Chain
from machine_tool_calibration.methods.probing.datum import _from_outside, conditions, null_space
from machine_tool_calibration.model.rigid_body import MachineTable
from machine_tool_calibration.session.description import KnownLength
from machine_tool_calibration.simulation.probing_run import PartPoint, cam, cross, pins

PICO = 1e-12
OUTER = {f"{name}({sign}0.11)" for name in ("EXX", "EYX", "EXY", "EYY", "ECY") for sign in ("", "-")}


def degrees(*angles):
    return tuple(np.radians(angles))


def named(document):
    return {entry["name"] for entry in document["not_determined"]}


def check_rest(case, document, differences, limit=PICO):
    """Every number that is given is right."""
    for name, values in differences(case, document).items():
        given = values[np.isfinite(values)]
        assert np.abs(given).max(initial=0.0) < (10 * limit if name == "ECC" else limit), name


def test_nodes_that_no_touch_reaches(make, differences):
    """A cross of 75 mm half length without spheres: ten unknowns at any number of angles (PHYSICS, 002)."""
    case = make(points=cross(half=0.075, spheres=False), grid=tuple(np.arange(-5, 6) * 0.022))
    document = case.identified()
    # the length was measured at a node that no touch reaches
    assert named(document) == {*OUTER, "absolute length"}
    check_rest(case, document, differences)
    found = document["error_map"]
    grid = np.array(found["grid"])
    inside = np.abs(grid).max(axis=1) < 0.1
    error = np.array(found["position_error"], float)
    assert np.isfinite(error[inside]).all()
    assert np.isnan(error[np.abs(grid[:, 0]) > 0.1]).all()
    assert np.array_equal(np.isnan(error), np.isnan(np.array(found["position_error_u"], float)))
    assert np.isfinite(np.array(found["workpiece_error"], float)).all()
    assert not OUTER & {entry["name"] for entry in document["parameters"]}


def test_grid_much_larger_than_the_part(make, differences):
    case = make(part="cam", grid=tuple(np.arange(-12, 13) * 0.033))
    document = case.identified()
    assert len(named(document)) == 1 + 5 * 16
    check_rest(case, document, differences)
    assert np.isfinite(np.array(document["error_map"]["workpiece_error_u"], float)).all()
    # the direction of X is not counted from a node that is hardly reached
    assert max(document["error_map"]["workpiece_error_u"]) < 4e-6


def test_points_outside_the_grid(make, differences):
    def narrow(document):
        document["machine"]["table_grid"] = {axis: list(np.arange(-1, 2) * 0.044) for axis in "xy"}
        document["known"] = {}

    case = make(narrow, part="cam")
    document = case.identified()
    assert named(document) == {"absolute length"}
    check_rest(case, document, differences)
    assert len(document["error_map"]["grid"]) == 9
    assert "EXX(0.132)" in {entry["name"] for entry in document["parameters"]}


def test_grid_that_is_not_named(make):
    """As many nodes as in the paper's case studies, over the travel."""

    def forget(document):
        document["machine"]["table_grid"] = None

    document = make(forget, part="cam").identified()
    grid = np.array(document["error_map"]["grid"])
    assert len(grid) == 121
    assert np.abs(grid).max() == pytest.approx(0.132)
    # In the corners, where the part does not come, an error would be known to tenths of a millimetre.
    u = np.array(document["error_map"]["position_error_u"], float)
    assert np.nanmax(u) < 1e-4 and np.isnan(u).sum() < 0.1 * u.size
    assert {one["why"] for one in document["not_determined"]} == {"its standard uncertainty would be above 0.1 mm"}


def test_disc(make, differences):
    """The angle of C has no effect on a disc; its form is found all the same."""
    case = make(part="disc", angles=degrees(0, 31, 83, 137, 191, 227, 257, 313))
    document = case.identified()
    found = document["error_map"]
    assert any(name.startswith("ECC") for name in named(document))
    assert found["ECC"] == [None] * 8
    assert found["ECC_u"] == [None] * 8
    form = np.array(found["workpiece_form_u"], float)
    assert np.isfinite(form).all()
    assert form.max() < 1e-6
    assert np.nanmax(np.abs(differences(case, document)["form"])) < PICO


def test_disc_with_rounded_coordinates(make):
    def rounded(document):
        for point in document["workpiece"]:
            point["position"] = [round(v, 6) for v in point["position"]]
            point["normal"] = [round(v, 6) for v in point["normal"]]

    document = make(rounded, part="disc", angles=degrees(0, 31, 83, 137, 191)).identified()
    assert document["error_map"]["ECC"] == [None] * 5


def test_quarter_turns(make, differences):
    """Turned by 90 degrees, errors that X and Y have in common cannot be distinguished from the part's."""
    case = make(part="cam", angles=degrees(0, 90, 180, 270))
    document = case.identified()
    found = document["error_map"]
    assert any(name.startswith("EXX(") for name in named(document))
    assert any(name.startswith("workpiece point") for name in named(document))
    assert None not in found["EXC"] + found["EYC"] + found["ECC"]
    assert {"ECY(0.088)", "C0Y"} <= {entry["name"] for entry in document["parameters"]}
    difference = differences(case, document)
    for name in ("EXC", "EYC", "ECC"):
        assert np.abs(difference[name]).max() < 10 * PICO


def test_no_length(make, differences):
    def forget(document):
        document["known"] = {}

    case = make(forget, part="cam")
    document = case.identified()
    assert named(document) == {"absolute length"}
    assert "the absolute length is not determined" in document["datum"]
    check_rest(case, document, differences)


def test_length_of_another_axis(make, differences):
    def along_y(document):
        entry = document["known"].pop("EXX")
        document["known"]["EYY"] = entry

    case = make(along_y, part="cam")
    # the value is that of X until it is set: take it from the machine
    position = case.session.description.known["EYY"].position
    true = float(-np.diff(case.truth.machine.motion("EYY", np.array([position, 0.0])))[0])

    def both(document):
        document["known"]["EYY"] = {"position": position, "value": true, "standard_uncertainty": 2e-7}

    def only(document):
        both(document)
        del document["known"]["EXX"]

    for change in (both, only):
        case = make(change, part="cam")
        document = case.identified()
        assert document["not_determined"] == []
        check_rest(case, document, differences)
    lengths = {"both": make(both, part="cam"), "one": make(part="cam")}
    spread = {
        key: next(e["standard_uncertainty"] for e in value.identified()["parameters"] if e["name"] == "EXX(0.088)")
        for key, value in lengths.items()
    }
    assert spread["both"] < spread["one"]


def test_exact_length(make):
    def exact(document):
        document["known"]["EXX"]["standard_uncertainty"] = 0.0

    document = make(exact, part="cam").identified()
    given = {entry["name"]: entry for entry in document["parameters"]}["EXX(0.132)"]
    assert given["standard_uncertainty"] < 1e-12
    assert document["not_determined"] == []


def test_point_and_index_without_touch(make, differences):
    case = make(part="cam")
    readings = case.session.readings
    keep = (readings.labels["point"] != "7") & (readings.setup != 0)
    other = type(case)(case.session.with_readings(readings.select(keep)), case.truth)
    document = other.identified()
    found = document["error_map"]
    assert {"workpiece point 7"} <= named(document)
    assert found["workpiece_error"][7] is None
    assert [found[name][0] for name in ("EXC", "EYC", "ECC")] == [None] * 3
    # counted from the second index, then
    assert [found[name][1] for name in ("EXC", "EYC", "ECC")] == [0.0] * 3
    difference = differences(other, document)
    for name in ("form", "map"):
        assert np.nanmax(np.abs(difference[name])) < PICO


@pytest.mark.long(but=("0", "5"))
@pytest.mark.parametrize("seed", range(10))
def test_whatever_is_given_is_right(make, differences, seed):
    """Random parts, grids and angles: any combination of nodes may be out of reach."""
    rng = np.random.default_rng([7, seed])
    part = [
        lambda: cross(half=rng.uniform(0.05, 0.09), spheres=bool(rng.integers(2))),
        lambda: pins(int(rng.integers(4, 12)), pitch_radius=rng.uniform(0.04, 0.1), spheres=bool(rng.integers(2))),
        lambda: cam(count=40, radius=rng.uniform(0.03, 0.07), spheres=False),
    ][seed % 3]()
    angles = degrees(*np.sort(rng.choice(np.arange(0, 360, 13), size=int(rng.integers(3, 6)), replace=False)))
    step = rng.uniform(0.02, 0.04)
    grid = tuple(step * np.arange(-int(rng.integers(6, 9)), int(rng.integers(7, 10))))
    case = make(points=part, angles=angles, grid=grid, seed=seed)
    document = case.identified()
    assert named(document)
    found = differences(case, document)
    for name, key in (("form", "workpiece_form_u"), ("EXC", "EXC_u"), ("EYC", "EYC_u"), ("ECC", "ECC_u")):
        given = np.isfinite(found[name])
        u = np.array(document["error_map"][key], float)
        assert np.array_equal(given, np.isfinite(u))
        assert given.sum() >= 3
        # what is badly seen takes up more of the products of errors
        assert np.all(np.abs(found[name][given]) < PICO + 1e-6 * u[given]), name


def test_quarter_turns_are_named_where_they_hide_the_part(make):
    quarters = make(points=cross(), grid=tuple(np.arange(-5, 6) * 0.022), angles=degrees(0, 90, 180, 270)).identified()
    why = {entry["why"] for entry in quarters["not_determined"] if entry["name"].startswith("workpiece point")}
    assert len(why) == 1
    assert "quarter turns apart" in why.pop()


def test_rounded_quarter_turns_give_no_numbers_made_of_rounding(make):
    """A square block at angles with six decimals: what X does along its own walls alone is not determined."""
    places = np.linspace(-0.08, 0.08, 9)
    walls = [(s, side, 0.0, np.sign(side)) for s in places for side in (-0.08, 0.08)]
    walls += [(y, x, ny, nx) for x, y, nx, ny in walls]
    block = [PartPoint(id=str(k), position=p[:2], normal=p[2:]) for k, p in enumerate(walls)]
    turns = tuple(np.round(degrees(0, 90, 180, 270), 6))
    document = make(points=tuple(block), grid=tuple(np.arange(-2, 3) * 0.04), angles=turns).identified()
    assert "EXX(-0.04)" in named(document)
    given = [entry["standard_uncertainty"] for entry in document["parameters"]]
    assert given
    assert max(given) < 1e-4


NAMES = ("a", "b", "c", "d")


def test_null_space_and_uncertainties_are_those_of_the_dense_system() -> None:
    rng = np.random.default_rng(4)
    point = np.repeat(np.arange(6), [1, 2, 3, 5, 2, 4])
    dense = rng.normal(size=(4, len(point))) * [[1e-3], [1.0], [40.0], [2.0]]
    # A shift of all points by d is not seen, and the sum of a and b in a ratio: the touches tell two of four.
    dense[3] = 2.0
    dense[0] = 1e-3 * dense[1]
    jacobian = np.concatenate([dense, np.eye(7)[:6][:, point], np.zeros((1, len(point)))]).T
    found = null_space(NAMES, dense, point, 7)
    unit = np.append(found.unit, np.ones(7))
    # The unknown of each is such that it changes the readings by one on the average of squares.
    np.testing.assert_allclose(np.sqrt(np.mean((dense * found.unit[:, None]) ** 2, axis=1)), 1.0)
    np.testing.assert_allclose(null_space(NAMES, 1e-9 * dense, point, 7).unit, 1e9 * found.unit)
    scaled = jacobian * unit
    assert np.linalg.matrix_rank(scaled) == 11 - found.basis.shape[1] == 8
    np.testing.assert_allclose(scaled @ found.basis, 0.0, atol=1e-12)
    np.testing.assert_allclose(found.basis.T @ found.basis, np.eye(3), atol=1e-12)
    rows = np.array([found.weights({"d": 1.0}), found.weights({"a": 1e-3, "b": -1.0})])
    conditions = np.hstack([rows, np.zeros((2, 7))])
    free = np.linalg.svd(conditions)[2][2:].T
    covariance = free @ np.linalg.pinv(free.T @ scaled.T @ scaled @ free, rcond=1e-12) @ free.T
    known = found.determined(rows)
    assert known.tolist() == [True] * 10 + [False]  # the last point was never touched
    np.testing.assert_allclose(
        found.uncertainty(rows)[known], np.sqrt(np.diag(covariance)[known]), rtol=1e-8, atol=1e-12
    )
    assert found.fixes(rows, found.weights({"b": 1.0})) and not found.fixes(rows[:1], found.weights({"b": 1.0}))
    assert not found.determined(rows[1:])[3:].any() and found.determined(rows[1:])[2]


@pytest.mark.parametrize(
    ("nodes", "order"), [([0.02, 0.05, 0.1], [2, 1, 0]), ([-0.1, -0.05, 0.0, 0.05, 0.1], [4, 3, 0, 1])]
)
def test_a_length_is_held_at_the_outermost_node_that_was_touched(nodes, order):
    """On the positive side first; the axis's zero says nothing of its length."""
    assert _from_outside(np.array(nodes)) == order


def test_where_no_touch_reaches_a_measured_length_the_axis_is_as_long_there_as_it_says():
    """4 um over 200 mm: 2.2 um at 110 mm, and as much less on the other side of zero."""
    table = MachineTable(Chain.parse("w-C-b-Y-X-Z-t"), "EXX", np.array([-0.11, 0.0, 0.11]))
    known = {"EXX": KnownLength(position=0.2, value=4e-6, standard_uncertainty=0.0)}
    measured, *others = conditions([table], ["A"], known)[-1].places
    assert measured.is_measured and measured.value == 4e-6
    at = {max(place.weights, key=lambda name: place.weights[name]): place.value for place in others}
    assert at == {"EXX(0.11)": pytest.approx(2.2e-6), "EXX(-0.11)": pytest.approx(-2.2e-6)}
