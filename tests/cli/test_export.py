# SPDX-License-Identifier: Apache-2.0
"""`mtcal export` as it is called.
What `mtcal export` says of effects that are in the model: in the tables, or in the errors that are left.
`mtcal export` warns of a model that does not fit, and of a better one that it did not use.
"""

import json
import shutil
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from machine_tool_calibration.cli.export import bad_fit
from machine_tool_calibration.cli.main import run
from machine_tool_calibration.session.folder import write_session
from machine_tool_calibration.simulation import PRESETS, FlawSpec, SimulationSpec, simulate

from ..again import measured_again
from ..told import Verb

SESSION = Path(__file__).parents[1] / "data" / "tracking_2d"


def test_json_names_files_and_preview(tmp_path: Path, verb: Verb) -> None:
    folder = tmp_path / "new" / "tables"
    document = verb("export", SESSION, "--format", "isg", "-o", folder, "--json").document
    assert document["files"] == ["compensation.csv"] and (folder / "compensation.csv").is_file()
    assert document["model"] == "rigid_body" and "EXX" in document["tables"] and document["worse"] is False
    length = document["preview"][-1]
    assert length["name"] == "length" and length["rms_after"] < 0.01 * length["rms_before"]


def test_people_see_before_and_after(tmp_path: Path, verb: Verb) -> None:
    shown = verb("export", SESSION, "--format", "linuxcnc", "-o", tmp_path)
    assert "RMS left" in shown.out and "x.comp" in shown.out
    assert "not determined: EZX" in shown.err and "into the sections [JOINT_n]" in shown.err
    reasons = [line.split(": ", 2)[2] for line in shown.err.splitlines() if line.startswith("not determined")]
    assert len(set(reasons)) == len(reasons)


@pytest.mark.long
def test_effects_of_the_history(backlash: Path, tmp_path: Path, verb: Verb) -> None:
    session, folder = shutil.copytree(backlash, tmp_path / "session"), tmp_path / "tables"
    call = ["export", str(session), "--format", "json", "-o", str(folder), "--from-history"]
    assert "no model was tried yet" in verb.refused(*call)
    verb(*call, "--effect", "backlash_y", status=2)
    verb("improve", session, "--json")
    shown = verb(*call, "--json")
    assert "with backlash_y, as in model 2 of the history" in shown.err
    assert shown.document["model"] == "rigid_body"
    same = tmp_path / "same"
    verb("export", session, "--format", "json", "-o", same, "--effect", "backlash_y")
    assert (same / "compensation.json").read_text() == (folder / "compensation.json").read_text()


def test_nothing_is_overwritten(tmp_path: Path, verb: Verb) -> None:
    (tmp_path / "compensation.json").write_text("mine")
    assert "is there already" in verb.refused("export", SESSION, "--format", "json", "-o", tmp_path)
    assert (tmp_path / "compensation.json").read_text() == "mine"


def iso_run(folder: Path, name: str, offset: str) -> Path:
    """A positioning run of X, and beside it another one that a plate would show."""
    folder = folder / name
    folder.mkdir()
    (folder / "session.yaml").write_text(
        "format: mtcal-session/1\nmethod: direct\ndatum: offset\nterms: [EXX]\n"
        "machine: {chain: w-Y-X-b-Z-t}\nstandard_uncertainty: {displacement: 2e-7}\nsetups: [{id: run}]\n"
    )
    rows = [f"run,{r},{i / 20},1,0,0,{1e-6 * i + (i % 3) * 2e-7 + float(offset)}" for r in range(2) for i in range(11)]
    (folder / "observations.csv").write_text("setup,repeat,x,gx,gy,gz,displacement\n" + "\n".join(rows) + "\n")
    return folder


