# SPDX-License-Identifier: Apache-2.0
"""Thermal expansion away from a fixed point, and what a session does not tell of that point."""

from dataclasses import replace

import numpy as np
import pytest

from machine_tool_calibration.methods.identify import identify
from machine_tool_calibration.session.session import Session
from machine_tool_calibration.simulation import (
    PRESETS,
    DirectPlan,
    FlawSpec,
    MachineSpec,
    Simulated,
    SimulationSpec,
    simulate,
)

K, FIXED = 9e-6, 0.25


def hidden(fixed: float, **plan: object) -> Simulated:
    """A machine without other errors, read along X while it warms up and cools down."""
    return simulate(
        SimulationSpec(
            plan=DirectPlan(kind="points", points=POINTS, terms=(), **plan),
            seed=4,
            environment_swing=4.0,
            machine=MachineSpec(random=None),
            effects=[FlawSpec(id="thermal_expansion_x", size=K, parameters={"fixed_point": fixed})],
        )
    )


POINTS = tuple((float(x), 0.0, 0.0) for x in np.tile(np.linspace(0.0, 0.5, 11), 60))


def found(session: Session) -> dict[str, tuple[float, float]]:
    result = identify(session, effects=["thermal_expansion_x"])
    return {e.name: (e.value, e.standard_uncertainty) for e in result.parameters}


@pytest.mark.parametrize("fixed", [0.0, FIXED, -0.4])
def test_coefficient_and_fixed_point_are_recovered(fixed: float) -> None:
    """Fixed at the axis's zero is the special case q = 0."""
    values = found(hidden(fixed).session)
    for name, truth in (("k", K), ("q", K * fixed)):
        value, u = values[f"thermal_expansion_x.{name}"]
        assert abs(value - truth) < 4 * u
        assert u < 0.02 * K


def test_a_temperature_that_stood_still_tells_the_coefficient_and_not_the_point() -> None:
    simulated = hidden(FIXED, datum="offset", misplacement=1e-5)
    session = simulated.session
    warm = np.full(len(session.readings), 23.0)
    x = session.readings.columns["x"]
    noise = session.sigma * np.random.default_rng(1).normal(size=len(x))
    readings = replace(
        session.readings,
        columns={**session.readings.columns, "temperature_x": warm},
        displacement=4e-6 + 3.0 * K * (x - FIXED) + noise,
    )
    result = identify(session.with_readings(readings), effects=["thermal_expansion_x"])
    k = next(e for e in result.parameters if e.name == "thermal_expansion_x.k")
    assert abs(k.value - K) < 4 * k.standard_uncertainty
    assert k.standard_uncertainty < 0.02 * K
    assert "thermal_expansion_x.q" in {n.name for n in result.not_determined}
    assert "thermal_expansion_x.q" not in {e.name for e in result.parameters}
    assert {n.name for n in result.not_determined} == {"thermal_expansion_x.q"}


def test_expansion_from_the_zero_of_the_axis_is_found_among_a_networks_own_unknowns() -> None:
    effect = FlawSpec(id="thermal_expansion_x", size=2e-5)
    session = simulate(SimulationSpec(plan=PRESETS["tracking_3d"], seed=8, effects=[effect])).session
    value, u = found(session)["thermal_expansion_x.k"]
    assert abs(value - 2e-5) < 4 * u
    assert value > 10 * u
