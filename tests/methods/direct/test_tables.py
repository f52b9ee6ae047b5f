# SPDX-License-Identifier: Apache-2.0
"""Machine errors of a session: which can be told, in which datum, and at which positions.
Places and deviations that do not belong together: the mistake is named, and nothing else is refused.
"""

import json
from collections.abc import Callable
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from machine_tool_calibration.diagnosis.diagnose import diagnose
from machine_tool_calibration.errors import ModelError, SessionError
from machine_tool_calibration.methods.direct.nodes import _read_twice, nodes_from
from machine_tool_calibration.methods.identify import identify
from machine_tool_calibration.session.checks import check_session
from machine_tool_calibration.session.session import Session

from ... import plates

LINE = np.linspace(0.0, 0.4, 5)
ALONG_X = np.column_stack([LINE, np.zeros(5), np.zeros(5)])
X, Y = np.eye(3)[0], np.eye(3)[1]


def _twice(values: np.ndarray) -> np.ndarray:
    return np.concatenate([values, values])


def test_absolute_deviations_keep_their_zero(direct: SimpleNamespace) -> None:
    deviation = 1e-6 * np.array([5.0, 6.0, 8.0, 7.0, 5.0])
    session = direct.written(_twice(ALONG_X), np.tile(X, (10, 1)), _twice(deviation), terms=["EXX"])
    result = identify(session)
    np.testing.assert_allclose(result.error_map.error[:, 0], deviation, atol=1e-15)
    assert not result.not_determined
    assert result.fit.model.constraints == ()


def test_offset_leaves_the_zero_open(direct: SimpleNamespace) -> None:
    deviation = 1e-6 * np.array([5.0, 6.0, 8.0, 7.0, 5.0])
    session = direct.written(_twice(ALONG_X), np.tile(X, (10, 1)), _twice(deviation), datum="offset", terms=["EXX"])
    result = identify(session)
    np.testing.assert_allclose(result.error_map.error[:, 0], deviation - deviation.mean(), atol=1e-15)
    tables = result.error_map.content["tables"]["EXX"]
    np.testing.assert_allclose(tables["value"], deviation - deviation[0], atol=1e-15)


def test_each_setup_has_its_own_offset(direct: SimpleNamespace) -> None:
    deviation = 1e-6 * np.array([0.0, 1.0, 3.0, 2.0, 0.0])
    reading = np.concatenate([deviation + 4e-5, deviation - 7e-5])
    session = direct.written(
        _twice(ALONG_X), np.tile(X, (10, 1)), reading,
        setup=[0] * 5 + [1] * 5, setups=("A", "B"), datum="offset", terms=["EXX"],
    )  # fmt: skip
    result = identify(session)
    values = {p.name: p.value for p in result.parameters}
    assert values["A.offset"] - values["B.offset"] == pytest.approx(1.1e-4)
    np.testing.assert_allclose(result.error_map.error[:, 0], deviation - deviation.mean(), atol=1e-15)


def test_squareness_against_a_rigid_part_is_told_by_two_axes_only(direct: SimpleNamespace) -> None:
    grid = np.array([(x, y, 0.0) for y in LINE for x in LINE])
    both = np.concatenate([grid, grid])
    g = np.concatenate([np.tile(X, (25, 1)), np.tile(Y, (25, 1))])
    skew = np.concatenate([-1e-5 * grid[:, 1], np.zeros(25)])
    told = identify(direct.written(both, g, skew, datum="rigid", terms=["C0Y"]))
    assert {p.name: p.value for p in told.parameters}["C0Y"] == pytest.approx(1e-5)
    # With x alone the turn of the part is the same as the squareness.
    alone = identify(direct.written(grid, g[:25], skew[:25], datum="rigid", terms=["C0Y"]))
    names = {entry.name: entry.why for entry in alone.not_determined}
    assert "C0Y" in names and "A.turn_c" in names["C0Y"]
    assert np.isnan(alone.document()["error_map"]["tables"]["C0Y"]["value"] or np.nan)


