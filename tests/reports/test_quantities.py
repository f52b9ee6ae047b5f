# SPDX-License-Identifier: Apache-2.0
"""Numbers with their uncertainty and unit in as many figures as both bear; names of unknowns in words."""

import math

import pytest

from machine_tool_calibration.effects.catalogue import catalogue
from machine_tool_calibration.methods.build import build_model
from machine_tool_calibration.model.model import POINTS, Kind, Parameter, dead_path_of, motion_value, place_of
from machine_tool_calibration.model.result import Estimate
from machine_tool_calibration.reports.quantities import (
    declared_words,
    duration,
    in_digits_of,
    micrometres,
    millimetres,
    of_map,
    plus_minus,
    probability,
    quantity,
    range_of,
    sizes_in_words,
    value_and_uncertainties,
)
from machine_tool_calibration.reports.unknowns import unknown_in_words, unknowns_in_words
from machine_tool_calibration.session.description import StandardUncertainty
from machine_tool_calibration.simulation import PRESETS, SimulationSpec, simulate


@pytest.mark.parametrize(
    ("value", "unit", "uncertainty", "text"),
    [
        (1.5052e-6, "m", 2.7e-8, "1.505 ± 0.054 µm"),
        (-5.859, "m", 0.1159, "-5.86 ± 0.23 m"),
        (0.00282, "m", 7e-6, "2.820 ± 0.014 mm"),
        (1.3e-5, "rad", 1.4e-7, "13.00 ± 0.28 µrad"),
        (7.4e-6, "1/K", 5e-7, "7.4 ± 1.0 µm/(m K)"),
        (1e-10, "m/s", None, "0.360 µm/h"),
        (7.8e-6, "1/m/K", 1.5e-7, "7.80 ± 0.30 ×10⁻⁶ 1/m/K"),
        (-2.5e-8, "1/m/K", None, "-25.0 ×10⁻⁹ 1/m/K"),
        (5480.0, "s", None, "91.3 min"),
        (0.0, "m", None, "0 µm"),
        (0.25, "1", 0.1, "0.25 ± 0.20"),
        (3.76e-5, "1", 4e-7, "37.60 ± 0.80 µm/m"),
        (3e-6, "m", float("inf"), "3.00 µm"),
        (2.0, "m kg", 0.0, "2.00 m kg"),
        (5e-6, "m", 3e-3, "0.0 ± 6.0 mm"),
        (0.0, "m^2", 2.7e-7, "0.00 ± 0.54 mm²"),
        (4e-10, "m^2", 2e-11, "400 ± 40 µm²"),
        (-1.72e-4, "rad", 1.64e-4, "-170 ± 330 µrad"),
        (5.06e-20, "m", None, "0 µm"),
    ],
)
def test_quantities(value: float, unit: str, uncertainty: float | None, text: str) -> None:
    assert quantity(value, unit, uncertainty) == text


def test_numbers_in_tables() -> None:
    assert micrometres(None) == "–"
    assert micrometres(2.61e-7) == "0.261"
    assert micrometres(4.23e-5) == "42.3"
    assert [probability(p) for p in (0.0, 2e-4, 0.0123, 0.5)] == ["< 1e-6", "2.0e-04", "0.012", "0.50"]
    assert [duration(s) for s in (None, 20.0, 2364.0, 7040.0)] == ["–", "20 s", "39 min", "2.0 h"]
    assert range_of(-1e-4, 1e-4, "m") == "±100 µm"
    assert range_of(0.0, 5e-5, "m") == "0 µm to 50.0 µm"


def test_a_map_has_as_many_digits_as_its_uncertainty_allows() -> None:
    assert of_map(3.317e-6, 0.729e-6) == ("3.3", "1.5") and of_map(3.317e-6, None) == ("3.32", "–")
    assert plus_minus(-4.3e-7, 0.0, 1e6) == "-0.430 ± 0" and plus_minus(7.31e-5, 1.21e-4, 1e6) == "+70 ± 240"


