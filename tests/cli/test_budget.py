# SPDX-License-Identifier: Apache-2.0
"""`mtcal budget` and `mtcal conformity`: tables, JSON, picture, and one line for what is wrong."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from machine_tool_calibration.session.folder import write_session
from machine_tool_calibration.simulation import PRESETS, SimulationSpec, simulate

from ..told import Verb

DATA = Path(__file__).parents[1] / "data"
TRACKING = str(DATA / "tracking_2d")
MINE = """format: mtcal-budget/1
contributors:
- {name: touch, type: B, half_width: 2.0e-6, distribution: rectangular, enters: reading, varies: reading}
- name: scale
  symbol: u_2
  type: A
  standard_uncertainty: 5.0e-6
  degrees_of_freedom: 4
  enters: length
  varies: never
"""


@pytest.fixture(scope="module")
def line(tmp_path_factory: pytest.TempPathFactory) -> str:
    """A run along X after ISO 230-2."""
    folder = tmp_path_factory.mktemp("budget") / "line"
    write_session(simulate(SimulationSpec(plan=PRESETS["iso230_2"], seed=5)).session, folder)
    return str(folder)


@pytest.fixture
def mine(tmp_path: Path) -> str:
    """A budget of two lines."""
    path = tmp_path / "mine.yaml"
    path.write_text(MINE, encoding="utf-8")
    return str(path)


def test_a_template_can_be_used(tmp_path: Path, line: str, verb: Verb) -> None:
    text = verb("budget", "--template", "laser_interferometer").out
    path = tmp_path / "template.yaml"
    path.write_text(text, encoding="utf-8")
    own = verb("budget", line, "--budget", path, "--json").document
    assert verb("budget", line, "--json").document == own


def test_the_document_adds_up(line: str, mine: str, verb: Verb) -> None:
    document = verb("budget", line, "--budget", mine, "--quantity", "EXX", "--draws", "100", "--json").document
    assert document["format"] == "mtcal-budget-result/1"
    assert [c["name"] for c in document["contributors"]] == ["touch", "scale", "repeatability of the runs"]
    (exx,) = document["quantities"]
    squares = sum(part["standard_uncertainty"] ** 2 for part in exx["contributions"])
    assert exx["standard_uncertainty"] ** 2 == pytest.approx(squares)
    assert sum(part["share"] for part in exx["contributions"]) == pytest.approx(1.0)
    assert exx["expanded_uncertainty"] == pytest.approx(exx["coverage_factor"] * exx["standard_uncertainty"])
    # 5 µm/m over 0.4 m, and a mean of ten touches of 2 / sqrt(3) µm.
    assert exx["standard_uncertainty"] == pytest.approx(((2.0e-6) ** 2 + (2.0e-6) ** 2 / 3 / 10) ** 0.5)
    assert 4.0 < exx["effective_degrees_of_freedom"] < 5.0
    low, high = exx["monte_carlo"]["interval"]
    assert low < 0.0 < high
    assert document["draws"] == 100


@pytest.mark.parametrize("width", [60, 100])
def test_tables_fit_the_screen(width: int, line: str, mine: str, verb: Verb, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", str(width))
    out = verb("budget", line, "--budget", mine).out
    assert max(len(row) for row in out.splitlines()) <= width
    for text in ("u_2 scale", "combined standard", "effective degrees of", "A_X", "repeatability", "rectangular"):
        assert text in out
    assert "nan" not in out


@pytest.mark.long
def test_the_picture_is_written(line: str, mine: str, tmp_path: Path, verb: Verb) -> None:
    told = verb("budget", line, "--budget", mine, "--plot", tmp_path / "who.png")
    assert str(tmp_path / "who.png") in told.err.replace("\n", "")
    assert (tmp_path / "who.png").read_bytes().startswith(b"\x89PNG")
    verb("budget", line, "--budget", mine, "--plot", tmp_path / "new")
    assert (tmp_path / "new" / "budget.png").stat().st_size > 10_000


def test_conformity_in_words_and_for_programs(line: str, mine: str, verb: Verb) -> None:
    asked = ["conformity", line, "--tolerance", "EXX=20um", "--tolerance", "C0Y=20urad", "--tolerance", "A_X=1um"]
    out = verb(*asked).out
    assert "All together: fail." in out
    assert "not determined" in out
    document = verb(*asked, "--json", "--rule", "shared-risk", "--budget", mine).document
    assert (document["rule"], document["uncertainty"]) == ("simple", "budget")
    assert [f["decision"] for f in document["figures"]] == ["pass", "not determined", "fail"]
    assert document["figures"][1]["probability"] is None


def test_conformity_says_what_is_suspicious(tmp_path: Path, verb: Verb) -> None:
    session = simulate(SimulationSpec(plan=PRESETS["iso230_2"], seed=5)).session
    zero = np.zeros(len(session.readings))
    write_session(session.with_readings(replace(session.readings, displacement=zero)), tmp_path / "zero")
    asked = ["conformity", tmp_path / "zero", "--tolerance", "EXX=5um"]
    assert "suspicious: all 110 readings are 0" in verb(*asked).out
    assert "all 110 readings are 0" in verb(*asked, "--json").document["suspicious"][0]


def test_a_file_and_the_command_line_together(line: str, tmp_path: Path, verb: Verb) -> None:
    path = tmp_path / "t.yaml"
    path.write_text("format: mtcal-tolerances/1\ntolerances: {EXX: 20 um, M: 20 um}\n", encoding="utf-8")
    document = verb("conformity", line, "--tolerances", path, "--tolerance", "EXX=1um", "--json").document
    figures = {f["name"]: f for f in document["figures"]}
    assert figures["EXX"]["tolerance"] == pytest.approx(1e-6)
    assert (figures["EXX"]["decision"], figures["M_X"]["decision"]) == ("fail", "pass")
