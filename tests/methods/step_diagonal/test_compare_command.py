# SPDX-License-Identifier: Apache-2.0
"""`mtcal compare-formulations`."""

import json
import re
from pathlib import Path

import pytest

from machine_tool_calibration.cli.main import run
from machine_tool_calibration.methods.step_diagonal import compare
from machine_tool_calibration.session.folder import write_session
from machine_tool_calibration.simulation import PRESETS, SimulationSpec, simulate

EXAMPLE = Path(__file__).parents[2] / "data" / "step_diagonal"


@pytest.fixture(scope="module")
def found():
    """Formulations of sessions that a command has compared, by where the session is."""
    return {}


@pytest.fixture(autouse=True)
def compared_once(found, monkeypatch):
    def once(session, compare_formulations=compare.compare_formulations):
        key = session.source
        if key not in found:
            found[key] = compare_formulations(session)
        return found[key]

    monkeypatch.setattr(compare, "compare_formulations", once)


def test_table_for_people(capsys):
    assert run(["compare-formulations", str(EXAMPLE)]) == 0
    out = capsys.readouterr().out
    for text in (
        "EXX over 120 mm",
        "EYX straightness",
        "C0Y squareness X-Y",
        "Eqs. (6)",
        "from the new one",
        "µrad in ppp",
    ):
        assert text in out


def test_json_for_programs_and_the_picture(capsys, tmp_path):
    picture = tmp_path / "profiles.png"
    assert run(["compare-formulations", str(EXAMPLE), "--json", "--plot", str(picture)]) == 0
    document = json.loads(capsys.readouterr().out)
    assert document["format"] == "mtcal-formulations/1"
    by_name = document["formulations"]
    assert set(by_name) == {"conventional", "new", "least_squares", "small_angles"}
    new, old = by_name["new"], by_name["conventional"]
    assert len(new["x"]) == len(new["x_u"]) == 13
    assert max(abs(a[2] - b[2]) for a, b in zip(new["z"], old["z"], strict=True)) > 5e-6
    assert new["squareness"]["C0Y"] == pytest.approx(
        by_name["least_squares"]["squareness"]["C0Y"], abs=5 * new["squareness"]["C0Y_u"]
    )
    assert picture.read_bytes()[:8] == b"\x89PNG\r\n\x1a\n"
    assert picture.stat().st_size > 50_000


def test_what_cannot_be_used_is_said(capsys, tmp_path, exact, without):
    write_session(without(exact(1, noise=1.0, blocks=4).session, "Z"), tmp_path / "session")
    assert run(["compare-formulations", str(tmp_path / "session"), "--plot", str(tmp_path / "p.svg")]) == 0
    out = capsys.readouterr().out
    assert "not determined" in out
    assert "new: the formulation new needs every move of its runs: no run Z" in out


def test_another_method_is_one_line(capsys, tmp_path):
    assert run(["compare-formulations", str(EXAMPLE.parent / "tracking_2d")]) == 1
    err = capsys.readouterr().err
    assert err.count("\n") == 1
    assert "tracking_interferometer session has no step diagonals" in err


def test_diagonals_in_a_plane_show_the_two_axes_that_moved(tmp_path, capsys):
    plan = PRESETS["step_diagonal"].model_copy(update={"diagonals": ("pp0", "np0"), "linear": ("x", "y"), "repeats": 1})
    write_session(simulate(SimulationSpec(plan=plan, seed=1)).session, tmp_path / "plane")
    assert run(["compare-formulations", str(tmp_path / "plane")]) == 0
    text = capsys.readouterr().out
    assert "EXY straightness" in text
    assert not re.search(r"EZZ|EZX|B0Z|not determined", text)
