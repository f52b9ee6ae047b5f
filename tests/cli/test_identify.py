# SPDX-License-Identifier: Apache-2.0
"""`mtcal identify`: for people, for programs, and for what is wrong.
`mtcal diagnose` as it is called.
`mtcal report`: the file is written, with what was asked for, and a mistake is said before anything is calculated.
"""

import json
import re
import shutil
from pathlib import Path

import pandas as pd
import pytest

from machine_tool_calibration.cli.main import run
from machine_tool_calibration.session.folder import write_session
from machine_tool_calibration.simulation import PRESETS, FlawSpec, SimulationSpec, simulate

from ..told import Verb

DATA = Path(__file__).parents[1] / "data"


def test_for_people(verb):
    told = verb("identify", DATA / "tracking_2d")
    assert told.err == ""
    text = told.text
    assert "tracking interferometer in 2 dimensions, pointed open loop: 288 readings in 4 setups (A, B, C, D)" in text
    assert "The model fits the readings within their declared uncertainty (p = 0.57)." in text
    assert "position error 5.10 µm RMS, 10.84 µm at most" in text
    assert "its uncertainty U (95 %) 0.48" in text
    assert "datum: no shift and no turn of all targets" in text


def test_what_is_not_determined_has_no_number_beside_it(verb):
    told = verb("identify", DATA / "step_diagonal")
    table, lost = told.out.split("\nnot determined:")[:2]
    assert "EAX" in lost
    assert "angle.EAX" not in table and "EXX" in table


def test_a_map_in_two_directions_and_too_few_runs_are_said(verb, tmp_path):
    spec = SimulationSpec(plan=PRESETS["iso230_2"], seed=3, effects=(FlawSpec(id="backlash_x", size=3e-6),))
    session = simulate(spec).session
    write_session(session.with_readings(session.readings.select(session.readings.repeat == 0)), tmp_path / "s")
    told = verb("identify", tmp_path / "s", "--effect", "backlash_x")
    assert "22 at 11 places: one for each direction of approach" in told.text
    assert "ISO 230-2 asks for 5 runs in each direction" in told.text
    assert "repeatability and accuracy are not determined" in told.text
    told = verb("identify", tmp_path / "s")
    assert "points of the map 11 " in told.text
    written = tmp_path / "map.csv"
    told = verb("identify", tmp_path / "s", "--effect", "backlash_x", "--csv", written, "--units", "um")
    assert "x / mm y / mm z / mm approach ex / µm" in told.text and " x- " in told.out
    table = pd.read_csv(written, comment="#")
    both = table[(table["error"] == "ex") & (table["x"] == 40)].set_index("approach")
    # Twice the half width lies between the directions; U has two figures, and the value no more decimals.
    assert both.loc["x-", "value"] - both.loc["x+", "value"] == pytest.approx(6.0, abs=0.3)
    assert set(table["unit"]) == {"um"} and both["U"].round(2).equals(both["U"])
    assert both["value"].round(2).equals(both["value"])


def test_the_csv_holds_what_the_standards_ask_for(verb, tmp_path):
    write_session(simulate(SimulationSpec(plan=PRESETS["iso230_2"], seed=5)).session, tmp_path / "s")
    run = verb("identify", tmp_path / "s", "--json").document["error_map"]["iso230_2"][0]
    verb("identify", tmp_path / "s", "--csv", tmp_path / "si.csv")
    table = pd.read_csv(tmp_path / "si.csv", comment="#").set_index("error")
    for name in ("A", "R", "E_up", "B_mean", "M"):
        assert tuple(table.loc[f"{name}_X", ["value", "U"]]) == pytest.approx((run[name], run[f"{name}_U"]))
    verb("identify", tmp_path / "s", "--csv", tmp_path / "um.csv", "--units", "um")
    rows = pd.read_csv(tmp_path / "um.csv", comment="#", dtype=str).query("determined == 'True'")
    decimals = rows[["value", "U"]].map(lambda text: len(text.partition(".")[2]))
    assert (decimals["value"] == decimals["U"]).all(), "trailing zeros are figures, too"
    assert rows["value"].str.endswith("0").any()


def test_error_motions_are_tables_over_their_axes(verb):
    told = verb("identify", DATA / "tracking_2d", "--model", "rigid_body")
    assert "EXX(0.08)" not in told.out
    _, after = told.out.split("Error motions of X ± U (95 %)\n")
    head, *rows = after.splitlines()[:7]
    assert " ".join(head.split()).startswith("X / mm EXX / µm EYX / µm")
    assert [row.split()[0] for row in rows] == ["0", "80", "160", "240", "320", "400"]
    assert all(re.match(r"\s*\d+ +([-+]?[\d.]+ ± [\d.]+|0) ", row) for row in rows)
    assert "not determined: EZX, EZY, EAX, EBX" in told.text


