# SPDX-License-Identifier: Apache-2.0
"""What follows from a method's description, so that its record needs not say it."""

from __future__ import annotations

import pytest

from machine_tool_calibration.session.catalogue import METHODS, method_spec
from machine_tool_calibration.session.description import RotaryAxis, StepDiagonal
from machine_tool_calibration.session.session import Session
from machine_tool_calibration.simulation import PRESETS, SimulationSpec, simulate


def test_a_method_has_the_name_of_its_description_and_a_pointer_where_it_has_stations() -> None:
    assert [method_spec(name).name for name in METHODS] == list(METHODS)
    pointed = [name for name in METHODS if method_spec(name).beam_from_pointer]
    assert pointed == ["tracking_interferometer", "rotary_axis"]


def test_a_description_is_of_its_own_method_alone() -> None:
    session: Session = simulate(SimulationSpec(plan=PRESETS["rotary_axis"], seed=1)).session
    assert session.description.as_a(RotaryAxis) is session.description
    with pytest.raises(TypeError, match="a description of rotary_axis is no StepDiagonal"):
        session.description.as_a(StepDiagonal)