def test_several_sessions_together(tmp_path: Path, verb: Verb) -> None:
    one, other = iso_run(tmp_path, "a", "0"), iso_run(tmp_path, "b", "3e-6")
    out = tmp_path / "tables"
    captured = verb("export", one, other, "--format", "json", "-o", out, "--json")
    document = captured.document
    assert document["model"] == ["rigid_body", "rigid_body"] and document["tables"] == ["EXX"]
    assert document["worse"] is False
    assert "agree" in captured.err
    table = json.loads((out / "compensation.json").read_text())
    assert f"measurement: {one} + {other}" in table["remarks"]
    assert table["tables"]["EXX"]["deviation"][10] == pytest.approx(1e-5 + 2e-7 * (10 % 3), abs=1e-9)
    for form in ("linuxcnc", "linuxcnc-trims", "siemens", "fanuc", "isg", "etalon", "csv"):
        folder = tmp_path / form
        assert "RMS left" in verb("export", one, other, "--format", form, "-o", folder).out


def test_sessions_without_tables_are_refused(tmp_path: Path, verb: Verb) -> None:
    rotary = str(SESSION.parent / "rotary_axis")
    again = str(measured_again(rotary, tmp_path / "again"))
    captured = verb("export", rotary, again, "--format", "csv", "-o", tmp_path / "t", status=1).err
    assert "no tables of error motions" in captured
    assert not (tmp_path / "t").exists()


def test_the_picture_of_what_is_left(tmp_path: Path, verb: Verb) -> None:
    folder = tmp_path / "tables"
    call = ["export", str(SESSION), "--format", "siemens", "--plot", "-o", str(folder), "--json"]
    document = verb(*call).document
    picture = folder / "what_is_left.png"
    assert document["pictures"] == [str(picture)] and picture.stat().st_size > 10_000
    # squareness is the slope of a straightness table, an angle is in none
    assert document["not_in_tables"] == ["ECY"]
    for name in document["files"]:
        (folder / name).unlink()
    assert "what_is_left.png: is there already" in verb.refused(*call)
    assert [path.name for path in folder.iterdir()] == ["what_is_left.png"]


HALF = 2e-6


