# SPDX-License-Identifier: Apache-2.0
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from machine_tool_calibration.methods.build import build_model
from machine_tool_calibration.methods.step_diagonal.geometry import halts_of
from machine_tool_calibration.model.fit import fit_models
from machine_tool_calibration.planning.options import Option, further_options
from machine_tool_calibration.planning.sensing import approached, first_repetition, fresh_id, pace
from machine_tool_calibration.session.session import Session

Simulated = Callable[..., Session]
EVERY = (
    "tracking_2d", "tracking_3d", "rotary_axis", "step_diagonal", "step_diagonal_three_orders", "probing_cross",
    "iso230_2", "drilled_plate",
)  # fmt: skip


def named(options: list[Option], kind: str) -> Option:
    return next(option for option in options if option.kind == kind)


@pytest.mark.long
@pytest.mark.parametrize("plan", EVERY)
def test_every_option_is_a_session_that_the_method_understands(simulated: Simulated, plan: str) -> None:
    session = simulated(plan)
    options = further_options(session)
    assert options[0].kind == "again"
    before = fit_models([build_model(session)[0]]).solution
    for option in options:
        readings = option.session.readings
        new = readings.row >= option.first_row
        n = int(new.sum())
        assert n > 0
        assert len(readings) == len(session.readings) + n
        assert np.array_equal(readings.displacement[~new], session.readings.displacement)
        assert np.isfinite(readings.displacement).all()
        assert (np.diff(readings.columns["time"]) >= 0).all()
        assert option.seconds is not None
        assert option.seconds > 0
        assert option.measure
        # More readings of the same machine leave more to be seen, whatever setups they bring.
        after = fit_models([build_model(option.session)[0]]).solution
        assert after.degrees_of_freedom > before.degrees_of_freedom


def test_an_instrument_that_travels_is_mounted_again_and_a_clamped_part_is_not(simulated: Simulated) -> None:
    again = named(further_options(simulated("tracking_2d")), "again")
    assert [setup.id for setup in again.session.description.setups] == [*"ABCD", *(f"again_{s}" for s in "ABCD")]
    assert "mounting" in again.aside
    probing = simulated("probing_cross")
    again = named(further_options(probing), "again")
    assert again.session.description == probing.description
    assert again.aside == ""


def test_backwards_is_the_reverse_order_with_the_other_approach(simulated: Simulated) -> None:
    session = simulated("tracking_2d")
    option = named(further_options(session), "backwards")
    rows = first_repetition(session)
    new = option.session.readings.select(option.session.readings.row >= option.first_row)
    old = session.readings.select(rows)
    for setup in range(4):
        mine, theirs = new.setup == 4 + setup, old.setup == setup
        assert np.array_equal(new.columns["x"][mine], old.columns["x"][theirs][::-1])
        assert np.array_equal(new.columns["y"][mine], old.columns["y"][theirs][::-1])
    # The simulator runs every second repeat backwards: once an axis has moved, its approach is the same.
    second = session.readings.select((session.readings.repeat == 1) & (session.readings.setup == 0))
    mine = new.setup == 4
    for axis in "xy":
        moved = np.flatnonzero(np.diff(second.columns[axis]) != 0)[0] + 1
        assert np.array_equal(new.columns[f"dir_{axis}"][mine][moved:], second.columns[f"dir_{axis}"][moved:])


def test_in_another_order_that_axis_moves_at_every_target_which_moved_least_often(simulated: Simulated) -> None:
    """Station after station as they were, each with all of its targets, sorted by the axis that moves from now on."""
    session = simulated("tracking_2d")
    option = named(further_options(session), "order")
    new = option.session.readings.select(option.session.readings.row >= option.first_row)
    old = session.readings.select(first_repetition(session))
    assert "Y" in option.measure
    for setup in range(4):
        before, after = old.position()[old.setup == setup], new.position()[new.setup == 4 + setup]
        moves = np.count_nonzero(np.diff(before, axis=0), axis=0)
        assert moves[1] < moves[0]
        assert np.array_equal(after, before[np.lexsort((before[:, 1], before[:, 0]))])


