# SPDX-License-Identifier: Apache-2.0
"""`mtcal compare`: words, tables, JSON, pictures and the readings behind them."""

import re
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from machine_tool_calibration.cli.main import run

from ..told import Verb

DATA = Path(__file__).parents[1] / "data"
SESSION = str(DATA / "tracking_2d")
PICTURES = ("measured_predicted.png", "residuals.png", "residual_map.png", "setups.png")


@pytest.mark.parametrize("method", ["tracking_2d", "step_diagonal", "rotary_axis", "probing_cross"])
def test_the_first_sentence_says_whether_the_model_fits(method: str, verb: Verb) -> None:
    out = verb("compare", DATA / method).out
    assert re.match(r"The model fits the readings (nearly )?within their declared uncertainty", out)
    for title in ("Setups, worst first", "Straight lines over time", "Single readings, worst first"):
        assert title in out
    assert "nan" not in out


@pytest.mark.parametrize("method", ["tracking_2d", "step_diagonal", "rotary_axis", "probing_cross"])
def test_pictures_and_readings_are_written(method: str, tmp_path: Path, verb: Verb) -> None:
    document = verb("compare", DATA / method, "--output", tmp_path / "new", "--json").document
    for name in PICTURES:
        assert (tmp_path / "new" / name).read_bytes().startswith(b"\x89PNG")
    table = pd.read_csv(tmp_path / "new" / "comparison.csv", comment="#")
    assert len(table) == document["readings"]
    assert np.sqrt(np.mean(table.residual**2)) == pytest.approx(document["rms_residual"])
    assert {"row", "setup", "repeat", "measured", "predicted", "studentized", "temperature_air"} <= set(table.columns)


def test_residuals_are_drawn_against_the_columns_asked_for(tmp_path: Path) -> None:
    assert run(["compare", SESSION, "--against", "path", "--against", "temperature_x", "-o", str(tmp_path)]) == 0
    assert (tmp_path / "residuals.png").is_file()
