# SPDX-License-Identifier: Apache-2.0
"""Which session contradicts the others, and in which error motion.
Methods in pairs on the machine of the probing self-calibration: one map, the right uncertainty, contradictions.
"""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy import stats

from machine_tool_calibration.errors import ModelError
from machine_tool_calibration.methods.fitted import FitRequest
from machine_tool_calibration.methods.identify import JointResult, identify_sessions
from machine_tool_calibration.methods.joint.agreement import Contradiction, _log_tail, _Scores, _sentence
from machine_tool_calibration.model.rigid_body import map_field
from machine_tool_calibration.session.session import Session
from machine_tool_calibration.simulation.simulate import Simulated, simulate
from machine_tool_calibration.simulation.spec import SimulationSpec

BOW = 4e-6 * np.array([0.0, 0.6, 1.0, 1.0, 0.6, 0.0])


def _fitted(
    several: SimpleNamespace, seed: int, names: tuple[str, ...], odd: str = "", **changed: np.ndarray
) -> JointResult:
    """Sessions of one machine; one of them saw it changed."""
    sessions = [
        several.measured(name, seed, several.machine(seed, **(changed if name == odd else {}))).session
        for name in names
    ]
    return identify_sessions(FitRequest(sessions, list(names)))


@pytest.mark.long
def test_sessions_of_one_machine_agree(several: SimpleNamespace, many: Any) -> None:
    count = many.part(0.4).count
    found = [_fitted(several, seed, ("tracker", "run", "grid")).agreement for seed in range(count)]
    # one in a hundred by chance
    assert sum(bool(entry.contradictions) for entry in found) <= stats.binom.isf(0.005, count, 0.01)
    # Readings that scatter less than declared make nothing better.
    assert all(entry.comparisons >= 10 and entry.spread >= 1.0 for entry in found)
    assert "the sessions agree" in found[0].statement


@pytest.mark.long
@pytest.mark.parametrize("odd", ["tracker", "run", "grid"])
@pytest.mark.parametrize("seed", range(3))
def test_the_odd_one_of_three(several: SimpleNamespace, odd: str, seed: int) -> None:
    (entry,) = _fitted(several, seed, ("tracker", "run", "grid"), odd, EXX=BOW).agreement.contradictions
    assert (entry.session, entry.motion) == (odd, "EXX")
    assert set(entry.others) == {"tracker", "run", "grid"} - {odd}
    assert entry.p_value < 1e-6
    # The bow of 4 um is found in size, from its own mean or from its ends.
    assert 1.2e-6 < abs(entry.difference) < 4.6e-6
    assert entry.difference_u < 3e-7


def test_two_sessions_alone_do_not_determine_which_is_wrong(several: SimpleNamespace) -> None:
    agreement = _fitted(several, 5, ("tracker", "grid"), "grid", EYX=BOW).agreement
    assert agreement.contradictions[0].motion == "EYX"
    assert "contradict each other in EYX" in agreement.statement
    assert "two sessions alone do not determine which" in agreement.statement


@pytest.mark.long
def test_scatter_beyond_the_declared_is_no_contradiction(several: SimpleNamespace) -> None:
    names = ("tracker", "run", "grid")
    sessions = [several.measured(name, 6, noise_factor=4.0).session for name in names]
    agreement = identify_sessions(FitRequest(sessions, list(names))).agreement
    assert agreement.spread == pytest.approx(4.0, rel=0.1)
    assert not agreement.contradictions


def test_nothing_shared(several: SimpleNamespace) -> None:
    run = several.measured("run", 7).session
    bare = type(run)(run.description.model_copy(update={"terms": ()}), run.readings)
    joint = identify_sessions(FitRequest((bare, bare), ("a", "b")))
    assert joint.agreement.comparisons == 0
    assert joint.agreement.p_value is None
    assert joint.agreement.spread == 1.0
    assert "share no error motion" in joint.agreement.statement


@pytest.mark.parametrize("end", [0.11, 0.17, 0.25])
@pytest.mark.parametrize("seed", range(3))
def test_a_difference_is_stated_only_where_both_have_read(several: SimpleNamespace, seed: int, end: float) -> None:
    """A session of the axis's beginning says nothing of its end, where a polynomial of it would be anything."""
    plan = {"method": "direct", "kind": "iso230_2", "axis": "x", "repeats": 3, "count": 21, "chain": "w-X-Y-b-Z-t"}
    whole, part = (
        simulate(SimulationSpec.model_validate({"seed": seed + number, "plan": plan, "machine": machine})).session
        for number, machine in ((0, several.machine(seed)), (100, several.machine(seed, EXX=BOW)))
    )
    part = part.with_readings(part.readings.select(part.readings.column("x") <= end))
    (entry,) = identify_sessions(FitRequest((whole, part), ("whole", "part"))).agreement.contradictions
    largest = float(np.interp(min(end, 0.16), several.nodes, BOW))
    # A smooth function through a line with a corner misses it by a tenth.
    assert abs(entry.difference) == pytest.approx(largest, abs=0.1 * largest + 3 * entry.difference_u)
    assert entry.difference_u < 2e-7