def test_missing_readings_are_listed_by_row(verb, tmp_path):
    shutil.copytree(DATA / "tracking_2d", tmp_path / "session")
    file = tmp_path / "session" / "observations.csv"
    lines = file.read_text().splitlines()
    place = lines[0].split(",").index("displacement")
    for row in (3, 7):
        fields = lines[row + 1].split(",")
        fields[place] = ""
        lines[row + 1] = ",".join(fields)
    file.write_text("\n".join(lines) + "\n")
    told = verb("identify", tmp_path / "session")
    assert "readings used 286 of 288" in told.text
    assert "not used: rows 3, 7 (the first row is 0): the reading is missing" in told.text
    document = verb("identify", tmp_path / "session", "--json").document
    assert [entry["row"] for entry in document["rejected"]] == [3, 7]


@pytest.mark.long
def test_output_folder(verb, tmp_path):
    told = verb("identify", DATA / "tracking_2d", "-o", tmp_path / "new" / "folder")
    names = {path.name for path in (tmp_path / "new" / "folder").iterdir()}
    assert names == {"result.json", "error_map.png", "stations.png", "residuals.png"}
    assert all(name in told.out for name in names)
    document = json.loads((tmp_path / "new" / "folder" / "result.json").read_text())
    assert document == verb("identify", DATA / "tracking_2d", "--json").document


@pytest.mark.long
def test_pictures_in_the_present_folder(verb, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    verb("identify", DATA / "step_diagonal", "--plot")
    assert {path.name for path in tmp_path.iterdir()} == {"error_motions.png", "iso230_6.png", "residuals.png"}


def test_output_that_cannot_be_written(verb, tmp_path):
    (tmp_path / "file").write_text("")
    assert "cannot be written" in verb.refused("identify", DATA / "tracking_2d", "-o", tmp_path / "file" / "below")


@pytest.mark.long
def test_the_model_of_the_history(verb, backlash, tmp_path):
    session = tmp_path / "session"
    shutil.copytree(backlash, session)
    assert "no model was tried yet" in verb.refused("identify", session, "--from-history")
    verb("improve", session, "--json")
    told = verb("identify", session, "--from-history", "--json")
    assert told.err == ""
    by_history = told.document
    assert by_history["effects"] == ["backlash_y"]
    # One model, one answer: the map included.
    assert verb("identify", session, "--effect", "backlash_y", "--json").document == by_history
    verb("history", session, "--undo")
    assert verb("identify", session, "--from-history", "--json").document["effects"] == []
    verb("identify", session, "--from-history", "--effect", "scale", status=2)


@pytest.mark.long
def test_people_read_the_verdict_first(original: Path, verb: Verb) -> None:
    out = verb("diagnose", original).out
    assert out.splitlines()[0] == "The model lacks backlash of Y (backlash_y)."
    assert len(out.splitlines()) <= 24  # one screen: the verdict, the effects, the next step
    assert "b = 1.5" in out and "Next: `mtcal improve` adds backlash_y" in out
    out = verb("diagnose", original, "--details").out
    assert out.splitlines()[0] == "The model lacks backlash of Y (backlash_y)."
    for title in (
        "Effects looked for",
        "Confounded effects",
        "Smallest size",
        "not looked for",
        "the map holds already",
        "taken for",
    ):
        assert title in out
    assert max(map(len, out.splitlines())) <= 120
    assert "\x1b" not in out


@pytest.mark.long
def test_pictures_and_numbers_on_request(original: Path, tmp_path: Path, verb: Verb) -> None:
    folder = tmp_path / "new" / "pictures"
    assert "wrote" in verb("diagnose", original, "-o", folder).err
    assert (folder / "diagnosis.png").read_bytes().startswith(b"\x89PNG")
    lines = (folder / "candidates.csv").read_text().splitlines()
    lines = [line for line in lines if not line.startswith("#")]
    assert lines[0].startswith("effect,probability,p_value,delta_bic")
    assert lines[1].startswith("backlash_y,")


@pytest.fixture(scope="module")
def positioning(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run by ISO 230-2."""
    folder = tmp_path_factory.mktemp("report") / "session"
    assert run(["simulate", "--preset", "iso230_2", str(folder)]) == 0
    return folder


@pytest.mark.long
def test_a_report_is_written(positioning: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "tolerances.yaml").write_text("format: mtcal-tolerances/1\ntolerances: {EXX: 20um}\n")
    file, figures = tmp_path / "out" / "report.html", tmp_path / "figures"
    words = ["report", str(positioning), "--no-diagnosis", "--tolerances", str(tmp_path / "tolerances.yaml")]
    assert run([*words, "-o", str(file), "--figures", str(figures), "--language", "de"]) == 0
    text = file.read_text(encoding="utf-8")
    assert '<html lang="de">' in text and "Konformität" in text and "Diagnose" not in text
    assert (figures / "iso230_2_X.svg").read_text(encoding="utf-8").lstrip().startswith("<?xml")
    assert f"wrote {file}" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["-o", "report.docx"], "a report is an .html or a .pdf file"),
        (["--language", "fr"], "there is no language 'fr'"),
        (["--language", "../en"], "there is no language '../en'"),
        (["--from-history"], "no model was tried yet"),
        (["--budget", "none.yaml"], "none.yaml"),
    ],
)
def test_a_mistake_is_said_in_one_line(positioning: Path, verb: Verb, words: list[str], message: str) -> None:
    said = verb("report", positioning, *words, status=1).err.strip()
    assert message in said and "\n" not in said