def test_long_distances_are_grouped() -> None:
    assert millimetres(0.230150138).replace("\u202f", " ") == "230.150 138"
    assert millimetres(-1.2345678901).replace("\u202f", " ") == "-1 234.567 890"
    assert millimetres(float("nan")) == "–"


def test_of_many_coefficients_the_most_significant_is_shown() -> None:
    few = [Estimate("warmup_x.a", 1e-6, 1e-7, "m"), Estimate("warmup_x.tau", 600.0, 60.0, "s")]
    assert sizes_in_words(few) == "a = 1.00 ± 0.20 µm, tau = 10.0 ± 2.0 min"
    many = [Estimate(f"form.s{k}", k * 1e-7, 1e-7, "m") for k in range(2, 7)]
    assert sizes_in_words(many) == "5 coefficients, s6 = 0.60 ± 0.20 µm"
    assert sizes_in_words([]) == "–"


@pytest.mark.parametrize(
    ("value", "expected"),
    [
        ((1.23456e-6, 3.4e-8, "m"), ("1.235", "0.0340", "0.068", "µm")),
        ((-0.3500141, 1.7e-6, "m"), ("-350.0141", "0.00170", "0.0034", "mm")),
        ((-3.278e-5, 4.1e-7, "rad"), ("-32.78", "0.410", "0.82", "µrad")),
        ((0.25, 0.01, "1"), ("0.250", "0.0100", "0.020", "")),
        ((12.3456e-6, 5e-7, "1/K"), ("12.3", "0.50", "1.0", "µm/(m K)")),
        ((0.0, 0.0, "m"), ("0", "0", "0", "µm")),
        ((-4e-9, 1.2e-6, "m"), ("0.0", "1.20", "2.4", "µm")),
        ((1e-9, 5e-10, "m/s"), ("3.6", "1.80", "3.6", "µm/h")),
        ((4e-6, 6.4e-7, "m", True), ("0.0040", "0.00064", "0.0013", "mm")),
    ],
)
def test_digits_that_the_uncertainty_bears(value, expected):
    assert value_and_uncertainties(*value) == expected


@pytest.mark.parametrize(
    ("value", "uncertainty", "unit"),
    [(-5.859, 0.118, "m"), (1.502e-6, 3.8e-8, "m"), (3360.0, 1410.0, "s"), (-1.38, 0.16, "1"), (-0.4e-9, 1e-6, "m")],
)
def test_a_table_shows_what_a_sentence_says(value: float, uncertainty: float, unit: str) -> None:
    number, _, expanded, shown = value_and_uncertainties(value, uncertainty, unit)
    assert f"{number} ± {expanded} {shown}".strip() == quantity(value, unit, uncertainty)


def test_a_length_has_the_same_figures_in_a_table_and_in_a_sentence() -> None:
    for length in (1.024e-6, 7.79e-8, 33.58e-6):
        assert quantity(length, "m") == f"{micrometres(length)} µm"


def test_a_declared_uncertainty_is_said_in_full() -> None:
    said = StandardUncertainty.model_validate({"displacement": 3e-7})
    assert declared_words(said) == "0.300 µm"
    said = StandardUncertainty.model_validate(
        {"displacement": 3e-7, "per_length": 1e-6, "setups": {"B": {"displacement": 1e-6}}}
    )
    assert declared_words(said) == "0.300 µm + 1.00 µm/m of the path; B: 1.00 µm"


def test_u_has_a_figure_more_than_the_expanded_one_so_that_both_fit() -> None:
    assert value_and_uncertainties(20.4e-6, 0.53e-6, "rad") == ("20.4", "0.53", "1.1", "µrad")
    assert value_and_uncertainties(0.31e-6, 0.064e-6, "m") == ("0.31", "0.064", "0.13", "µm")
    told = in_digits_of(2.66, 2.66), in_digits_of(2.66, 1.33, 1), in_digits_of(math.nan, 1.0)
    assert told == ("2.7", "1.33", "1.00")


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
