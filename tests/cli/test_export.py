# SPDX-License-Identifier: Apache-2.0
"""`mtcal export` as it is called."""

import json
import shutil
from pathlib import Path

import pytest

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


@pytest.mark.usefixtures("found_once")
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


def test_what_has_no_tables_is_refused(tmp_path: Path, verb: Verb) -> None:
    folder = tmp_path / "none"
    assert verb("export", SESSION, "--format", "csv", "--model", "free", "-o", folder, status=1).err.count("\n") == 1
    assert not folder.exists()


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
