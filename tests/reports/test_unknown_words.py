"""Names of unknowns in words."""

from __future__ import annotations

import pytest

from machine_tool_calibration.effects.catalogue import catalogue
from machine_tool_calibration.methods.identify import build_model
from machine_tool_calibration.reports.unknowns import POINTS, in_map, unknown_in_words, unknowns_in_words
from machine_tool_calibration.simulation import PRESETS, SimulationSpec, simulate

PLANS = ["tracking_2d", "step_diagonal", "rotary_axis", "probing_cross", "grid_plate", "iso230_2"]


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("Z.offset_1", "zero of Z, repeat 1"),
        ("npp_yzx.tilt_2", "tilt of the mirror in npp_yzx"),
        ("A.x", "place of A"),
        ("A.dead_path", "distance at which A reads zero"),
        ("A.P.0.dead_path", "distance at which A.P reads zero"),
        ("plate.turn_c", "how plate lies on the machine"),
        ("X.offset", "offset of X"),
        ("EXX(0.08)", "error motion EXX"),
        ("angle.EBX", "error motion EBX"),
        ("C0Y", "squareness C0Y"),
        ("my_lag.b", "effect my_lag"),
        ("strange", "strange"),
    ],
)
def test_one_unknown(name: str, words: str) -> None:
    assert unknown_in_words(name, ["my_lag"]) == words


def test_several_of_a_kind_are_told_together() -> None:
    assert unknowns_in_words(["Z.offset_1", "Z.offset_0", "X.offset_0"]) == "zero of each run of X and Z"
    assert unknowns_in_words(["EXX", "EYY", "C0Y"]) == "error motion EXX and EYY and squareness C0Y"
    assert "points of the map" in unknowns_in_words([POINTS])


@pytest.mark.parametrize("plan", PLANS)
def test_every_unknown_of_every_method_has_words(plan: str) -> None:
    model, _ = build_model(simulate(SimulationSpec(plan=PRESETS[plan], seed=3)).session)
    for parameter in model.parameters:
        assert unknown_in_words(parameter.name) != parameter.name
        assert in_map(parameter.name) == parameter.shared or parameter.name.startswith(("EXC", "EYC", "ECC", "angle."))


@pytest.mark.parametrize("plan", PLANS)
def test_every_coefficient_of_the_catalogue_has_a_meaning(plan: str) -> None:
    observations = build_model(simulate(SimulationSpec(plan=PRESETS[plan], seed=3)).session)[0].observations
    for effect in catalogue().values():
        if effect.why_not(observations) is None:
            meanings = effect.meanings(observations)
            assert meanings and all(meanings.values()), effect.id
            assert all(name.startswith(f"{effect.id}.") for name in meanings)