def test_sessions_of_different_places_are_not_compared_there(several: SimpleNamespace) -> None:
    """Nothing of X can be compared; what they both have read of Y can."""
    session = several.measured("grid", 4).session
    x = session.readings.column("x")
    parts = [session.with_readings(session.readings.select(keep)) for keep in (x < 0.15, x > 0.25)]
    agreement = identify_sessions(FitRequest(parts, ("low", "high"))).agreement
    whole = identify_sessions(FitRequest((session, session), ("a", "b"))).agreement
    assert 0 < agreement.comparisons < whole.comparisons
    assert not agreement.contradictions


def test_what_is_shown_of_a_difference_is_clear_beside_the_scatter() -> None:
    """Not the end of an axis where it is largest and hardly known, once the readings scatter more than declared."""
    scores = _Scores(
        np.diag([1.0, 0.04]), np.array([8.0, 0.16]), np.array([1.0, 0.04]), np.array([0, 2]), np.zeros((2, 0))
    )
    shape = np.array([[1.0, 0.0], [1.0, 1.0]])  # 8 with u = 1; 12 with u = 5.1
    assert scores.difference(0, shape, 1.0) == pytest.approx((8.0, 1.0))
    assert scores.difference(0, np.array([[1.0, 0.0], [3.0, 0.5]]), 1.0) == pytest.approx((26.0, np.sqrt(15.25)))
    assert scores.difference(0, np.array([[1.0, 0.0], [3.0, 0.5]]), 2.5) == pytest.approx((8.0, 2.5))
    # Where the error motion is zero by its definition there is no difference, and no uncertainty to hold it against.
    assert scores.difference(0, np.array([[0.0, 0.0], [1.0, 0.0]]), 100.0) == pytest.approx((8.0, 100.0))


def test_the_tail_of_a_chi_square_beyond_floating_point_is_that_of_the_exponential() -> None:
    """Of two degrees of freedom it is exp(-x / 2), of four (1 + x / 2) exp(-x / 2)."""
    for chi_square in (3.0, 80.0, 5000.0):
        assert _log_tail(chi_square, 2) == pytest.approx(-chi_square / 2, rel=1e-12)
        assert _log_tail(chi_square, 4) == pytest.approx(np.log1p(chi_square / 2) - chi_square / 2, rel=1e-6)
    assert _log_tail(200.0, 7) == pytest.approx(stats.chi2.logsf(200.0, 7), rel=1e-9)


def _scored(columns: np.ndarray, data: np.ndarray, start: list[int]) -> _Scores:
    return _Scores(
        columns @ columns.T, columns @ data, np.sum(columns**2, axis=1), np.array(start), np.zeros((len(columns), 0))
    )


def test_a_difference_is_tested_by_what_it_takes_off_the_sum_of_squares() -> None:
    """Also beside one that was found before: then by what both take off together, less what that one did."""
    rng = np.random.default_rng(5)
    columns, data = rng.normal(size=(5, 40)) * [[1.0], [1e-3], [2.0], [5.0], [1e3]], rng.normal(size=40)
    scores = _scored(columns, data, [0, 2, 3, 5])

    def taken(rows: list[int]) -> float:
        left = data - columns[rows].T @ np.linalg.lstsq(columns[rows].T, data, rcond=None)[0]
        return float(data @ data - left @ left)

    assert scores.test(0) == (pytest.approx(taken([0, 1])), 2)
    assert scores.test(1) == (pytest.approx(taken([2])), 1)
    assert scores.test(2) == (pytest.approx(taken([3, 4])), 2)
    beside = scores.without(1)
    assert beside.test(2) == (pytest.approx(taken([2, 3, 4]) - taken([2])), 2)
    assert beside.without(2).test(0) == (pytest.approx(taken([0, 1, 2, 3, 4]) - taken([2, 3, 4])), 2)
    # What was taken into the model is nothing any more.
    assert beside.test(1) == (pytest.approx(0.0, abs=1e-12), 0)


