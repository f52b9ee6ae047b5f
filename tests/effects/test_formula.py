# SPDX-License-Identifier: Apache-2.0
"""Formulas of a user's own: parsed, checked, and worth as much as the built-in effects.
The page docs/adding_an_effect.md, executed from top to bottom.
"""

import json
import re
import shlex
import tomllib
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
import yaml

from machine_tool_calibration.cli.main import run
from machine_tool_calibration.effects import catalogue as registry
from machine_tool_calibration.effects.catalogue import catalogue
from machine_tool_calibration.effects.formula import FormulaEffect, parse, read_effects
from machine_tool_calibration.errors import CalibrationError, ModelError
from machine_tool_calibration.methods.build import build_model
from machine_tool_calibration.recording.open import open_measurement
from machine_tool_calibration.simulation import PRESETS, SimulationSpec, simulate

SETTLING = {
    "id": "settling_y",
    "enters": "y",
    "formula": "b * dir_y * exp(-time / tau)",
    "coefficients": {"b": {"unit": "m", "low": -1e-5, "high": 1e-5}},
    "shapes": {"tau": {"unit": "s", "low": 10, "high": 1e4}},
}


def test_an_effect_is_called_by_its_title_or_else_by_its_id() -> None:
    assert FormulaEffect(SETTLING).title == FormulaEffect(SETTLING).id == "settling_y"
    assert FormulaEffect(SETTLING | {"title": "column that settles"}).title == "column that settles"
    assert FormulaEffect(SETTLING).kind == "position"
    assert FormulaEffect(SETTLING | {"enters": "reading"}).formula.startswith("reading = b * dir_y")


def test_it_needs_the_columns_of_its_formula_and_nothing_else() -> None:
    """Its coefficients, shapes and constants are its own; the path is there without a column."""
    wave = {
        **SETTLING,
        "formula": "b * dir_y * exp(-time / tau) * (1 + c * path * sin(2 * pi * y / lead))",
        "constants": {"c": {"unit": "1/m", "value": 0.1}, "lead": {"unit": "m", "value": 0.02}},
    }
    effect = FormulaEffect(wave)
    assert effect.needs == ("dir_y", "time", "y")
    assert effect.covariates == ("dir_y", "path", "time", "y")


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("-a**2*3 + 4/2/2 - 1", -27.0),
        ("2**-1", 0.5),
        ("2**3**2", 512.0),
        ("a*-b", -6.0),
        ("(1+2)*(3-4)^2", 3.0),
        ("sqrt(abs(-a))*sign(-b)", -np.sqrt(3.0)),
        ("1e-3*exp(log(b))", 2e-3),
        ("(" * 60 + "lambda" + ")" * 60, 7.0),
    ],
)
def test_a_formula_has_the_value_of_ordinary_algebra(text: str, value: float) -> None:
    assert parse(text).evaluate({"a": 3.0, "b": 2.0, "lambda": 7.0}) == pytest.approx(value, rel=1e-14)


