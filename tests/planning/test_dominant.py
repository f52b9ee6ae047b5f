# SPDX-License-Identifier: Apache-2.0
"""What dominates the uncertainty of a map, and remedies that keep their word in the simulator."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from machine_tool_calibration.methods.build import build_model
from machine_tool_calibration.methods.step_diagonal.build import build
from machine_tool_calibration.methods.step_diagonal.profiles import eq17
from machine_tool_calibration.model.fit import fit_models
from machine_tool_calibration.nodes.shared import procedure_file
from machine_tool_calibration.planning.dominant import DRIFT, Dominant, dominant, limits_of
from machine_tool_calibration.planning.forecast import Assumed, forecast, planned_session
from machine_tool_calibration.planning.options import further_options
from machine_tool_calibration.procedure import read_procedure
from machine_tool_calibration.session.session import Session
from machine_tool_calibration.simulation import PRESETS, Amplitudes, MachineSpec, SimulationSpec, simulate

from .. import plates

Simulated = Callable[..., Session]
THREE = {"diagonals": ("ppp", "npp", "pnp")}
LONG = {"step": (0.05, 0.05, 0.05), "blocks": 12}


def _of(session: Session, **assumed: float) -> Dominant:
    found = dominant(session, **assumed)
    assert found is not None
    assert sum(found.shares.values()) == pytest.approx(1.0, abs=1e-6)
    return found


@pytest.fixture(scope="module")
def of_three(simulated: Simulated) -> Dominant:
    """What dominates where three diagonals of long axes are measured."""
    return _of(simulated("step_diagonal", plan={**THREE, **LONG}))


@pytest.mark.long
def test_three_diagonals_lack_the_fourth(simulated: Simulated, of_three: Dominant) -> None:
    found = of_three
    assert found.cause == "angular errors"
    kinds = [remedy.kind for remedy in found.remedies]
    assert set(kinds) == {"diagonal", "offset"}
    fourth = next(remedy for remedy in found.remedies if remedy.kind == "diagonal")
    assert fourth.measure == "add the diagonal nnp"
    assert found.again is not None
    assert fourth.uncertainty < 0.7 * found.again
    # To measure all of it once more takes five times as long, and leaves what it was.
    assert found.again > 0.95 * found.uncertainty
    again = next(option for option in further_options(simulated("step_diagonal", plan={**THREE, **LONG})))
    assert fourth.seconds is not None and again.seconds is not None
    assert fourth.seconds < 0.3 * again.seconds


@pytest.mark.long
def test_four_diagonals_of_long_axes_lack_offset_runs(simulated: Simulated) -> None:
    found = _of(simulated("step_diagonal", plan=LONG))
    assert [remedy.kind for remedy in found.remedies] == ["offset"]
    assert "each other axis in turn at its far end" in found.remedies[0].measure


def test_nothing_is_proposed_twice(simulated: Simulated) -> None:
    kinds = {option.kind for option in further_options(simulated("step_diagonal_long"))}
    assert not kinds & {"diagonal", "offset"}
    assert "order" in kinds


def test_proposed_runs_are_those_of_the_simulators_plan(simulated: Simulated) -> None:
    """What is proposed on top of three diagonals is what a plan with four and offset runs measures."""
    few = simulated("step_diagonal_long", plan=THREE | {"offset_linear": ()})
    whole = simulated("step_diagonal_long")
    for kind in ("diagonal", "offset"):
        option = next(o for o in further_options(few) if o.kind == kind)
        new = option.session.readings.select(option.session.readings.row >= option.first_row)
        for setup in np.unique(new.setup):
            name = option.session.setup_ids[setup]
            theirs = whole.readings.select(whole.readings.setup == whole.setup_ids.index(name))
            mine = new.select(new.setup == setup)
            assert mine.position() == pytest.approx(theirs.position(), abs=1e-9)
            for axis in "xyz":
                if np.ptp(theirs.columns[axis]) > 0:
                    moved = np.flatnonzero(np.diff(theirs.columns[axis]))[0] + 1
                    assert np.array_equal(mine.columns[f"dir_{axis}"][moved:], theirs.columns[f"dir_{axis}"][moved:])
            assert mine.displacement == pytest.approx(theirs.displacement, abs=2e-4)


@pytest.mark.long
def test_the_promise_of_the_fourth_diagonal_is_kept(of_three: Dominant) -> None:
    """The ratio of uncertainties that is promised is the ratio of errors of machines with such angular errors."""
    promised = of_three
    fourth = next(remedy for remedy in promised.remedies if remedy.kind == "diagonal")
    size = Amplitudes(positioning=1.5e-6, straightness=1.5e-6, angular=1e-5, squareness=3e-5)
    square = []
    for plan in ({**THREE, **LONG}, LONG):
        errors = []
        for seed in range(5):
            spec = SimulationSpec(
                plan=PRESETS["step_diagonal"].model_copy(update=plan), seed=seed, machine=MachineSpec(random=size)
            )
            made = simulate(spec)
            model = build(made.session)
            found = model.profiles(fit_models([model]).fits[0])
            judged = made.truth.expected["axis_errors"]
            true = eq17(found.blocks, np.concatenate([np.ravel(judged[letter]) for letter in "xyz"]))
            errors.append(np.mean((found.value - true) ** 2))
        square.append(np.mean(errors))
    assert np.sqrt(square[1] / square[0]) == pytest.approx(fourth.uncertainty / promised.uncertainty, abs=0.2)


@pytest.mark.long
def test_time_is_told_from_angle_by_turning_forth_and_back(simulated: Simulated) -> None:
    one_way = simulated("rotary_axis_one_way", plan={"interval": 60.0})
    found = _of(one_way, drift=2e-9)
    assert found.cause == "time"
    assert "both_ways" in [remedy.kind for remedy in found.remedies]
    best = next(remedy for remedy in found.remedies if remedy.kind == "both_ways")
    assert best.uncertainty < 0.6 * found.uncertainty
    both = simulated("rotary_axis", plan={"interval": 60.0})
    assert _of(both, drift=2e-9).cause == "readings"
    assert not any(option.kind == "both_ways" for option in further_options(both))


def test_a_run_that_turns_back_reads_every_angle_from_both_sides(simulated: Simulated) -> None:
    session = simulated("rotary_axis_one_way")
    option = next(o for o in further_options(session) if o.kind == "both_ways")
    new = option.session.readings.select(option.session.readings.row >= option.first_row)
    theirs = simulated("rotary_axis").readings
    for name in ("c", "dir_c"):
        assert new.columns[name] == pytest.approx(theirs.columns[name])


@pytest.mark.long
def test_where_readings_dominate_nothing_is_proposed(simulated: Simulated) -> None:
    found = _of(simulated("rotary_axis"))
    assert (found.cause, found.remedies, found.again) == ("readings", (), None)
    assert found.angular == 0.0
    assert _of(simulated("step_diagonal"), angular=1e-8, drift=0.0).cause == "readings"


@pytest.mark.long
def test_sizes_that_are_not_assumed_are_taken_from_the_session(simulated: Simulated) -> None:
    size = Amplitudes(positioning=1.5e-6, straightness=1.5e-6, angular=2e-5, squareness=3e-5)
    session = simulated("step_diagonal", 4, plan=LONG, machine=MachineSpec(random=size))
    found = limits_of(session, build_model(session)[0])
    assert found is not None
    assert 5e-6 < found.angular < 2e-5
    assert found.cause == "angular errors"


@pytest.mark.long
def test_a_drift_is_taken_to_be_as_fast_as_the_air_warmed(simulated: Simulated) -> None:
    """A third of what a metre of steel grows, per hour; of a steadier room no less than of 1 K per hour."""
    assert pytest.approx(11.5e-6 / 3.0, rel=0.1) == DRIFT * 3600.0
    session = simulated("rotary_axis")
    time = session.readings.columns["time"]
    for warming, expected in ((4.0, 4.0 * DRIFT), (0.2, DRIFT)):
        columns = {**session.readings.columns, "temperature_air": 20.0 + warming * time / 3600.0}
        warmed = session.with_readings(replace(session.readings, columns=columns))
        found = limits_of(warmed, build_model(warmed)[0])
        assert found is not None and found.drift == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize(("hours", "drift", "told"), [(100.0, 0.0, True), (100.0, DRIFT, False), (0.01, 0.0, False)])
def test_a_drift_that_the_readings_exclude_is_not_assumed(hours: float, drift: float, told: bool) -> None:
    """One place read again and again for days; within half a minute the assumed rate is too small to show."""
    time = np.linspace(0.0, 3600.0 * hours, 9)
    columns = {"time": time, "x": np.full(9, 0.1)}
    columns["displacement"] = 1e-7 + drift * time + 1e-8 * np.random.default_rng(4).normal(size=9)
    session = plates.session(columns, 1e-8)
    found = limits_of(session, build_model(session)[0])
    assert found is not None
    # A slope over this time by readings of 10 nm.
    known = 1e-8 / np.sqrt(np.sum((time - time.mean()) ** 2))
    assert (found.drift < 4.0 * known < 0.01 * DRIFT) if told else found.drift == DRIFT


@pytest.mark.long
def test_readings_that_scatter_by_far_more_than_declared_dominate(simulated: Simulated) -> None:
    session = simulated("iso230_2")
    shares = [limits_of(session, build_model(session)[0], scatter).shares for scatter in (1.0, 3.0)]
    odds = [own["readings"] / own["time"] for own in shares]
    assert odds[1] == pytest.approx(9.0 * odds[0])


def test_a_plan_foretells_air_that_warms_by_so_much_an_hour_and_axes_that_follow() -> None:
    file = Path(__file__).parents[2] / "config" / "procedures" / "direct_iso230_2.yaml"
    planned = planned_session(read_procedure(file), warming=2.0)
    columns = planned.readings.columns
    hours = columns["time"][-1] / 3600.0
    first, last = (columns["temperature_air"][k] for k in (0, -1))
    assert 20.0 < first < 21.0 and 0.9 * 2.0 * hours < last - first <= 2.0 * hours
    for name in ("x", "y", "z", "table", "work"):
        followed = np.ptp(columns[f"temperature_{name}"]) / (last - first)
        assert 0.0 < followed < 1.0


@pytest.mark.long
def test_a_plan_says_it_before_anything_is_measured() -> None:
    promised = forecast(read_procedure(procedure_file("step_diagonal_long")), Assumed(angular=1e-7))
    assert promised.dominant is not None
    assert promised.dominant.angular == 1e-7
    assert promised.document()["dominant"]["cause"] == promised.dominant.cause
