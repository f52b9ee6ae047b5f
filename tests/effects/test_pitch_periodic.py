# SPDX-License-Identifier: Apache-2.0
"""Leads that a search looks at: as the positions resolve them, without a gap, and the usual ones of long axes."""

import numpy as np
import pytest

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.effects.pitch_periodic import PitchPeriodic
from machine_tool_calibration.methods.build import build_model
from machine_tool_calibration.simulation import DirectPlan, SimulationSpec, TrackingPlan, simulate


def frequencies(plan: DirectPlan | TrackingPlan) -> Array:
    """Waves per metre, in the order of the grid."""
    session = simulate(SimulationSpec(plan=plan, seed=1)).session
    return np.array([1.0 / lead for (lead,) in PitchPeriodic("x").shape_grid(build_model(session)[0].observations)])


def points(x: Array) -> DirectPlan:
    return DirectPlan(kind="points", points=tuple((float(v), 0.0, 0.0) for v in x))


def test_even_positions_resolve_leads_of_two_steps() -> None:
    found = frequencies(points(np.linspace(0.0, 0.4, 41)))
    assert found[0] == pytest.approx(1.5 / 0.4)
    assert 1.0 / 0.02 - 0.4 / 0.4 < found[-1] <= 1.0 / 0.02 * (1 + 1e-9)
    np.testing.assert_allclose(np.diff(found), 0.4 / 0.4)
    assert len(frequencies(points(np.array([0.0, 0.1, 0.2])))) == 0
    # Points of a network are places of their own: one wave over them may be looked for.
    network = frequencies(TrackingPlan(dimension=2))
    x = np.linspace(0.0, 0.4, 6)
    assert network[0] == pytest.approx(1.0 / 0.4)
    assert network[-1] <= 1.0 / (2 * (x[1] - x[0])) * (1 + 1e-9)


def test_uneven_positions_resolve_leads_of_their_mean_step() -> None:
    x = np.cumsum(np.random.default_rng(3).uniform(0.005, 0.015, 30))
    mean = float(np.mean(np.diff(x)))
    found = frequencies(points(x))
    assert 1.0 / mean - 0.4 / np.ptp(x) < found[-1] <= 1.0 / mean * (1 + 1e-9)
    close = 0.0005 * np.cumsum(np.random.default_rng(3).uniform(0.5, 1.5, 60))
    # No shorter than 2 mm.
    assert 500.0 - 0.4 / np.ptp(close) < frequencies(points(close)).max() <= 500.0 * (1 + 1e-9)


def test_places_that_an_axis_came_back_to_are_no_places_of_their_own() -> None:
    """Three places, each read several times some micrometres apart: a wave has as many unknowns."""
    nearly = 1e-6 * np.random.default_rng(2).uniform(0.0, 10.0, 12)
    assert len(frequencies(points(np.tile([0.0, 0.1, 0.2], 4) + nearly))) == 0
    # Nor do many of them hide what the places resolve.
    again = np.repeat(np.linspace(0.0, 0.4, 41), 3) + 1e-6 * np.random.default_rng(2).uniform(0.0, 10.0, 123)
    assert frequencies(points(again)).max() <= 1.0 / 0.0099
    # Of an axis of a tenth of a millimetre, its own steps count.
    assert frequencies(points(np.linspace(0.0, 1e-4, 41))).max() == pytest.approx(1.0 / 5e-6, rel=0.02)


@pytest.mark.parametrize("span", [1.0, 4.0])
def test_of_a_long_axis_long_waves_without_a_gap_and_the_usual_leads(span: float) -> None:
    x = np.linspace(0.0, span, round(500 * span) + 1)
    found = frequencies(points(x))
    assert len(found) <= 80 and found[0] == pytest.approx(1.5 / span)
    step = np.diff(found)
    long = found[: np.flatnonzero(step > 0.4001 / span)[0] + 1]
    np.testing.assert_allclose(np.diff(long), 0.4 / span)
    beyond = found[len(long) :]
    usual = [1e3 / (lead * share) for lead in (4, 5, 6, 8, 10, 12, 16, 20, 25, 30, 32, 40) for share in (1.0, 0.5)]
    assert set(np.round(beyond, 6)) == {round(f, 6) for f in usual if long[-1] + 0.2 / span < f <= 250.0}
