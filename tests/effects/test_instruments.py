# SPDX-License-Identifier: Apache-2.0
"""Which instruments can have an effect: no beam, no dead path."""

from typing import Any, get_args

import pytest

from machine_tool_calibration.effects.catalogue import catalogue
from machine_tool_calibration.errors import ModelError, SessionError
from machine_tool_calibration.methods.build import build_model
from machine_tool_calibration.methods.identify import identify
from machine_tool_calibration.session.parse import describe
from machine_tool_calibration.session.session import Session
from machine_tool_calibration.session.values import Instrument
from machine_tool_calibration.simulation import PRESETS, DirectPlan, MachineSpec, SimulationSpec, simulate

OF_A_BEAM = {"dead_path", "refractive_index", "pointer_radial_error", "pointer_zero_offset", "pointer_axis_offset",
             "retroreflector_form"}  # fmt: skip
BEAMS = {"laser_interferometer", "tracking_interferometer", "laser_tracker"}


def positioning(**plan: Any) -> Session:
    """An ISO 230-2 run in air whose temperature, pressure and humidity were recorded."""
    session = simulate(
        SimulationSpec(plan=DirectPlan(repeats=3, **plan), seed=3, machine=MachineSpec(random=None))
    ).session
    assert {"temperature_air", "air_pressure", "relative_humidity"} <= set(session.readings.columns)
    return session


def possible(session: Session) -> set[str]:
    observations = build_model(session)[0].observations
    return {name for name, effect in catalogue().items() if effect.why_not(observations) is None}


@pytest.mark.parametrize("instrument", get_args(Instrument))
def test_effects_of_air_and_beam_need_a_beam(instrument: str) -> None:
    found = possible(positioning(instrument=instrument))
    expected = {"dead_path", "refractive_index"} if instrument in BEAMS else set()
    assert found & OF_A_BEAM == expected
    assert {"backlash_x", "linear_drift", "lost_motion_x"} <= found


def test_a_session_that_does_not_say_what_read_has_no_effect_of_a_beam() -> None:
    """However much of the air was recorded."""
    session = positioning(kind="points", points=tuple((x, 0.0, 0.0) for x in (0.0, 0.1, 0.2)), datum="offset")
    assert session.instrument is None
    assert not possible(session) & OF_A_BEAM
    with pytest.raises(ModelError, match=r"does not say what read \(instrument: laser_interferometer or"):
        identify(session, effects=["dead_path"])
    with pytest.raises(ModelError, match="refractive_index: does not occur with instrument micro_switch"):
        identify(positioning(instrument="micro_switch"), effects=["refractive_index"])


@pytest.mark.parametrize(
    ("preset", "instrument"),
    [
        ("step_diagonal", "laser_interferometer"),
        ("tracking_2d", "tracking_interferometer"),
        ("rotary_axis", "laser_tracker"),
        ("probing_cross", "touch_probe"),
        ("iso230_2", "laser_interferometer"),
        ("straightness", "straightedge"),
        ("grid_plate", "grid_encoder"),
        ("drilled_plate", "cmm"),
    ],
)
def test_every_method_has_its_instrument(preset: str, instrument: str) -> None:
    assert simulate(SimulationSpec(plan=PRESETS[preset], seed=1)).session.instrument == instrument


def test_an_unknown_instrument_is_one_line() -> None:
    content = {
        "format": "mtcal-session/1",
        "method": "direct",
        "instrument": "ruler",
        "machine": {"chain": "w-b-X-t"},
        "standard_uncertainty": {"displacement": 1e-6},
        "setups": [{"id": "run"}],
    }
    with pytest.raises(SessionError, match="instrument") as caught:
        describe(content, "session.yaml")
    assert "\n" not in str(caught.value) and "touch_probe" in str(caught.value)