@pytest.mark.parametrize(
    "text",
    [
        "__import__('os')",
        "a b",
        "a +",
        "x.y",
        "lambda: 1",
        "a[0]",
        "a; b",
        "",
        "open('f')",
        "(" * 260 + "a" + ")" * 260,
        "a, b",
        "a if b else a",
        "sin(a, b)",
        "a(b)",
        "2j * a",
        "a // b",
        "1" + "0" * 400,
        "-" * 900 + "a",
        "a" + "**-" * 300 + "2",
        "+".join("a" * 450),
        "a+" * 800,
    ],
)
def test_what_is_not_a_formula_is_refused_in_one_line(text: str) -> None:
    with pytest.raises(ModelError) as caught:
        parse(text)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"formula": "b * x * exp(-time / tau)"}, "not a length"),
        ({"formula": "b * dir_y * exp(-time) * tau / tau"}, "a quantity in second where one in dimensionless must be"),
        ({"formula": "b * b * dir_y * exp(-time / tau) / x"}, "not linear in b"),
        ({"formula": "b * dir_y * exp(-time / tau) + 2e-6"}, "with b at zero the formula must be zero"),
        ({"formula": "b * dir_y * exp(-time / tau) + 1e-12"}, "give that part a coefficient too"),
        ({"formula": "b * dir_y * exp(-time / tau) + c"}, "here c, dir_y, time, are columns of the session"),
        ({"formula": "b * (time + x) * exp(-time / tau)"}, "a quantity in second where one in meter"),
        ({"formula": "b * dir_y"}, "does not hold the coefficient 'tau'"),
        ({"formula": "b * 0 * dir_y * exp(-time / tau)"}, "the formula is zero whatever b is"),
        ({"formula": "b * dir_y * exp(-time / tau) +"}, "not understood at character 31; numbers, names, + - * /"),
        ({"enters": "ECQ"}, "must be x, y, z, reading, or an error motion by ISO 230-1"),
        ({"enters": "ECC"}, "the formula gives m, and not an angle"),
        ({"enters": "q"}, "enters"),
        ({"colour": "red"}, "colour"),
        ({"coefficients": {"b": {"unit": "m", "low": 1e-5, "high": -1e-5}}}, "low to high, not 1e-05 to -1e-05"),
        ({"coefficients": {"b": {"unit": "m", "low": 0, "high": 1e308}}}, "too large"),
        ({"shapes": {"tau": {"unit": "s", "low": 5e-324, "high": 1}}}, "too small"),
        ({"coefficients": {"b": {"unit": "furlongs per", "low": 0, "high": 1}}}, "unknown unit"),
        ({"coefficients": {"b": {"unit": "m**9**9**9**9", "low": 0, "high": 1}}}, "unknown unit"),
        ({"coefficients": {"b": {"unit": "9**9**9**9", "low": 0, "high": 1}}}, "unknown unit"),
        ({"coefficients": {"b": {"unit": "m" * 5000, "low": 0, "high": 1}}}, "unknown unit"),
        ({"coefficients": {"b": {"unit": "(m", "low": 0, "high": 1}}}, "unknown unit '(m'"),
        ({"constants": {"t0": {"value": 68, "unit": "degF"}}}, "t0 is in degF, which has another zero than degC"),
        (
            {"formula": "b * dir_y * exp(-(time - t0) / tau)", "constants": {"t0": {"value": 5}}},
            "t0 states no unit and counts as a pure number: constants: {t0: {value: 5.0, unit: m}}",
        ),
        (
            {"formula": "b * exp(-time / tau) * sin(x / 0.01)", "constants": {"t0": {"value": 5}}},
            "where one in radian must be; a number in the formula has no unit, a constant may: constants: {k:",
        ),
    ],
)
def test_a_wrong_definition_says_what_is_wrong(change: dict[str, object], says: str) -> None:
    with pytest.raises(ModelError, match=re.escape(says)) as caught:
        FormulaEffect(SETTLING | change)
    assert "\n" not in str(caught.value)


