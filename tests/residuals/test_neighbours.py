# SPDX-License-Identifier: Apache-2.0
"""Readings next to each other in time, and those that repeat each other."""

import numpy as np

from machine_tool_calibration.methods.build import build_model
from machine_tool_calibration.residuals.neighbours import Neighbours
from machine_tool_calibration.simulation import PRESETS, SimulationSpec, simulate


def test_what_deviates_alike_in_another_setup_reproduces() -> None:
    """A circle at two feeds, and one place seen by two stations along directions of their own."""
    session = simulate(SimulationSpec(plan=PRESETS["ball_bar"], seed=1)).session
    observations = build_model(session)[0].observations
    readings = observations.readings
    spike = np.linalg.norm(observations.position - observations.position[90], axis=1) < 1e-9
    which = np.flatnonzero(spike)
    assert len(np.unique(readings.setup[which])) > 1
    own = Neighbours(readings, observations.direction)
    assert own.repeated(which, 50.0 * spike, 5.0).all()
    turned = observations.direction + 0.1 * readings.setup[:, None]
    assert not Neighbours(readings, turned).repeated(which, 50.0 * spike, 5.0).any()


def test_neighbours_of_a_reading_are_of_its_run_and_direction() -> None:
    """Holes are read along x and along y in turn, each with a course of its own; at the ends of a run it goes on."""
    spec = SimulationSpec(plan=PRESETS["drilled_plate"].model_copy(update={"count": 5, "repeats": 2}), seed=1)
    readings = simulate(spec).session.readings
    number = np.arange(len(readings)) // 2 % 25
    course = np.where(readings.columns["gx"] > 0.5, 3.0 + 0.1 * number, -5.0) + 20.0 * readings.repeat
    own = Neighbours(readings, np.zeros((len(readings), 3)))
    every = np.arange(len(readings))
    np.testing.assert_allclose(own.course(course, every < 0), course, atol=1e-9)
    # A single wrong one is not what its neighbours say, and does not change what they say of others.
    wrong = course.copy()
    wrong[40] += 50.0
    np.testing.assert_allclose(own.course(wrong, every < 0), course, atol=0.21)
    assert own.explained(every, course, 1.0, 3.0).all()
    assert np.flatnonzero(~own.explained(every, wrong, 1.0, 3.0)).tolist() == [40]
    # Several in a row would be; left out one after the other they are not.
    wrong[np.flatnonzero(own.run.group == own.run.group[40])[10:14]] += 50.0
    assert np.abs(own.course(wrong, every < 0) - course).max() > 10.0
    np.testing.assert_allclose(own.course_of_the_others(wrong, 3.0, every < 0), course, atol=0.3)