def test_a_reversed_run_starts_at_zero_where_runs_do(simulated: Simulated) -> None:
    session = simulated("step_diagonal")
    new = named(further_options(session), "backwards").session.readings
    for setup in np.unique(new.setup[new.row >= len(session.readings)]):
        assert new.displacement[new.setup == setup][0] == 0.0


def test_surroundings_go_on_in_time_and_only_temperatures_rise(simulated: Simulated) -> None:
    session = simulated("tracking_2d")
    rows = first_repetition(session)
    options = further_options(session)
    for kind, rise in (("backwards", 0.0), ("warmer", 5.0)):
        option = named(options, kind)
        new = option.session.readings.select(option.session.readings.row >= option.first_row)
        old = session.readings.select(rows)
        assert new.columns["temperature_air"] == pytest.approx(old.columns["temperature_air"] + rise)
        assert np.array_equal(new.columns["air_pressure"], old.columns["air_pressure"])


def test_runs_of_a_step_diagonal_that_were_not_made(simulated: Simulated) -> None:
    plan = {"diagonals": ("ppp", "pnp"), "linear": ("x", "z"), "corner": (0.1, 0.0, -0.2), "blocks": 5}
    options = {o.kind: o for o in further_options(simulated("step_diagonal", plan=plan))}
    new = {kind: o.session.description.setups[4:] for kind, o in options.items()}
    assert {s.id: s.start for s in new["diagonal"]} == {
        "npp": pytest.approx((0.16, 0.0, -0.2)), "nnp": pytest.approx((0.16, 0.06, -0.2)),
    }  # fmt: skip
    assert [tuple(np.sign(s.direction)) for s in new["diagonal"]] == [(-1, 1, 1), (-1, -1, 1)]
    assert {s.id: tuple(np.round(s.start, 9)) for s in new["offset"]} == {
        "X_at_y": (0.1, 0.06, -0.2), "X_at_z": (0.1, 0.0, -0.14),
        "Z_at_x": (0.16, 0.0, -0.2), "Z_at_y": (0.1, 0.06, -0.2),
    }  # fmt: skip
    assert [s.id for s in new["order"]] in (["ppp_yzx", "pnp_yzx"], ["ppp_zxy", "pnp_zxy"])
    # The path of the first new diagonal, move by move, and the distance along it.
    first = options["diagonal"]
    rows = first.session.readings.select(first.session.readings.row >= first.first_row)
    path = rows.position()[rows.setup == 4]
    steps = np.diff(path, axis=0)
    assert np.count_nonzero(np.abs(steps) > 1e-9, axis=1).tolist() == [1] * 15
    assert steps[:3].sum(axis=0) == pytest.approx([-0.012, 0.012, 0.012])
    beam = np.array([-1.0, 1.0, 1.0]) / np.sqrt(3.0)
    assert rows.displacement[rows.setup == 4] == pytest.approx((path - path[0]) @ beam)


def test_new_diagonals_are_run_in_the_order_of_the_others_and_say_so(simulated: Simulated) -> None:
    session = simulated("step_diagonal", plan={"diagonals": ("ppp", "pnp"), "orders": ("yzx",), "blocks": 5})
    option = named(further_options(session), "diagonal")
    description, rows = option.session.description, option.session.readings
    rows = rows.select(rows.row >= option.first_row)
    new = [k for k, setup in enumerate(description.setups) if setup.id in ("npp_yzx", "nnp_yzx")]
    assert sorted(np.unique(rows.setup)) == new
    for k in new:
        halts = halts_of(description.setups[k], description)
        assert rows.position()[rows.setup == k] == pytest.approx(halts)
        # Y goes first: by the names alone the readings would not be where the description says.
        assert np.flatnonzero(halts[1] - halts[0]).tolist() == [1]


def test_a_name_that_is_taken_keeps_the_order_at_its_end() -> None:
    assert fresh_id("ppp_yzx", ["ppp", "ppp_yzx"]) == "new_ppp_yzx"