def test_another_unit_than_one_of_si_is_converted() -> None:
    """In millimetres and minutes, an effect has the same columns and limits."""
    session = simulate(SimulationSpec(plan=PRESETS["tracking_2d"], seed=2)).session
    columns = session.readings.columns | {"gauge": 2e-3 * session.readings.column("dir_y")}
    metres = build_model(session.with_readings(replace(session.readings, columns=columns)))[0].observations
    in_mm = session.readings.columns | {"gauge": 2.0 * session.readings.column("dir_y")}
    millimetres = build_model(session.with_readings(replace(session.readings, columns=in_mm)))[0].observations
    formula = {"formula": "b * gauge / length * exp(-time / tau)"}
    plain = FormulaEffect(SETTLING | formula | {"constants": {"length": {"value": 2e-3, "unit": "m"}}})
    other = FormulaEffect(
        SETTLING
        | formula
        | {
            "coefficients": {"b": {"unit": "mm", "low": -1e-2, "high": 1e-2}},
            "shapes": {"tau": {"unit": "min", "low": 1 / 6, "high": 1e4 / 60}},
            "constants": {"length": {"value": 2.0, "unit": "mm"}},
            "columns": {"gauge": "mm"},
        }
    )
    for mine, theirs in zip((*plain.coefficients, *plain.shapes), (*other.coefficients, *other.shapes), strict=True):
        assert mine.unit == theirs.unit
        assert (theirs.low, theirs.high) == pytest.approx((mine.low, mine.high))
    np.testing.assert_allclose(other.columns(millimetres, (60.0,)), plain.columns(metres, (60.0,)), rtol=1e-12)
    with pytest.raises(ModelError, match="y is in m in every session, not in mm"):
        FormulaEffect(SETTLING | {"columns": {"y": "mm"}})


@pytest.mark.parametrize("unit", ["degC", "K"])
def test_temperatures_in_degrees_celsius_count_in_kelvin(unit: str) -> None:
    constant = {
        "formula": "b * (temperature_y - t0) / t0 * exp(-time / tau)",
        "constants": {"t0": {"value": 20, "unit": unit}},
    }
    assert FormulaEffect(SETTLING | constant)._constants["t0"] == 20.0


@pytest.mark.parametrize("formula", ["b **", "b" * 2000, "b * (time + x) * exp(-time / tau)", "b * dir_y"])
def test_a_wrong_formula_in_a_file_names_the_file_the_line_and_the_effect(tmp_path: Path, formula: str) -> None:
    file = tmp_path / "own.yaml"
    file.write_text("# mine\n" + yaml.safe_dump({"effects": [SETTLING | {"formula": formula}]}))
    with pytest.raises(ModelError) as caught:
        read_effects(file)
    assert str(caught.value).startswith(f"{file} line 3: effect {SETTLING['id']}: ")
    assert str(caught.value).count(f"effect {SETTLING['id']}") == 1


def test_a_formula_that_is_zero_nearly_everywhere_is_one() -> None:
    for window in ("abs(x - 9) + x - 9", "x * (1 + sign(x - 0.30)) * (1 - sign(x - 0.30001))"):
        FormulaEffect(SETTLING | {"formula": f"b * exp(-time / tau) * ({window}) / x"})


def test_the_example_file_is_read_and_damage_is_told(tmp_path: Path) -> None:
    example = Path(__file__).parents[2] / "config" / "effects" / "example.yaml"
    assert [effect.id for effect in read_effects(example)] == ["cubic_path", "settling_y"]
    for text in ("effects: [", "a: 1", "effects: 3", "effects: [!!python/object/apply:os.system [x]]", "[" * 5000):
        bad = tmp_path / "bad.yaml"
        bad.write_text(text)
        with pytest.raises(CalibrationError, match=str(bad)):
            read_effects(bad)
    with pytest.raises(CalibrationError, match="no such file"):
        read_effects(tmp_path / "none.yaml")


@pytest.mark.parametrize(
    ("preset", "enters", "formula", "same"),
    [
        ("tracking_2d", "y", "-b * dir_y", "backlash_y"),
        ("rotary_axis", "ECC", "-b * dir_c", "backlash_c"),
        ("rotary_axis", "EBC", "b * time", "rotary_axis_drift.wb"),
        ("rotary_axis", "EXC", "b * time", "rotary_axis_drift.vx"),
        ("tracking_3d", "ECX", "-b * dir_x", "reversal_ECX"),
    ],
)
def test_a_formula_equals_the_built_in_effect_that_it_spells_out(
    preset: str, enters: str, formula: str, same: str
) -> None:
    observations = build_model(simulate(SimulationSpec(plan=PRESETS[preset], seed=3)).session)[0].observations
    length = enters == "y" or enters[1] not in "ABC"
    rate = {"unit": ("m" if length else "1") + ("/s" if "time" in formula else ""), "low": -1, "high": 1}
    mine = FormulaEffect({"id": "mine", "enters": enters, "formula": formula, "coefficients": {"b": rate}})
    assert mine.why_not(observations) is None
    name, _, coefficient = same.partition(".")
    known = catalogue()[name]
    names = [c.name for c in known.coefficients_for(observations)]
    expected = known.columns(observations)[names.index(coefficient) if coefficient else 0]
    assert np.abs(expected).max() > 0.01
    np.testing.assert_allclose(mine.columns(observations)[0], expected, rtol=1e-12, atol=1e-15)


