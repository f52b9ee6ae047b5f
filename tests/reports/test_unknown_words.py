# SPDX-License-Identifier: Apache-2.0
"""Names of unknowns in words."""

import pytest

from machine_tool_calibration.effects.catalogue import catalogue
from machine_tool_calibration.methods.build import build_model
from machine_tool_calibration.model.model import POINTS, Kind, Parameter, dead_path_of, motion_value, place_of
from machine_tool_calibration.reports.unknowns import unknown_in_words, unknowns_in_words
from machine_tool_calibration.simulation import PRESETS, SimulationSpec, simulate

PLANS = ["tracking_2d", "step_diagonal", "rotary_axis", "probing_cross", "grid_plate", "iso230_2"]


UNKNOWNS = {
    "zero of Z, repeat 1": Parameter("Z.offset_1", "m", kind=Kind.RUN_OFFSET, owner="Z", at=1),
    "tilt of the mirror in npp_yzx": Parameter("npp_yzx.tilt_2", "rad", kind=Kind.TILT, owner="npp_yzx"),
    "place of A": place_of("A", "x", 0.1),
    "distance at which A reads zero": dead_path_of("A", 0.2),
    "distance at which A.P reads zero": dead_path_of("A.P", 0.2, 0),
    "how plate lies on the machine": Parameter("plate.turn_c", "rad", kind=Kind.MOUNTING, owner="plate"),
    "offset of X": Parameter("X.offset", "m", kind=Kind.OFFSET, owner="X"),
    "error motion EXX": motion_value("EXX", 0.08, "m"),
    "error motion EBX": motion_value("EBX", 0.08, "rad", prefix="angle."),
    "squareness C0Y": Parameter("C0Y", "rad", kind=Kind.SQUARENESS, owner="C0Y"),
    "effect my_lag": Parameter("my_lag.b", "m", kind=Kind.EFFECT, owner="my_lag"),
    "effect my_lag in session a.2": Parameter("a.2/my_lag.b", "m", kind=Kind.EFFECT, owner="my_lag", session="a.2"),
    "offset of a.2/X": Parameter("a.2/X.offset", "m", kind=Kind.OFFSET, owner="X", session="a.2"),
    "strange": Parameter("strange", "1"),
}


@pytest.mark.parametrize("words", UNKNOWNS)
def test_one_unknown(words: str) -> None:
    assert unknown_in_words(UNKNOWNS[words]) == words


def test_names_say_owner_and_place() -> None:
    assert dead_path_of("A.P", 0.2, 0).name == "A.P.0.dead_path"
    assert motion_value("EBX", 0.08, "rad", prefix="angle.").name == "angle.EBX(0.08)"
    assert motion_value("ECC", "C1", "rad").name == "ECC(C1)"
    third = motion_value("EXC", 1 / 3, "m")
    assert (third.name, third.at, third.family) == ("EXC(0.333333)", 0.333333, "EXC")


def test_several_of_a_kind_are_told_together() -> None:
    zeros = [Parameter("", "m", kind=Kind.RUN_OFFSET, owner=owner, at=k) for owner, k in (("Z", 1), ("Z", 0), ("X", 0))]
    assert unknowns_in_words(zeros) == "zero of each run of X and Z"
    motions = [motion_value("EXX", 0.1, "m"), motion_value("EYY", 0.1, "m"), UNKNOWNS["squareness C0Y"]]
    assert unknowns_in_words(motions) == "error motion EXX and EYY and squareness C0Y"
    assert "points of the map" in unknowns_in_words([POINTS])


@pytest.mark.parametrize("plan", PLANS)
def test_every_unknown_of_every_method_has_words(plan: str) -> None:
    model, _ = build_model(simulate(SimulationSpec(plan=PRESETS[plan], seed=3)).session)
    for parameter in model.parameters:
        assert unknown_in_words(parameter) != parameter.name
        assert parameter.owner in parameter.name
        assert (
            parameter.in_map == parameter.shared
            or parameter.owner in ("EXC", "EYC", "ECC")
            or (parameter.family == f"angle.{parameter.owner}")
        )


@pytest.mark.parametrize("plan", PLANS)
def test_every_coefficient_of_the_catalogue_has_a_meaning(plan: str) -> None:
    observations = build_model(simulate(SimulationSpec(plan=PRESETS[plan], seed=3)).session)[0].observations
    for effect in catalogue().values():
        if effect.why_not(observations) is None:
            meanings = effect.meanings(observations)
            assert meanings and all(meanings.values()), effect.id
            assert all(name.startswith(f"{effect.id}.") for name in meanings)
