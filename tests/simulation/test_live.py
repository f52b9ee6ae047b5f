# SPDX-License-Identifier: Apache-2.0
"""One reading at a time gives what a whole session gives."""

from dataclasses import dataclass

import numpy as np
import pytest

from machine_tool_calibration.session.session import ENVIRONMENT_COLUMNS
from machine_tool_calibration.simulation import (
    Drift,
    FlawSpec,
    RotaryPlan,
    SimulationSpec,
    TrackingPlan,
    choose_flaw,
    simulate,
)
from machine_tool_calibration.simulation.flaw import Sight
from machine_tool_calibration.simulation.scene import random_environment
from machine_tool_calibration.simulation.sensors import sensed_path
from machine_tool_calibration.simulation.site import LiveMachine


@pytest.mark.long
def test_live_readings_are_those_of_the_session():
    effects = [
        "backlash_y",
        "thermal_expansion_x",
        "warmup_x",
        "refractive_index",
        "linear_drift",
        "station_drift",
        "pointer_zero_offset",
        "pointer_radial_error",
        "EYX",
        "C0Y",
        "unlisted_wave",
        "retroreflector_form",
        "lost_motion_x",
        "reversal_EYX",
        "reversal_ECY",
        "squareness_drift_C0Y",
        "pointer_axis_offset",
    ]
    plan = TrackingPlan(dimension=2, repeats=1, radial={2: (1e-6, 2e-6)}, eccentricity=1e-4)
    simulated = simulate(SimulationSpec(plan=plan, seed=3, noise_factor=0, effects=[FlawSpec(id=e) for e in effects]))
    plain = simulate(SimulationSpec(plan=plan, seed=3, noise_factor=0))
    session, column = simulated.session, simulated.session.readings.columns

    @dataclass(frozen=True)
    class Recorded(Drift):
        values: np.ndarray | None = None

        def __call__(self, time):
            return self.values[column["time"] == time[0]]

    environment = {name: Recorded(np.nan, values=column[name]) for name in ENVIRONMENT_COLUMNS}
    live = LiveMachine(plain.truth.machine, simulated.truth.effects, environment)
    path, first = [], {}
    for row in range(len(session.readings)):
        setup = int(session.readings.setup[row])
        start = column["time"][session.readings.setup == setup][0]
        now = live.scene(
            column["time"][row],
            session.readings.position()[row],
            {a: column[f"dir_{a.lower()}"][row] for a in "XYZ"},
            setup=setup,
            start=start,
        )
        station = np.array(simulated.truth.expected["stations"])[setup]
        azimuth = column["azimuth"][row]
        disturbance, turned = live.disturbance(now), np.array([azimuth])
        origin, direction = plan.beam(turned, np.zeros(1), station + disturbance.station, disturbance.turn)
        length = sensed_path(live.functional_point(now), origin, direction)
        first.setdefault(setup, length[0])
        sight = Sight(length, direction, turned, incidence=turned, change=length - first[setup])
        path.append(float((length + disturbance.added(sight))[0]))
    path = np.array(path)
    begin = np.unique(session.readings.setup, return_index=True)[1]
    np.testing.assert_allclose(path - path[begin][session.readings.setup], session.readings.displacement, atol=1e-14)


def test_live_table_is_that_of_the_session():
    effects = [FlawSpec(id="backlash_c"), FlawSpec(id="table_thermal_growth", size=2e-5)]
    simulated = simulate(SimulationSpec(plan=RotaryPlan(both_ways=True), seed=3, noise_factor=0, effects=effects))
    column, judged = simulated.session.readings.columns, simulated.truth.expected
    row = 25
    live = LiveMachine(simulated.truth.machine, simulated.truth.effects)
    now = live.scene(column["time"][row], np.zeros(3), {"C": column["dir_c"][row]}, angle=column["c"][row])
    moved = live.on_table(now, np.array(judged["targets"]["P"]))[0]
    still = simulated.truth.machine.on_table(np.array(judged["targets"]["P"]), column["c"][row : row + 1])[0]
    # at 20 degrees Celsius only the backlash is left
    turned = np.cross([0, 0, -1.3e-5 * column["dir_c"][row]], still)
    np.testing.assert_allclose(moved - still, turned, atol=1e-9)


def test_many_moments_at_once_are_each_alone():
    machine = simulate(SimulationSpec(plan=TrackingPlan(), seed=1)).truth.machine
    flaws = [
        choose_flaw(e, seed=2)
        for e in (
            "warmup_y",
            "pitch_periodic_x",
            "unlisted_rate",
            "backlash_x",
            "thermal_lag_z",
            "squareness_thermal_B0Z",
            "reversal_EBX",
        )
    ]
    live = LiveMachine(machine, flaws, random_environment(np.random.default_rng(2)))
    time = np.linspace(0, 100, 11)
    place = np.column_stack([np.linspace(0, 0.3, 11), np.full(11, 0.1), np.zeros(11)])
    together = live.functional_point(live.scene(time, place, {"X": 1.0}))
    alone = [live.functional_point(live.scene(t, p, {"X": 1.0}))[0] for t, p in zip(time, place, strict=True)]
    np.testing.assert_allclose(together, alone, atol=1e-17)


def test_environment_drifts_smoothly_and_its_rate_is_its_slope():
    environment = random_environment(np.random.default_rng(5))
    time = np.linspace(0, 5000, 5001)
    values = {name: drift(time) for name, drift in environment.items()}
    for name, value in values.items():
        rate = environment[name].rate(time)
        np.testing.assert_allclose(np.gradient(value, time)[1:-1], rate[1:-1], atol=1e-5 * np.ptp(value))
    assert 15 < values["temperature_air"].mean() < 25
    still = random_environment(np.random.default_rng(5), swing=0.0)
    assert all(np.ptp(drift(time)) == 0 for drift in still.values())
    assert still["air_pressure"](time)[0] == pytest.approx(101325, abs=2000)