def test_of_an_axis_that_is_not_there_nothing_is_sensed() -> None:
    observations = build_model(simulate(SimulationSpec(plan=PRESETS["rotary_axis"], seed=3)).session)[0].observations
    angle = {"id": "mine", "formula": "b * time", "coefficients": {"b": {"unit": "1/s", "low": -1, "high": 1}}}
    assert not FormulaEffect(angle | {"enters": "ECA"}).columns(observations).any()
    assert FormulaEffect(angle | {"enters": "ECX"}).why_not(observations) == "the chain has no axis X"


def test_a_coefficient_without_a_column_does_not_make_the_grid_finer() -> None:
    """Of a term with x where nothing was read beside x = 0 all values are alike."""
    observations = build_model(simulate(SimulationSpec(plan=PRESETS["tracking_2d"], seed=3)).session)[0].observations
    plain = FormulaEffect(SETTLING).shape_grid(observations)
    both = {**SETTLING["coefficients"], "c": {"unit": "1", "low": -1, "high": 1}}  # type: ignore[dict-item]
    effect = FormulaEffect(SETTLING | {"formula": "b * dir_y * exp(-time / tau) + c * x", "coefficients": both})
    columns = observations.readings.columns
    readings = replace(observations.readings, columns=columns | {"x": 0.0 * columns["x"]})
    assert effect.shape_grid(replace(observations, readings=readings)) == plain


def test_a_wave_with_a_node_at_every_place_ends_the_search_for_its_periods() -> None:
    """At 20 mm its sine is rounding at multiples of 40 mm, and no two columns of it are alike."""
    observations = build_model(simulate(SimulationSpec(plan=PRESETS["iso230_2"], seed=3)).session)[0].observations
    at = 0.04 * np.round(observations.readings.columns["x"] / 0.04)
    placed = replace(observations.readings, columns=observations.readings.columns | {"x": at})
    for shape, formula in (
        ({"low": 0.02, "high": 0.2}, "2 * pi * x / l"),
        ({"low": -50, "high": 50}, "2 * pi * x * l"),
    ):
        unit = "m" if shape["low"] > 0 else "1/m"
        wave = {"id": "wave", "enters": "x", "formula": f"b * sin({formula})", "coefficients": SETTLING["coefficients"]}
        effect = FormulaEffect(wave | {"shapes": {"l": shape | {"unit": unit}}})
        assert 12 <= len(effect.shape_grid(replace(observations, readings=placed))) < 300


def test_an_id_of_the_catalogue_cannot_be_taken() -> None:
    mine = FormulaEffect(SETTLING | {"id": "backlash_y"})
    with pytest.raises(ModelError, match="in the catalogue already"):
        catalogue([mine])


PAGE = Path(__file__).parents[2] / "docs" / "adding_an_effect.md"


@dataclass(frozen=True)
class Blocks:
    """The fenced blocks of the page, by language and in order."""

    yaml: list[str]
    python: list[str]
    toml: list[str]
    sh: list[str]


@pytest.fixture(scope="module")
def blocks() -> Blocks:
    found: dict[str, list[str]] = {"yaml": [], "python": [], "toml": [], "sh": []}
    for language, text in re.findall(r"^```(\w+)\n(.*?)^```$", PAGE.read_text(encoding="utf-8"), re.M | re.S):
        found[language].append(text)
    return Blocks(**found)


