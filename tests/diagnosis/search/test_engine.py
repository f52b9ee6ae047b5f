# SPDX-License-Identifier: Apache-2.0
"""What a whole diagnosis says of sessions whose truth is known."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from machine_tool_calibration.diagnosis.diagnose import Diagnosis, diagnose
from machine_tool_calibration.effects.catalogue import catalogue
from machine_tool_calibration.estimation import priors
from machine_tool_calibration.methods.build import error_map
from machine_tool_calibration.methods.fitted import FitRequest
from machine_tool_calibration.methods.identify import identify
from machine_tool_calibration.model.result import map_change, map_rms
from machine_tool_calibration.planning.what_to_measure import Advice
from machine_tool_calibration.reports.verdict import verdict_words
from machine_tool_calibration.session.session import Session
from machine_tool_calibration.simulation import (
    PRESETS,
    Amplitudes,
    FlawSpec,
    MachineSpec,
    SimulationSpec,
    Spread,
    simulate,
)
from machine_tool_calibration.simulation.spec import AnyPlan

# Three fifths of the preset's readings: its angles are no less random.
SIX_BLOCKS = PRESETS["step_diagonal"].model_copy(update={"blocks": 6})


def simulated(plan: str | AnyPlan, seed: int, flaws: Sequence[FlawSpec] = (), spread: float = 0.0) -> Session:
    """A session, with slopes and bows of each mounting in standard uncertainties."""
    chosen = PRESETS[plan] if isinstance(plan, str) else plan
    spec = SimulationSpec(plan=chosen, seed=seed, effects=tuple(flaws))
    size = spread * simulate(spec).session.sigma
    return simulate(spec.model_copy(update={"spread": Spread(slope=size, bow=size)})).session


def with_columns(session: Session, displacement: np.ndarray | None = None, without: str = "") -> Session:
    readings = session.readings
    columns = {name: values for name, values in readings.columns.items() if name != without}
    moved = readings.displacement if displacement is None else readings.displacement + displacement
    return session.with_readings(replace(readings, columns=columns, displacement=moved))


@pytest.mark.long
@pytest.mark.parametrize("plan", ["tracking_2d", "rotary_axis", "probing_cross"])
def test_setups_that_do_not_reproduce_are_no_effect(plan: str) -> None:
    found = diagnose(simulated(plan, 21, spread=1.0))
    assert found.verdict == "adequate"
    assert found.accepted == ()
    assert max(size.probability for size in found.fits[-1].marginal.sizes) > 0.5


@pytest.mark.long
def test_slopes_and_bows_of_four_mountings_are_seldom_the_drift_of_a_station() -> None:
    """Few setups, of which a drift of its own for each explains as much: several of these had been taken for one."""
    found = [
        diagnose(simulated("tracking_2d", 7000 + k, spread=size)) for k, size in enumerate((0.3, 0.7, 1.1, 1.5, 2))
    ]
    assert sum(each.verdict != "adequate" for each in found) <= 1


@pytest.mark.long
@pytest.mark.parametrize(
    ("plan", "effect", "amplitude"), [("tracking_2d", "backlash_y", 1.5e-6), ("probing_cross", "probe_pretravel", 6e-6)]
)
def test_an_effect_is_found_beside_setups_that_do_not_reproduce(plan: str, effect: str, amplitude: float) -> None:
    spec = FlawSpec(id=effect, amplitude=amplitude)
    found = diagnose(simulated(plan, 22, [spec], spread=0.4))
    assert found.verdict == "missing_effect"
    assert found.accepted == (effect,)
    assert found.search.of(effect).probability > priors.ACCEPTED
    assert not found.refused
    true = simulate(SimulationSpec(plan=PRESETS[plan], seed=22, effects=(spec,))).truth.effects[0].size
    if effect == "backlash_y":
        (size,) = found.search.of(effect).sizes
        assert abs(size.value - true) < 4.0 * size.standard_uncertainty


@pytest.mark.long
def test_angular_errors_of_a_step_diagonal_do_not_take_up_what_is_missing() -> None:
    """How large they are is weighed with and without it: drawn from the readings before, they held all of a drift."""
    found = diagnose(simulated(SIX_BLOCKS, 31, [FlawSpec(id="linear_drift", amplitude=2e-6)]))
    assert found.verdict == "missing_effect"
    (named,) = found.accepted
    assert any({named, "linear_drift"} <= set(group) for group in found.search.groups)


@pytest.mark.long
def test_angular_errors_of_a_step_diagonal_are_no_effect() -> None:
    machine = MachineSpec(random=Amplitudes(positioning=1.5e-6, straightness=1.5e-6, angular=1e-5, squareness=3e-5))
    found = diagnose(simulate(SimulationSpec(plan=SIX_BLOCKS, seed=31, machine=machine)).session)
    assert found.verdict == "adequate"
    assert found.search.spread["random functions"] > 1e-6


@pytest.mark.long
def test_warm_up_and_backlash_of_an_axis_are_both_found() -> None:
    # Warm after a third of the run: slower, it would be a drift.
    flaws = [FlawSpec(id="warmup_x", amplitude=8e-6, parameters={"tau": 160.0}), FlawSpec(id="backlash_x", size=1.5e-6)]
    found = diagnose(simulated("iso230_2", 23, flaws))
    assert found.verdict == "missing_effect"
    assert set(found.accepted) == {"warmup_x", "backlash_x"}
    # In one pass: the pair is in the best set, and each was weighed beside the other.
    assert set(found.search.sets[0][0]) == {"warmup_x", "backlash_x"}


@pytest.mark.long
def test_a_strong_warm_up_has_a_time_constant_between_those_that_are_tried() -> None:
    """At the nearest of these, a fifth off, what is left would look like a drift."""
    session = simulated("iso230_2", 23, [FlawSpec(id="warmup_x", amplitude=6e-5, parameters={"tau": 160.0})])
    found = diagnose(session)
    assert found.accepted == ("warmup_x",)
    (tau,) = found.search.of("warmup_x").shape
    assert tau == pytest.approx(160.0, rel=0.05)


@pytest.mark.long
def test_a_screw_that_grows_while_it_warms_up_is_named_without_a_thermometer() -> None:
    flaws = [FlawSpec(id="screw_growth_x", size=4e-5, parameters={"tau": 500.0}), FlawSpec(id="backlash_x", size=3e-6)]
    session = simulated("iso230_2", 23, flaws)
    columns = {name: v for name, v in session.readings.columns.items() if "temperature" not in name}
    found = diagnose(session.with_readings(replace(session.readings, columns=columns)))
    assert set(found.accepted) == {"screw_growth_x", "backlash_x"}
    assert found.search.of("screw_growth_x").sizes[0].value == pytest.approx(4e-5, rel=0.3)


@pytest.mark.long
@pytest.mark.parametrize(("quick", "accepted"), [(1.0, {"warmup_x"}), (0.4, {"warmup_x", "linear_drift"})])
def test_the_slow_part_of_a_warm_up_is_no_drift_beside_it_unless_it_is_the_larger(
    quick: float, accepted: set[str]
) -> None:
    session = simulated("iso230_2", 23)
    time = session.readings.columns["time"]
    parts = [-np.expm1(-time / (share * np.ptp(time))) for share in (0.05, 2.0)]
    fast, slow = (20.0 * session.sigma * part / np.sqrt(np.mean(part**2)) for part in parts)
    # Without the air, whose temperature drifts as well.
    found = diagnose(with_columns(session, quick * fast + slow, without="temperature_air"))
    assert set(found.search.sets[0][0]) == {"warmup_x", "linear_drift"}
    assert set(found.accepted) == accepted


@pytest.mark.long
def test_a_reversal_of_the_other_sign_is_the_same_effect() -> None:
    """An axis whose control compensates more than there is: a sign is expected, and no wall."""
    found = diagnose(simulated("iso230_2", 24, [FlawSpec(id="backlash_x", size=-3e-6)]))
    assert found.verdict == "missing_effect"
    assert found.accepted == ("backlash_x",)
    (size,) = found.search.of("backlash_x").sizes
    assert size.value == pytest.approx(-3e-6, abs=4.0 * size.standard_uncertainty)


@pytest.mark.long
def test_a_reversal_that_no_machine_has_is_not_accepted() -> None:
    found = diagnose(simulated("tracking_2d", 24, [FlawSpec(id="backlash_y", size=-4e-4)]))
    assert "backlash_y" not in found.accepted
    assert not found.search.of("backlash_y").plausible


@pytest.mark.long
def test_lost_motion_at_one_place_is_no_backlash_beside_it() -> None:
    """A screw that is worn around one place: one effect describes all of it."""
    session = simulated("iso230_2", 27, [FlawSpec(id="backlash_x", size=1e-6)])
    columns = session.readings.columns
    x = columns["x"]
    share = (x - x.min()) / np.ptp(x)
    worn = -4e-6 * np.exp(-(((share - 0.7) / 0.12) ** 2)) * columns["dir_x"]
    found = diagnose(with_columns(session, worn))
    assert found.accepted == ("lost_motion_x",)
    assert all({"backlash_x", "lost_motion_x"} - set(members) for members, _ in found.search.sets)


@pytest.mark.long
def test_a_wave_that_nobody_knows_is_unexplained_and_its_period_told() -> None:
    session = simulated("tracking_2d", 25)
    time = session.readings.columns["time"]
    found = diagnose(with_columns(session, 1.5e-6 * np.sin(2.0 * np.pi * time / 173.0)))
    assert found.verdict == "unexplained"
    assert found.accepted == ()
    assert found.search.unknown > 0.99
    waves = [s for s in found.search.structure if s.covariate == "time" and "period" in s.shape]
    period, unit = waves[0].shape.split()[-2:]
    assert (60.0 * float(period), unit) == (pytest.approx(173.0, rel=0.01), "min")
    assert waves[0].share == max(s.share for s in found.search.structure)


@pytest.mark.long
def test_a_wave_smaller_than_the_noise_that_hardly_moves_the_map_is_good_enough() -> None:
    """Of 0.9 standard uncertainties: sure to be there, and it moves no point by a third of its U."""
    session = simulated("tracking_2d", 25)
    time = session.readings.columns["time"]
    wave = 0.9 * np.sqrt(2.0) * session.sigma * np.sin(2.0 * np.pi * time / 173.0)
    found = diagnose(with_columns(session, wave))
    assert found.search.unknown > 0.99 and found.search.nothing < 0.01
    assert found.verdict == "adequate"
    still, moved = (identify(one).error_map for one in (session, with_columns(session, wave)))
    assert map_change(still, moved) < 2.0 * map_rms(moved.uncertainty) / 3.0


@pytest.mark.long
@pytest.mark.parametrize(("plan", "size"), [("tracking_2d", 1e-4), ("iso230_2", 2e-5)])
def test_a_count_that_is_lost_towards_the_end_of_a_setup_is_a_step(plan: str, size: float) -> None:
    """All its readings are off from then on: no warm-up, drift or lost motion, of which each describes some of it."""
    session = simulated(plan, 12)
    readings = session.readings
    last = np.flatnonzero(readings.setup == 0)[-10:]
    found = diagnose(with_columns(session, -size * np.isin(np.arange(len(readings)), last)))
    assert (found.verdict, found.accepted) == ("unexplained", ())
    assert not any(name.startswith(("warmup", "linear_drift", "lost_motion")) for name in found.likely)
    step = found.search.structure[0]
    assert step.covariate == "time" and "step" in step.shape and step.share > 0.95
    assert found.search.variance < 1.5


def in_seconds(found: Diagnosis) -> set[str]:
    """Effects and structures that speak of time."""
    effects = {
        f.name
        for f in found.search.findings
        if any("s" in c.unit.split("/") for c in (*f.candidate.nonlinear, *(s.coefficient for s in f.sizes)))
    }
    return effects | {s.covariate for s in found.search.structure if s.covariate == "time" or s.shape.endswith(" s")}


@pytest.mark.long
def test_without_times_nothing_is_told_in_seconds() -> None:
    session = simulated("tracking_2d", 26)
    order = np.arange(len(session.readings))
    disturbed = with_columns(session, 1.5e-6 * np.sin(2.0 * np.pi * order / 17.0), without="time")
    found = diagnose(disturbed)
    assert found.verdict == "unexplained"
    assert in_seconds(found) == set()
    waves = [s for s in found.search.structure if "period" in s.shape]
    assert waves[0].shape.endswith("readings")
    assert float(waves[0].shape.split()[-2]) == pytest.approx(17.0, rel=0.01)
    assert {"station_drift", "linear_drift", "warmup_x"} <= set(found.excluded)


@pytest.mark.long
def test_without_times_there_is_no_warm_up() -> None:
    """The number of a reading is no time; what can be told without it is told all the same."""
    flaws = [FlawSpec(id="backlash_x", size=3e-6)]
    found = diagnose(with_columns(simulated("iso230_2", 23, flaws), without="time"))
    assert (found.verdict, found.accepted) == ("missing_effect", ("backlash_x",))
    assert "warmup_x" in found.excluded
    assert not in_seconds(found)


@pytest.mark.long
def test_an_effect_that_would_leave_the_map_undetermined_is_refused_in_words(monkeypatch: pytest.MonkeyPatch) -> None:
    """Every angle read once, one after the other: a station that drifts all the while is an error of the axis.

    How fast it may plausibly drift keeps the map determined; here no growth of its uncertainty is allowed at all.
    """
    monkeypatch.setattr("machine_tool_calibration.estimation.priors.SPOILT", 0.5)
    session = simulated("rotary_axis_one_way", 4, [FlawSpec(id="station_drift", amplitude=6e-6)])
    # Of its look-alikes, some of which the data determines, none is looked for.
    only = {"station_drift": catalogue()["station_drift"]}
    monkeypatch.setattr("machine_tool_calibration.methods.fitted.catalogue", lambda *_: only)
    monkeypatch.setattr("machine_tool_calibration.diagnosis.diagnose.predictions", lambda *_: {})
    found = diagnose(session)
    assert found.search.accepted == ("station_drift",)
    assert found.accepted == ()
    assert set(found.refused) == {"station_drift"}
    assert "determine" in found.refused["station_drift"]
    assert found.verdict in ("adequate", "unexplained")
    words = " ".join(verdict_words(found, {}, Advice((), (), None)))
    assert found.refused["station_drift"] in words
    # The model stays as it was, and so does what it determines.
    assert len(found.fits) == 1
    own = found.fits[0].fits[0]
    assert np.isfinite(np.asarray(error_map(own).content["EZC"], dtype=float)).all()


def test_of_lost_motion_beside_backlash_only_what_varies_is_told() -> None:
    session = simulated("iso230_2", 5, [FlawSpec(id="backlash_x", size=2e-6)])
    lost = diagnose(FitRequest((session,), effects=("backlash_x",))).search.of("lost_motion_x")
    assert "b0" not in {size.coefficient.name for size in lost.sizes} | set(lost.detectable)
    assert lost.sizes
    assert all(size.standard_uncertainty < 1e-6 for size in lost.sizes)
