# SPDX-License-Identifier: Apache-2.0
"""`mtcal compare`: words, tables, JSON, pictures and the readings behind them.
`mtcal compare-maps` with effects and a history: a corrected map can be compared.
"""

import re
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from machine_tool_calibration.cli.main import run
from machine_tool_calibration.session.folder import write_session
from machine_tool_calibration.simulation import PRESETS, FlawSpec, RotaryPlan, SimulationSpec, simulate

from ..told import Verb

DATA = Path(__file__).parents[1] / "data"
SESSION = str(DATA / "tracking_2d")
PICTURES = ("measured_predicted.png", "residuals.png", "residual_map.png", "setups.png")


@pytest.mark.long
@pytest.mark.parametrize("method", ["tracking_2d", "rotary_axis", "probing_cross"])
def test_words_tables_pictures_and_readings(method: str, tmp_path: Path, verb: Verb) -> None:
    out = verb("compare", DATA / method, "--output", tmp_path / "new").out
    assert re.match(r"The model fits the readings (nearly )?within their declared uncertainty", out)
    for title in ("Setups, worst first", "Straight lines over time", "Single readings, worst first"):
        assert title in out
    assert "nan" not in out
    for name in PICTURES:
        assert (tmp_path / "new" / name).read_bytes().startswith(b"\x89PNG")
    table = pd.read_csv(tmp_path / "new" / "comparison.csv", comment="#")
    document = verb("compare", DATA / method, "--json").document
    assert len(table) == document["readings"]
    assert np.sqrt(np.mean(table.residual**2)) == pytest.approx(document["rms_residual"])
    assert {"row", "setup", "repeat", "measured", "predicted", "studentized", "temperature_air"} <= set(table.columns)


@pytest.mark.long
def test_residuals_are_drawn_against_the_columns_asked_for(tmp_path: Path) -> None:
    assert run(["compare", SESSION, "--against", "path", "--against", "temperature_x", "-o", str(tmp_path)]) == 0
    assert (tmp_path / "residuals.png").is_file()


@pytest.fixture(scope="module")
def pair(tmp_path_factory: pytest.TempPathFactory) -> tuple[str, str]:
    """One machine measured with a backlash of Y, and by another instrument after it was taken out."""
    folder = tmp_path_factory.mktemp("maps")
    plan = PRESETS["tracking_2d"]
    effects = (FlawSpec(id="backlash_y", size=4e-6),)
    for name, spec in (
        ("before", SimulationSpec(plan=plan, seed=3, effects=effects)),
        ("after", SimulationSpec(plan=plan, seed=3)),
    ):
        write_session(simulate(spec).session, folder / name)
    return str(folder / "before"), str(folder / "after")


@pytest.mark.long
def test_an_effect_in_the_model_takes_its_part_out_of_the_difference(pair: tuple[str, str], verb: Verb) -> None:
    found = []
    for more in ([], ["--effect", "backlash_y"]):
        found.append(verb("compare-maps", *pair, "--json", *more).document)
    assert "backlash_y" in found[1]["provenance"][0]["effects"]
    raw, corrected = (float(np.nanstd(np.array(one["difference"], dtype=float))) for one in found)
    assert corrected < 0.5 * raw and found[1]["agree"]


@pytest.mark.long
def test_the_history_of_one_is_taken_and_the_other_named(pair: tuple[str, str], verb: Verb) -> None:
    assert "no model was tried yet" in verb.refused("compare-maps", *pair, "--from-history")
    verb("improve", pair[0])
    shown = verb("compare-maps", *pair, "--from-history", "--json")
    assert shown.document["provenance"][0]["effects"] == ["backlash_y"]
    assert f"{pair[1]}: no model was tried yet; its method's own is compared" in shown.err


def test_an_effect_that_neither_can_have_is_refused(pair: tuple[str, str], verb: Verb) -> None:
    said = verb.refused("compare-maps", *pair, "--effect", "backlash_c")
    assert "neither measurement can have the effect backlash_c" in said


@pytest.mark.parametrize("axis", ["A", "B"])
def test_the_other_rotary_axes_are_compared_in_their_own_units(axis: str, tmp_path: Path, verb: Verb) -> None:
    write_session(simulate(SimulationSpec(plan=RotaryPlan(axis=axis), seed=1)).session, tmp_path / "s")
    out = verb("compare", tmp_path / "s").out
    assert re.search(rf"^{axis.lower()} +\d.* °", out, re.MULTILINE)
    assert re.search(rf"^{axis.lower()} +\d+ / \d+ .* µrad", out, re.MULTILINE)