def test_what_no_reading_senses_is_left_out_by_name(direct: SimpleNamespace) -> None:
    session = direct.written(_twice(ALONG_X), np.tile(X, (10, 1)), np.zeros(10), terms=["EXX", "EZX", "A0Z"])
    names = [entry.name for entry in identify(session).not_determined]
    assert names == ["EZX", "A0Z"]


def test_no_terms_and_missing_readings(direct: SimpleNamespace) -> None:
    reading = 1e-6 * np.arange(10.0)
    reading[3] = np.nan
    result = identify(direct.written(_twice(ALONG_X), np.tile(X, (10, 1)), reading))
    assert [entry.row for entry in result.rejected] == [3]
    assert np.isnan(result.error_map.error).all()  # nothing was asked of any error
    assert result.rms_residual == pytest.approx(np.sqrt(np.nanmean(reading**2)))
    json.dumps(result.document(), allow_nan=False)


@pytest.mark.parametrize(
    ("terms", "message"), [(["EXQ"], "EXQ"), (["EXX", "EXX"], "twice"), (["ECC"], "no linear axis C"), (["Q0Z"], "Q0Z")]
)
def test_terms_that_the_machine_does_not_have(direct: SimpleNamespace, terms: list[str], message: str) -> None:
    with pytest.raises(SessionError, match=message):
        identify(direct.written(_twice(ALONG_X), np.tile(X, (10, 1)), np.zeros(10), terms=terms))


def test_nodes_are_the_positions_or_some_of_them() -> None:
    few = np.repeat(np.linspace(0.0, 0.4, 9), 4)
    np.testing.assert_allclose(nodes_from(few, len(few)), np.unique(few), atol=1e-12)
    many = np.sort(np.random.default_rng(0).uniform(0.0, 0.4, 300))
    nodes = nodes_from(many, len(many))
    assert len(nodes) <= 21
    assert np.isin(np.round(nodes, 9), np.round(many, 9)).all()
    # As many as there are readings to fill: each position twice for each table that the axis has.
    sixty = np.linspace(0.0, 0.6, 60)
    assert [len(nodes_from(np.repeat(sixty, n), n * 60 / k)) for n, k in ((1, 1), (2, 1), (2, 2), (4, 2))] == [
        21, 60, 21, 60
    ]  # fmt: skip
    # readings a hair apart are one position
    assert len(nodes_from(np.concatenate([few, few + 1e-5]), 2 * len(few))) == 9


ALL = ("EXX", "EYX", "EXY", "EYY", "C0Y")


def test_few_scattered_places_have_coarse_tables_of_two_axes(direct: SimpleNamespace) -> None:
    """Four tables of the 14 places themselves, fewer than 21 nodes, have more unknowns than 28 readings, too."""
    rng = np.random.default_rng(2)
    position = np.repeat(np.c_[rng.uniform(0.0, 1.0, (14, 2)), np.zeros(14)], 2, axis=0)
    direction = np.tile(np.eye(3)[:2], (14, 1))
    read = 1e-3 * position[:, 0] * direction[:, 1] + rng.normal(scale=5e-6, size=28)
    found = identify(direct.written(position, direction, read, terms=["EXX", "EXY", "EYX", "EYY"], sigma=5e-6))
    assert {len(table["value"]) for table in found.error_map.content["tables"].values()} == {5}
    assert found.rms_residual < 1e-5