@pytest.fixture
def measured(blocks: Blocks, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with the page's YAML file and the measurement that its first Python block makes."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "my_effects.yaml").write_text(blocks.yaml[0])
    exec(compile(blocks.python[0], str(PAGE), "exec"), {})
    return tmp_path / "measured"


@pytest.fixture
def plugin(blocks: Blocks, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """The page's package, as if it were installed."""
    site = tmp_path / "site"
    announced = tomllib.loads(blocks.toml[0])["project"]
    info = site / f"{announced['name'].replace('-', '_')}-{announced['version']}.dist-info"
    info.mkdir(parents=True)
    (info / "METADATA").write_text(f"Name: {announced['name']}\nVersion: {announced['version']}\n")
    groups = announced["entry-points"].items()
    lines = [f"[{group}]\n" + "\n".join(f"{k} = {v}" for k, v in points.items()) for group, points in groups]
    (info / "entry_points.txt").write_text("\n".join(lines))
    (site / "my_effects.py").write_text(blocks.python[1])
    monkeypatch.syspath_prepend(str(site))
    registry._plugins.cache_clear()
    yield
    registry._plugins.cache_clear()


def commands(block: str) -> list[list[str]]:
    return [shlex.split(line)[1:] for line in block.splitlines()]


@pytest.mark.long
def test_the_formula_is_found_added_and_fits(
    blocks: Blocks, measured: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    said = []
    for words in commands(blocks.sh[0] + blocks.sh[1]):
        assert run(words) == 0
        said.append(" ".join(capsys.readouterr().out.split()))
    page, before, diagnosis, identified, after = said
    assert "e_y = b * dir_y * exp(-time / tau)" in page
    assert {p.name for p in (measured.parent / "pictures").iterdir()} == {"creep_y.png", "README.md"}
    assert "times their declared uncertainty" in before
    assert re.match(r"The model lacks [^.]* \(creep_y\)\.", diagnosis)
    assert "creep_y.b" in identified
    assert after.startswith("The model fits the readings within their declared uncertainty")

    assert run([*commands(blocks.sh[1])[2], "--json"]) == 0
    parameters = {p["name"]: p for p in json.loads(capsys.readouterr().out)["parameters"]}
    for name, truth in (("creep_y.b", 4e-6), ("creep_y.tau", 1500.0)):
        assert abs(parameters[name]["value"] - truth) < 4 * parameters[name]["standard_uncertainty"]


@pytest.mark.usefixtures("plugin")
def test_the_class_is_found_as_a_plugin_and_says_the_same_as_the_formula(
    blocks: Blocks, measured: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for words in commands(blocks.sh[2]):
        assert run(words) == 0
        assert "creep_of_y" in capsys.readouterr().out
    observations = build_model(open_measurement(measured))[0].observations
    by_class = catalogue()["creep_of_y"]
    by_formula = read_effects(measured.parent / "my_effects.yaml")[0]
    for tau in (200.0, 3000.0):
        np.testing.assert_allclose(
            by_class.columns(observations, (tau,)), by_formula.columns(observations, (tau,)), rtol=1e-12
        )


def test_the_page_names_the_entry_point_group_and_all_keys(blocks: Blocks) -> None:
    from machine_tool_calibration.effects.formula import _Definition

    assert list(tomllib.loads(blocks.toml[0])["project"]["entry-points"]) == [registry.ENTRY_POINT_GROUP]
    # the folder of the page also holds the measurement and the pictures: setuptools would take these for packages
    assert tomllib.loads(blocks.toml[0])["tool"]["setuptools"]["py-modules"] == ["my_effects"]
    text = PAGE.read_text(encoding="utf-8")
    for key in set(_Definition.model_fields) - {"title", "source"}:
        assert f"`{key}`" in text