def test_a_difference_has_the_value_and_uncertainty_of_its_least_squares() -> None:
    rng = np.random.default_rng(6)
    columns, data = rng.normal(size=(2, 30)), rng.normal(size=30)
    data = data + 50.0 * columns[0]
    shape = np.array([[1.0, 0.5], [0.2, 1.0]])
    value, u = _scored(columns, data, [0, 2]).difference(0, shape, 1.5)
    covariance = np.linalg.inv(columns @ columns.T)
    found = shape @ np.linalg.lstsq(columns.T, data, rcond=None)[0]
    assert np.argmax(np.abs(found)) == 0
    assert value == pytest.approx(found[0])
    assert u == pytest.approx(1.5 * np.sqrt(shape[0] @ covariance @ shape[0]))


@pytest.mark.parametrize(("others", "alike", "text"), [
    (("b", "c"), (), "session 'a' contradicts the others in EXX by 3 ± 1 µm (95 %)"),
    (("b",), ("EYX", "C0Y"), "sessions 'a' and 'b' contradict each other in EXX (or EYX, C0Y) by 3 ± 1 µm (95 %)"),
])  # fmt: skip
def test_a_contradiction_names_who_and_what_else(others: tuple[str, ...], alike: tuple[str, ...], text: str) -> None:
    assert _sentence(Contradiction("a", others, "EXX", alike, 3e-6, 5e-7, "m", 1e-9)) == text


@pytest.mark.parametrize(
    ("unit", "shown"), [("rad", "µrad"), ("1", "µm/m"), ("1/K", "µm/(m K)"), ("m/K", "µm/K"), ("rad/K", "µrad/K")]
)
def test_a_contradiction_has_the_unit_that_people_use(unit: str, shown: str) -> None:
    assert f" by 3 ± 1 {shown} (95 %)" in _sentence(Contradiction("a", ("b",), "EXX", (), -3e-6, 5e-7, unit, 1e-9))


def _with(session: Session, **said: object) -> Session:
    return replace(session, description=session.description.model_copy(update=said))


@pytest.mark.long
def test_a_station_stated_wrong_by_centimetres(several: SimpleNamespace) -> None:
    tracker, run = (several.measured(name, 1, several.machine(1)).session for name in ("tracker", "run"))
    first, *rest = tracker.description.setups
    wrong = first.model_copy(update={"position": tuple(np.add(first.position, (0.05, 0.0, 0.0)))})
    moved = _with(tracker, setups=[wrong, *rest])
    with pytest.raises(ModelError, match=f"station '{first.id}' is found 50 mm off") as caught:
        identify_sessions(FitRequest([moved, run], ["tracker", "run"], keep_all=True))
    assert "trust_units: true" in str(caught.value)
    identify_sessions(FitRequest([_with(moved, trust_units=True), run], ["tracker", "run"], keep_all=True))


def test_positions_that_are_a_tenth_too_large(several: SimpleNamespace) -> None:
    tracker, run = (several.measured(name, 1, several.machine(1)).session for name in ("tracker", "run"))
    columns = {**tracker.readings.columns, "x": 1.1 * tracker.readings.columns["x"]}
    stretched = tracker.with_readings(replace(tracker.readings, columns=columns))
    with pytest.raises(ModelError, match=r"tracker, run: the position error along x .* which no machine has"):
        identify_sessions(FitRequest([stretched, run], ["tracker", "run"], keep_all=True))


CHAIN = "w-C-b-Y-X-Z-t"
NODES = tuple((np.arange(-5, 6) * 0.022).tolist())
HEIGHTS = (0.0, 0.03, 0.06)
BENT = 4e-6 * np.sin(np.linspace(0.0, np.pi, 11))
PLANS: dict[str, dict[str, Any]] = {
    "probing": {"method": "probing", "grid": NODES, "chain": CHAIN},
    "space": {
        "method": "tracking_interferometer", "dimension": 3, "x": NODES, "y": NODES, "z": HEIGHTS, "chain": CHAIN,
    },
    "plane": {"method": "tracking_interferometer", "dimension": 2, "x": NODES, "y": NODES, "chain": CHAIN},
    "rotary": {"method": "rotary_axis"},
}  # fmt: skip


def _measured(several: SimpleNamespace, name: str, seed: int, **changed: np.ndarray) -> Simulated:
    """On a machine with smooth curves between the nodes of the grid; some changed."""
    content: dict[str, Any] = {"seed": 100 * seed + list(PLANS).index(name), "plan": PLANS[name]}
    if name != "rotary":
        nodes = {"X": NODES, "Y": NODES, "Z": HEIGHTS}
        content["machine"] = several.machine(seed, nodes, "cubic", CHAIN, **changed)
    return simulate(SimulationSpec.model_validate(content))


