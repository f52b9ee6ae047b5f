# SPDX-License-Identifier: Apache-2.0
"""Over which range functions of an axis's position are scaled."""

from dataclasses import replace

import pytest

from machine_tool_calibration.methods.build import build_model
from machine_tool_calibration.simulation import PRESETS, SimulationSpec, simulate


@pytest.mark.parametrize(
    ("travel", "span"),
    [
        ((0.0, 0.4), (0.0, 0.4)),  # as far as was read
        ((-0.04, 0.46), (-0.04, 0.46)),  # of which what was read is four fifths
        ((-0.04, 0.47), (0.0, 0.4)),  # of which it is less
        ((0.1, 0.5), (0.0, 0.4)),  # of which it lies outside, below
        ((-0.1, 0.3), (0.0, 0.4)),  # above
        (None, (0.0, 0.4)),
    ],
)
def test_the_span_of_an_axis_is_its_travel_where_readings_fill_it(
    travel: tuple[float, float] | None, span: tuple[float, float]
) -> None:
    session = simulate(SimulationSpec(plan=PRESETS["iso230_2"], seed=1)).session
    declared = {axis: ends for axis, ends in session.description.machine.travel.items() if axis.lower() != "x"}
    declared |= {} if travel is None else {"x": travel}
    machine = session.description.machine.model_copy(update={"travel": declared})
    description = session.description.model_copy(update={"machine": machine, "trust_units": True})
    observations = build_model(replace(session, description=description))[0].observations
    assert observations.span("x") == pytest.approx(span)