def test_reading_scattered_places_again_makes_no_table_finer(direct: SimpleNamespace) -> None:
    """Thirty places in space, each read three times: with nodes at every place the nine tables had checked nothing."""
    rng = np.random.default_rng(4)
    position = np.repeat(rng.uniform(0.0, 0.3, (30, 3)), 3, axis=0)
    direction, sigma = np.tile(np.eye(3), (30, 1)), 1e-6
    bends = np.repeat(rng.normal(scale=3e-5, size=(30, 3)), 3, axis=0)  # of no axis
    read = np.einsum("nj,nj->n", bends, direction)
    terms = [f"E{along}{axis}" for along in "XYZ" for axis in "XYZ"]
    once = direct.written(position, direction, read + rng.normal(scale=sigma, size=90), terms=terms, sigma=sigma)
    again = [np.tile(one, (3, 1)) for one in (position, direction)]
    thrice = direct.written(*again, np.tile(read, 3) + rng.normal(scale=sigma, size=270), terms=terms, sigma=sigma)
    tables = [identify(session).error_map.content["tables"] for session in (once, thrice)]
    assert [len(table["value"]) for table in tables[1].values()] == [
        len(table["value"]) for table in tables[0].values()
    ]
    assert identify(thrice).fit.joint.p_value < 1e-6


def test_few_scattered_places_have_coarse_tables_of_three_axes(direct: SimpleNamespace) -> None:
    """Nine tables of 21 nodes have more unknowns than 49 places have readings."""
    rng = np.random.default_rng(6)
    position = np.repeat(rng.uniform(0.0, 1.0, (49, 3)), 3, axis=0)
    direction = np.tile(np.eye(3), (49, 1))
    bends = rng.normal(scale=1e-4, size=(3, 3))  # of each axis, along x, y and z

    def errors(at: np.ndarray) -> np.ndarray:
        return np.sin(3.0 * at) @ bends

    read = np.einsum("nj,nj->n", errors(position), direction) + rng.normal(scale=5e-6, size=147)
    terms = [f"E{along}{axis}" for along in "XYZ" for axis in "XYZ"]
    session = direct.written(position, direction, read, datum="rigid", terms=terms, sigma=5e-6)
    found = identify(session)
    assert {len(table["value"]) for table in found.error_map.content["tables"].values()} <= {7, 8}
    at = found.error_map.points
    left = direct.fitted_out(found.error_map.error - errors(at), direct.rigid_motions(at))
    assert np.sqrt(np.mean(left**2)) < 5e-6


def _once(direct: SimpleNamespace, count: int) -> Session:
    """An axis of which each place was read once, a smooth curve that is steep at its start."""
    x = np.linspace(0.0, 0.6, count)
    read = -1e-4 * x / 0.6 - 4e-5 * (1.0 - np.exp(-x / 0.02)) + np.random.default_rng(8).normal(scale=5e-7, size=count)
    at, along = np.c_[x, 0 * x, 0 * x], np.tile(np.eye(1, 3), (count, 1))
    session: Session = direct.written(at, along, read, datum="offset", terms=["EXX"], sigma=1e-6)
    return session