def test_missing_readings_are_not_taken_again(simulated: Simulated) -> None:
    session = simulated("tracking_2d", missing=0.1)
    lost = ~np.isfinite(session.readings.displacement)
    assert lost.any()
    rows = first_repetition(session)
    assert not lost[rows].any()
    assert all(session.readings.repeat[rows] == 0)


def test_a_new_station_sees_the_same_targets_from_elsewhere(simulated: Simulated) -> None:
    session = simulated("tracking_2d")
    option = named(further_options(session), "station")
    new = option.session.readings.select(option.session.readings.row >= option.first_row)
    place = np.array(option.session.description.setups[-1].position)
    line = new.position() - place
    assert new.columns["azimuth"] == pytest.approx(np.arctan2(line[:, 1], line[:, 0]))
    assert np.diff(new.displacement) == pytest.approx(np.diff(np.linalg.norm(line, axis=1)))
    others = np.array([setup.position for setup in session.description.setups])
    assert np.linalg.norm(others - place, axis=1).min() > 0.2


def test_a_new_station_halves_the_widest_gap_and_another_stands_twice_as_far(simulated: Simulated) -> None:
    session = simulated("tracking_2d")
    between, far = (o for o in further_options(session) if o.kind == "station")
    others = np.array([setup.position for setup in session.description.setups])
    middle = np.mean(session.readings.position()[first_repetition(session, [0])], axis=0)
    arm = others - middle
    place = np.array(between.session.description.setups[-1].position) - middle
    angle = np.sort(np.arctan2(arm[:, 1], arm[:, 0]))
    gaps = np.diff(angle, append=angle[0] + 2 * np.pi)
    away = np.abs(np.angle(np.exp(1j * (np.arctan2(place[1], place[0]) - angle))))
    assert np.sort(away)[:2] == pytest.approx([gaps.max() / 2] * 2)
    assert np.hypot(*place[:2]) == pytest.approx(np.median(np.hypot(arm[:, 0], arm[:, 1])))
    assert np.array(far.session.description.setups[-1].position) - middle == pytest.approx(2 * arm[0])


def test_a_new_angle_of_c_is_in_the_middle_of_a_gap(simulated: Simulated) -> None:
    """Of the cross at 0, 75, 130 and 210 degrees: of the widest gap of all, and of the widest between neighbours."""
    session = simulated("probing_cross")
    found = [np.degrees(o.session.description.setups[-1].c) for o in further_options(session) if o.kind == "index"]
    assert found == pytest.approx([170.0, 285.0])


def test_a_new_angle_of_c_turns_the_part(simulated: Simulated) -> None:
    session = simulated("probing_cross")
    option = named(further_options(session), "index")
    c = option.session.description.setups[-1].c
    assert min(abs((c - s.c + np.pi) % (2 * np.pi) - np.pi) for s in session.description.setups) > 0.05
    # The model itself would refuse touches that are not where the turned part is.
    model, _ = build_model(option.session)
    assert len(model.observations) == len(option.session.readings)


def test_approach_before_the_first_move_is_as_told() -> None:
    values = np.array([0.0, 0.0, 1.0, 0.5, 0.5, 3.0, 2.0])
    group = np.array([0, 0, 0, 0, 0, 1, 1])
    assert approached(values, group, np.full(7, 7.0)).tolist() == [7, 7, 1, -1, -1, 7, -1]


def test_a_night_between_two_setups_is_not_measuring_time(simulated: Simulated) -> None:
    session = simulated("tracking_2d")
    columns = dict(session.readings.columns)
    late = columns["time"] + np.where(session.readings.setup > 1, 50_000.0, 0.0)
    slow = session.with_readings(replace(session.readings, columns={**columns, "time": late}))
    rows = first_repetition(slow)
    spent = pace(slow, rows)
    assert spent is not None
    assert spent.sum() < 4000.0


def test_without_a_time_there_is_no_duration(simulated: Simulated) -> None:
    session = simulated("drilled_plate")
    columns = {n: v for n, v in session.readings.columns.items() if n != "time"}
    timeless = session.with_readings(replace(session.readings, columns=columns))
    assert all(option.seconds is None for option in further_options(timeless))