def _missed(result: JointResult, simulated: Simulated) -> np.ndarray:
    """(n, 3) errors of the map, without what all readings leave open."""
    points, tables = result.error_map.points, result.common.tables
    field = map_field(tables, points).reshape(-1, 3 * len(points))
    open_ = field.T @ np.array([result.common.fixed[label] for table in tables for label in table.labels])
    error = (result.error_map.error - simulated.truth.machine.position_error(points)).ravel()
    known = np.isfinite(error)
    return np.asarray(error - open_ @ np.linalg.lstsq(open_[known], error[known], rcond=1e-9)[0]).reshape(-1, 3)


@pytest.mark.long
@pytest.mark.parametrize(
    ("one", "other"),
    [("probing", "space"), ("probing", "plane"), ("plane", "space"), ("probing", "rotary"), ("space", "rotary")],
)
def test_one_map_with_the_right_uncertainty(several: SimpleNamespace, one: str, other: str, many: Any) -> None:
    found, chi, wrong = [], [], 0
    some = many.part(0.25)
    for seed in range(some.count):
        simulated = [_measured(several, name, seed) for name in (one, other)]
        result = identify_sessions(FitRequest(tuple(s.session for s in simulated), (one, other)))
        # Within the grid, at its places and between.
        u, error = result.error_map.uncertainty, _missed(result, simulated[0])
        good = (u > 1e-12) & (np.abs(result.error_map.points) < 0.1101).all(axis=1)[:, None]
        found.append(np.mean((error[good] / u[good]) ** 2))
        chi.append(result.fit.reduced_chi_square)
        wrong += bool(result.agreement.contradictions)
    assert np.mean(found) == pytest.approx(1.0, abs=some.off(0.043))
    assert np.mean(chi) == pytest.approx(1.0, abs=some.off(0.011))
    assert wrong <= 1 + some.count // 25


@pytest.mark.parametrize(("other", "motion"), [("space", "EXX"), ("space", "EXY"), ("plane", "EYX"), ("plane", "EYY")])
def test_probing_and_tracking_that_contradict_each_other(several: SimpleNamespace, other: str, motion: str) -> None:
    sessions = [_measured(several, "probing", 3).session, _measured(several, other, 3, **{motion: BENT}).session]
    agreement = identify_sessions(FitRequest(sessions, ("probing", other))).agreement
    assert agreement.contradictions[0].motion == motion
    assert f"contradict each other in {motion}" in agreement.statement


@pytest.mark.long
def test_two_rotary_axes_are_not_one(several: SimpleNamespace) -> None:
    sessions = [_measured(several, "rotary", seed).session for seed in (1, 2)]
    agreement = identify_sessions(FitRequest(sessions, ("first", "second"))).agreement
    assert agreement.contradictions and agreement.contradictions[0].motion.endswith("C")


@pytest.mark.long
def test_a_ball_bar_sees_the_curves_between_a_trackers_places(many: Any) -> None:
    """A smooth machine, read at five places of each axis and on circles between: sessions agree, and U is right."""
    found, wrong, some = [], 0, many.part(0.25)
    chain, travel = "w-Y-X-b-Z-t", {"X": (0.0, 0.4), "Y": (0.0, 0.4), "Z": (0.0, 0.3)}
    grid, nodes = [0.05, 0.125, 0.2, 0.275, 0.35], [0.0, 0.13, 0.26, 0.4]
    plane = {"method": "tracking_interferometer", "dimension": 2, "chain": chain, "x": grid, "y": grid}
    circle = {"method": "ball_bar", "chain": chain, "centre": (0.2, 0.2, 0.0)}
    for seed in range(some.count):
        rng = np.random.default_rng(seed)
        sizes = {f"E{component}{axis}": 4e-6 if component in "XYZ" else 1e-5 for axis in "XY" for component in "XYZABC"}
        motions = {
            name: {"nodes": nodes, "values": np.append(0.0, size * rng.normal(size=3)).tolist()}
            for name, size in sizes.items()
        }
        machine = {"seed": seed, "chain": chain, "travel": travel, "random": None, "motions": motions}
        specs = [{"seed": 9 + seed, "plan": plan, "machine": machine} for plan in (plane, circle)]
        measured = [simulate(SimulationSpec.model_validate(spec)) for spec in specs]
        result = identify_sessions(FitRequest(tuple(one.session for one in measured), ("plane", "circle")))
        u = result.error_map.uncertainty
        found.append(float(np.nanmean((_missed(result, measured[0])[u > 1e-9] / u[u > 1e-9]) ** 2)))
        wrong += bool(result.agreement.contradictions)
    assert wrong <= 1 and np.mean(found) == pytest.approx(1.0, abs=0.5)