@pytest.fixture(scope="module")
def plane(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("export") / "plane"
    spec = SimulationSpec(plan=PRESETS["tracking_2d"], seed=4, effects=(FlawSpec(id="backlash_y", size=HALF),))
    write_session(simulate(spec).session, folder)
    return folder


def exported(sessions: list[Path], form: str, effect: str, folder: Path, verb: Verb) -> dict[str, Any]:
    words = ["export", *map(str, sessions), "--format", form, "--effect", effect, "-o", str(folder), "--json"]
    document: dict[str, Any] = verb(*words).document
    return document


@pytest.mark.parametrize("form", ["isg", "etalon"])
def test_backlash_that_the_format_cannot_hold_is_left(form: str, plane: Path, tmp_path: Path, verb: Verb) -> None:
    document = exported([plane], form, "backlash_y", tmp_path / "o", verb)
    assert document["not_in_tables"] == ["backlash_y"]
    left = {row["name"]: row for row in document["preview"]}
    assert left["y"]["rms_after"] == pytest.approx(HALF, rel=0.05)
    assert left["y"]["rms_before"] > left["y"]["rms_after"]
    assert left["x"]["rms_after"] < 1e-8


@pytest.mark.parametrize("form", ["csv", "json"])
def test_backlash_in_the_tables_is_compensated(form: str, plane: Path, tmp_path: Path, verb: Verb) -> None:
    document = exported([plane], form, "backlash_y", tmp_path / "o", verb)
    assert document["not_in_tables"] == []
    assert document["preview"][-1]["rms_before"] > HALF
    assert document["preview"][-1]["largest_after"] < 1e-9


def test_people_read_what_is_missing(plane: Path, tmp_path: Path, verb: Verb) -> None:
    words = ["export", str(plane), "--format", "isg", "--effect", "backlash_y", "-o", str(tmp_path / "o")]
    assert "In the model and not in these files: backlash_y." in verb(*words).out
    assert "not in these files" not in verb(*words[:4], "-o", tmp_path / "p").out


BAD = "something is missing in it, or the declared uncertainty is too small"
BETTER = "holds a better model, number 2, with backlash_y"


@pytest.fixture(scope="module")
def session(backlash: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return Path(shutil.copytree(backlash, tmp_path_factory.mktemp("warned") / "plane"))


@pytest.fixture(scope="module")
def improved(session: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = Path(shutil.copytree(session, tmp_path_factory.mktemp("improved") / "plane"))
    assert run(["improve", str(folder), "-o", str(folder.parent / "out")]) == 0
    return folder


def warned(words: list[str], verb: Verb) -> list[str]:
    lines = verb("export", *words).err.splitlines()
    return [line for line in lines if line.startswith(("warning", "note"))]


def test_a_bad_fit(session: Path, tmp_path: Path, verb: Verb) -> None:
    (line,) = warned([str(session), "--format", "isg", "-o", str(tmp_path / "a")], verb)
    assert line.startswith("warning: The readings scatter")
    assert BAD in line
    assert warned([str(session), "--format", "isg", "-o", str(tmp_path / "b"), "--effect", "backlash_y"], verb) == []
    shown = verb("export", session, "--format", "isg", "-o", tmp_path / "c", "--json")
    document = shown.document
    assert BAD in shown.err
    assert document["reduced_chi_square"] > 10.0
    assert document["p_value"] < 1e-3


def test_runs_whose_directions_agree_are_no_bad_fit() -> None:
    """Of what is read either way, the reversal is no misfit of the map."""
    scatter = {"declared": 3e-7, "found": 2e-6, "uncertainties_from": "scatter", "factor": 6.0}
    fit: Any = SimpleNamespace(p_value=1e-12, reduced_chi_square=40.0)
    assert "scatter" in str(bad_fit(fit, {"scatter": scatter, "position_error_u": [[1e-6, None, None]]}))
    agreeing = scatter | {"one_direction": 3e-7, "one_direction_p_value": 0.4}
    assert bad_fit(fit, {"scatter": agreeing, "position_error_u": [[1e-6, None, None]]}) is None


@pytest.mark.parametrize("effects", [[], ["--effect", "backlash_x"]])
def test_a_reversal_that_the_tables_lack_is_told(effects: list[str], tmp_path: Path, verb: Verb) -> None:
    flaw = FlawSpec(id="backlash_x", size=5e-6)
    measured = simulate(SimulationSpec(plan=PRESETS["iso230_2"], seed=4, effects=(flaw,))).session
    write_session(measured, tmp_path / "x")
    told = warned([str(tmp_path / "x"), "--format", "linuxcnc", "-o", str(tmp_path / "out"), *effects], verb)
    assert any("both directions differ by a reversal error" in line for line in told) is not bool(effects)


@pytest.mark.long
def test_a_better_model_that_is_known(improved: Path, tmp_path: Path, verb: Verb) -> None:
    words = [str(improved), "--format", "isg", "-o"]
    bad, better = warned([*words, str(tmp_path / "a")], verb)
    assert BAD in bad
    assert BETTER in better and better.endswith("it was not used: --from-history does")
    assert warned([*words, str(tmp_path / "b"), "--from-history"], verb) == []
    assert warned([*words, str(tmp_path / "c"), "--effect", "backlash_y"], verb) == []
    assert run(["history", str(improved), "--undo"]) == 0
    (bad,) = warned([*words, str(tmp_path / "d")], verb)
    assert BAD in bad
    assert run(["history", str(improved), "--use", "2"]) == 0


@pytest.mark.long
def test_conformity_and_budget_are_those_of_the_model_in_use(improved: Path, verb: Verb) -> None:
    asked = ["conformity", str(improved), "--tolerance", "volumetric=100um", "--json"]
    shown = verb(*asked)
    plain = shown.document
    assert BETTER in shown.err and "--from-history does" in shown.err
    shown = verb(*asked, "--from-history")
    assert BETTER not in shown.err
    used = shown.document
    assert used["figures"] == verb(*asked, "--effect", "backlash_y").document["figures"] != plain["figures"]


def test_a_damaged_history_stops_nothing(session: Path, tmp_path: Path, verb: Verb) -> None:
    (session / "history.yaml").write_text("models: [")
    try:
        words = [str(session), "--format", "isg", "-o", str(tmp_path / "a"), "--effect", "backlash_y"]
        (line,) = warned(words, verb)
    finally:
        (session / "history.yaml").unlink()
    assert line.startswith(f"warning: {session / 'history.yaml'}")