@pytest.mark.parametrize("count", range(10, 30))
def test_of_places_that_were_read_once_what_is_set_aside_leaves_a_model(direct: SimpleNamespace, count: int) -> None:
    found = identify(_once(direct, count))
    assert len(found.rejected) <= max(count // 6, 2)
    assert found.joint.solution.degrees_of_freedom >= count // 3


def test_a_wrong_reading_of_a_place_that_was_read_once_is_found(direct: SimpleNamespace) -> None:
    session = _once(direct, 24)
    read = session.readings.displacement.copy()
    read[8] *= 10.0
    found = identify(session.with_readings(replace(session.readings, displacement=read)))
    assert 8 in {one.row for one in found.rejected}


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


TURN = 8e-3
Change = Callable[[np.ndarray, np.ndarray], np.ndarray]

ACTUAL: dict[str, tuple[Change, str]] = {
    "quarter": (lambda x, y: np.column_stack([-y, x]), "turned by 90 degrees"),
    "quarter back": (lambda x, y: np.column_stack([y, -x]), "turned by -90 degrees"),
    "half": (lambda x, y: np.column_stack([-x, -y]), "turned by 180 degrees"),
    "mirror": (lambda x, y: np.column_stack([-x, y]), "the sign of x is reversed"),
    "mirror of y": (lambda x, y: np.column_stack([x, -y]), "the sign of y is reversed"),
    "exchanged": (lambda x, y: np.column_stack([y, x]), "x and y of the actual places look exchanged"),
}


@pytest.mark.parametrize("kind", list(ACTUAL))
def test_part_that_lies_otherwise(kind: str) -> None:
    change, words = ACTUAL[kind]
    session, _ = plates.plate(1, holes=100)
    place = session.readings.position()[::2, :2]
    actual = place + session.readings.displacement.reshape(-1, 2)
    moved = change(actual[:, 0], actual[:, 1]) - place
    with pytest.raises(ModelError, match=words) as caught:
        identify(plates.with_columns(session, moved.reshape(-1)))
    assert "\n" not in str(caught.value)


def test_columns_exchanged_and_signs_reversed() -> None:
    session, _ = plates.plate(1, holes=100, turn=TURN)
    columns = session.readings.columns
    identify(session)
    with pytest.raises(ModelError, match="x and y look exchanged"):
        identify(plates.with_columns(session, x=columns["y"], y=columns["x"]))
    with pytest.raises(ModelError, match="x and y look exchanged"):
        identify(plates.with_columns(session, gx=columns["gy"], gy=columns["gx"]))
    flipped = np.where(columns["gy"] > 0.5, -1.0, 1.0) * session.readings.displacement
    with pytest.raises(ModelError, match="along x or along y looks reversed"):
        identify(plates.with_columns(session, flipped))


def test_places_in_millimetres() -> None:
    session, _ = plates.plate(1, holes=100)
    columns = session.readings.columns
    with pytest.raises(ModelError, match="x, y and z look like millimetres"):
        identify(plates.with_columns(session, x=1e3 * columns["x"], y=1e3 * columns["y"]))


@pytest.mark.long
@pytest.mark.parametrize(("factor", "unit"), [(1e3, "millimetres"), (1e6, "micrometres")])
def test_deviations_in_another_unit(factor: float, unit: str) -> None:
    for seed in range(6):
        turn = (0.0, 1e-3, 2e-2)[seed % 3]
        part, _ = plates.plate(seed, holes=60, drilled=2e-5, scales=(1e-4, 2e-4), turn=turn, far=2)
        for session in (part, plates.axis(seed, wander=2e-5, scale=1e-4)):
            identify(session)
            with pytest.raises(ModelError, match=unit):
                identify(plates.with_columns(session, factor * session.readings.displacement))


def test_a_short_axis_may_be_off_by_a_hundredth_of_its_travel() -> None:
    """A stage of 8 mm whose deviations are tens of micrometres is bad, and no mistake."""
    identify(plates.axis(1, positions=5, length=8e-3, noise=4e-5))


@pytest.mark.long
def test_a_bad_machine_and_a_part_askew_are_not_refused() -> None:
    for seed in range(12):
        turn = (0.0, 1e-3, 1e-2, 5e-2)[seed % 4]
        session, _ = plates.plate(seed, holes=80, scales=(2e-3, -1e-3), square=1.5e-3, turn=turn, drilled=5e-5)
        identify(session)


@pytest.mark.parametrize(("along", "scatter"), [(0.2, 0.2), (1.0, 0.02)])
def test_a_cloud_that_follows_no_place_is_no_part_that_lies_otherwise(along: float, scatter: float) -> None:
    """A third of the plate, a fifth of it along the places, or a turn closely but for a twentieth: not as it lies."""
    session, _ = plates.plate(1, holes=100)
    x, y = session.readings.position()[::2, :2].T
    noise = scatter * np.random.default_rng(3).normal(size=(len(x), 2))
    spoilt = plates.with_columns(session, (np.column_stack([-y - x, x - y]) * along + noise).reshape(-1))
    with pytest.raises(ModelError) as caught:
        identify(spoilt)
    assert "degrees" not in str(caught.value) and "reversed" not in str(caught.value)


def test_a_turn_about_where_all_lines_of_sight_meet_is_not_told(direct: SimpleNamespace) -> None:
    """Ranges from one station as deviations along the lines of sight, a shift of 22 mm beside noise of 2 mm."""
    rng = np.random.default_rng(5)
    place = np.c_[rng.uniform(-1.0, 1.0, (49, 2)), np.full(49, 1.2)]
    sight = place / np.linalg.norm(place, axis=1)[:, None]
    read = sight @ np.array([0.02, -0.01, 0.005]) + 2e-3 * rng.normal(size=49)
    found = identify(direct.written(place, sight, read, datum="rigid", sigma=2e-3, terms=["EXX"]))
    assert found.rms_residual < 2.5e-3 and not found.rejected


def test_levels_that_no_line_connects_are_said_to_be_groups(direct: SimpleNamespace) -> None:
    """Four marks by two lines, two by another one: each group has a zero of its own."""
    at = np.column_stack([np.array([0.0, 0.1, 0.2, 0.2, 0.3, 0.4, 0.5]), np.zeros((7, 2))])

    def datum(*setup: int) -> str:
        session = direct.written(
            _twice(at), np.tile(X, (14, 1)), _twice(1e-6 * np.arange(7.0)),
            setup=[*setup, *setup], setups=("A", "B", "C"), datum="offset",
        )  # fmt: skip
        return identify(session, model="free").fit.model.datum

    assert "2 groups of 4 and 2 that no setup connects" in datum(0, 0, 0, 1, 1, 2, 2)
    assert "groups" not in datum(0, 0, 0, 1, 1, 1, 1)


@pytest.mark.parametrize("across", [(0, 1, 2), (1, 2, 0), (2, 0, 1)])
def test_a_direction_between_two_axes_is_of_length_1_or_refused(
    direct: SimpleNamespace, across: tuple[int, ...]
) -> None:
    for along, aside in ((0.6, 0.8), (0.5, 0.5)):
        direction = np.tile(np.array([along, aside, 0.0])[list(across)], (5, 1))
        session = direct.written(ALONG_X, direction, np.zeros(5))
        if aside == 0.8:
            check_session(session)
            continue
        with pytest.raises(SessionError, match=r"the direction \(gx, gy, gz\) has length 0.707107, not 1"):
            check_session(session)


def test_a_steep_course_read_at_places_of_each_pass_has_nodes_enough() -> None:
    """Eight passes at random places, 20 um that settle within 30 mm: EXX and a wave had been named."""
    for seed in range(3):
        rng = np.random.default_rng(seed)
        x = np.concatenate([np.sort(rng.uniform(0.0, 0.84, 29)) for _ in range(8)])
        read = 20e-6 * (1.0 - np.exp(-x / 0.03)) + 8e-8 * rng.normal(size=len(x))
        columns = {"x": x, "displacement": read}
        found = diagnose(plates.session(columns, 8e-8, "none", ["EXX"], np.repeat(np.arange(8), 29), repeats=8))
        assert "pitch_periodic_x" not in found.accepted
        assert found.fits[0].reduced_chi_square < 2.0


@pytest.mark.parametrize(
    ("first", "second", "twice"),
    [
        ([0.01, 0.06, 0.11, 0.16], [0.02, 0.07, 0.12, 0.17], True),  # in each half of 0.05, at places of their own
        ([0.01, 0.02, 0.11, 0.12], [0.06, 0.07, 0.16, 0.17], False),  # each pass has halves of its own
        ([0.01, 0.02, 0.06, 0.07], [], False),
        ([], [], False),
    ],
)
def test_halves_between_nodes_that_several_passes_read(first: list[float], second: list[float], twice: bool) -> None:
    nodes, x = np.array([0.0, 0.1, 0.2]), np.array([*first, *second])
    of_pass = np.repeat([0, 1], [len(first), len(second)])
    assert _read_twice(nodes, x, of_pass, np.full(len(x), True)) is twice
    # What does not read the motion says nothing of it.
    assert not _read_twice(nodes, x, of_pass, of_pass == 0)
