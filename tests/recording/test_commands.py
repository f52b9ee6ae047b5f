# SPDX-License-Identifier: Apache-2.0
"""mtcal info, recover and convert, as people and programs meet them."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from machine_tool_calibration.cli.main import run
from machine_tool_calibration.errors import RecordingError
from machine_tool_calibration.recording.cdr import NUMBERS, encode, part
from machine_tool_calibration.recording.reader import BagReader
from machine_tool_calibration.recording.session_bag import session_to_bag
from machine_tool_calibration.recording.tables import save_tables
from machine_tool_calibration.recording.writer import BagWriter
from machine_tool_calibration.session.folder import read_session

DATA = Path(__file__).parents[1] / "data"


def ask(capsys: pytest.CaptureFixture[str], *words: object, status: int = 0) -> str:
    assert run([str(word) for word in words]) == status
    captured = capsys.readouterr()
    if status:
        assert len(captured.err.strip().splitlines()) == 1
        return captured.err.removeprefix("mtcal: ").strip()
    return captured.out


@pytest.fixture
def session_bag(tmp_path: Path) -> Path:
    session_to_bag(read_session(DATA / "rotary_axis"), tmp_path / "bag", start=1_700_000_000_000_000_000)
    return tmp_path / "bag"


def test_info_of_a_session(capsys: pytest.CaptureFixture[str]) -> None:
    text = ask(capsys, "info", DATA / "rotary_axis")
    assert "rotary axis, machine w-C-b-t" in text
    assert "216 readings in 56 min, 0 missing, 3 targets; declared standard uncertainty 0.270 µm" in text
    document = json.loads(ask(capsys, "info", DATA / "rotary_axis", "--json"))
    assert document["format"] == "mtcal-info/1"
    assert document["kind"] == "session"
    measurement = document["measurement"]
    assert (measurement["method"], measurement["readings"], measurement["missing"]) == ("rotary_axis", 216, 0)
    assert [setup["readings"] for setup in measurement["setups"]] == [54] * 4
    assert measurement["problem"] is None
    assert measurement["description"]["targets"][0]["id"] == "P"
    ranges = {column["name"]: (column["low"], column["high"]) for column in measurement["columns"]}
    assert ranges["time"] == (0.0, 3345.0)


def test_info_of_a_recording(capsys: pytest.CaptureFixture[str], session_bag: Path) -> None:
    text = ask(capsys, "info", session_bag)
    assert "recording, 1 file" in text
    assert "217 messages in 3345.0 s, from 2023-11-14 22:13:20+00:00" in text
    assert "/reading" in text
    assert "216 readings" in text
    document = json.loads(ask(capsys, "info", session_bag, "--json"))
    assert document["bag"]["messages"] == 217
    assert document["measurement"]["readings"] == 216


def test_info_of_a_recording_without_a_measurement(
    capsys: pytest.CaptureFixture[str], small_bag: Callable[..., Path]
) -> None:
    path = small_bag()
    assert "No measurement in it" in ask(capsys, "info", path)
    document = json.loads(ask(capsys, "info", path, "--json"))
    assert document["measurement"] is None
    assert {topic["name"]: topic["messages"] for topic in document["bag"]["topics"]}["/text"] == 1


def test_info_of_what_cannot_be_identified(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    (tmp_path / "session.yaml").write_text((DATA / "tracking_2d" / "session.yaml").read_text())
    lines = (DATA / "tracking_2d" / "observations.csv").read_text().splitlines()
    (tmp_path / "observations.csv").write_text(
        "\n".join(line for line in lines if not any(f",{station}," in line for station in "BCD"))
    )
    assert run(["info", str(tmp_path)]) == 1
    captured = capsys.readouterr()
    assert "72 readings" in captured.out
    assert captured.err == (
        f"mtcal: {tmp_path}: 1 station; tracking_interferometer in 2 dimensions needs at least 2 "
        "(no reading from B, C, D)\n"
    )


def test_wrong_requests(capsys: pytest.CaptureFixture[str], session_bag: Path, tmp_path: Path) -> None:
    assert ask(capsys, "info", tmp_path / "x", status=1) == f"{tmp_path}/x: no such file or folder"
    (tmp_path / "empty").mkdir()
    assert "neither a session" in ask(capsys, "info", tmp_path / "empty", status=1)
    assert run(["info", str(session_bag), "--topic", "reading"]) == 2
    capsys.readouterr()
    assert "unknown role" in ask(capsys, "info", session_bag, "--topic", "what=/reading", status=1)
    assert "is not empty" in ask(capsys, "convert", DATA / "rotary_axis", session_bag, status=1)
    assert "no such file" in ask(capsys, "convert", tmp_path / "x", tmp_path / "y", status=1)
    assert run(["convert", str(session_bag), str(tmp_path / "a.csv"), "--to", "parquet"]) == 2


def test_an_unfinished_recording_names_the_way_out(capsys: pytest.CaptureFixture[str], session_bag: Path) -> None:
    (session_bag / "metadata.yaml").unlink()
    file = session_bag / "bag_0.mcap"
    file.write_bytes(file.read_bytes()[:-100])
    said = ask(capsys, "info", session_bag, status=1)
    assert f"`mtcal recover {session_bag}` makes it whole" in said
    document = json.loads(ask(capsys, "recover", session_bag, "--json"))
    assert document["messages"] == 217
    assert document["bag"] == f"{session_bag}_recovered"
    assert "216 readings" in ask(capsys, "info", document["bag"])
    assert "217 messages of 2 topics" in ask(capsys, "recover", session_bag, "-o", f"{session_bag}_2")


def test_there_and_back(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    source = DATA / "probing_cross"
    document = json.loads(ask(capsys, "convert", source, tmp_path / "bag", "--namespace", "/cell", "--json"))
    assert document["to"] == "bag"
    assert document["readings"] == 368
    ask(capsys, "convert", tmp_path / "bag", tmp_path / "session")
    one, other = read_session(source), read_session(tmp_path / "session")
    assert one.description == other.description
    assert one.readings.displacement.tobytes() == other.readings.displacement.tobytes()


@pytest.mark.parametrize("form", ["csv", "parquet"])
def test_readings_as_a_table(capsys: pytest.CaptureFixture[str], session_bag: Path, tmp_path: Path, form: str) -> None:
    read = {"csv": pd.read_csv, "parquet": pd.read_parquet}[form]
    session = read_session(DATA / "rotary_axis")
    for number, source in enumerate((session_bag, DATA / "rotary_axis")):
        ask(capsys, "convert", source, tmp_path / f"{number}.{form}")
        table = read(tmp_path / f"{number}.{form}")
        assert list(table["target"]) == list(session.readings.labels["target"])
        assert np.array_equal(table["displacement"], session.readings.displacement)
        assert list(table.columns[:4]) == ["time", "setup", "repeat", "target"]


@pytest.mark.parametrize("form", ["csv", "parquet"])
def test_topics_as_tables(
    capsys: pytest.CaptureFixture[str], small_bag: Callable[..., Path], tmp_path: Path, form: str
) -> None:
    read = {"csv": pd.read_csv, "parquet": pd.read_parquet}[form]
    path = small_bag()
    document = json.loads(ask(capsys, "convert", path, tmp_path / "tables", "--to", form, "--json"))
    assert set(document["topics"]) == {"/text", "/cell/joint_states", "/instrument/displacement"}
    states = read(tmp_path / "tables" / f"cell.joint_states.{form}")
    messages = list(BagReader(path).messages(["/cell/joint_states"]))
    assert list(states["log_time"]) == [message.log_time for message in messages]
    assert set(states.columns) == {"log_time", "publish_time", "stamp", "frame_id", "x", "y"}
    samples = read(tmp_path / "tables" / f"instrument.displacement.{form}")
    assert len(samples) == 500
    assert list(samples.columns[2:]) == ["time", "displacement"]
    assert list(read(tmp_path / "tables" / f"text.{form}")["data"]) == ["héllo"]
    assert not list((tmp_path / "tables").glob("*.part"))


def test_topics_as_tables_say_how_far_they_are(
    small_bag: Callable[..., Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("machine_tool_calibration.recording.tables._ROWS", 20)
    told: list[tuple[str, float]] = []
    save_tables(BagReader(small_bag()), tmp_path / "tables", "csv", lambda what, share: told.append((what, share)))
    topics = list(dict.fromkeys(what for what, _ in told))
    assert topics == ["/cell/joint_states", "/instrument/displacement", "/text"]
    shares = [share for _, share in told]
    assert shares == sorted(shares) and shares[0] == 0.0 and shares[-1] == 100 / 101
    assert told[1] == ("/cell/joint_states", 20 / 101)


def test_a_bag_that_is_given_as_the_present_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    session_to_bag(read_session(DATA / "tracking_2d"), tmp_path / "bag")
    monkeypatch.chdir(tmp_path / "bag")
    assert run(["recover", "."]) == 0
    assert (tmp_path / "bag_recovered" / "metadata.yaml").exists()


def test_a_bag_without_a_name(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["recover", "/"]) == 1
    assert "has no name" in capsys.readouterr().err


def test_lists_of_messages_and_unnamed_samples_become_columns(tmp_path: Path) -> None:
    diagnostics = "diagnostic_msgs/msg/DiagnosticArray"
    header = part("std_msgs/msg/Header", part("builtin_interfaces/msg/Time", 7, 5), "machine")
    entry = part("diagnostic_msgs/msg/KeyValue", "state", "µ")
    status = part("diagnostic_msgs/msg/DiagnosticStatus", 1, "axes", "moving", "none", [entry])
    layout = part("std_msgs/msg/MultiArrayLayout", [], 0)
    with BagWriter(tmp_path / "bag") as bag:
        bag.add_topic("/diagnostics", diagnostics)
        bag.add_topic("/samples", NUMBERS)
        bag.write("/diagnostics", encode(diagnostics, header, [status]), 10)
        bag.write("/samples", encode(NUMBERS, layout, np.array([1.5, 2.5])), 20)
    files, skipped = save_tables(BagReader(tmp_path / "bag"), tmp_path / "tables", "csv")
    assert not skipped
    (told,) = pd.read_csv(files["/diagnostics"]).to_dict("records")
    assert (told["header.stamp.sec"], told["header.frame_id"]) == (7, "machine")
    assert json.loads(told["status"]) == [
        {"level": 1, "name": "axes", "message": "moving", "hardware_id": "none",
         "values": [{"key": "state", "value": "µ"}]},
    ]  # fmt: skip
    assert pd.read_csv(files["/samples"])["data"].tolist() == [1.5, 2.5]


def test_tables_are_not_written_among_other_files(session_bag: Path, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("kept")
    for folder, said in ((tmp_path, "is not empty"), (tmp_path / "file", "cannot be made: File exists")):
        with pytest.raises(RecordingError, match=said):
            save_tables(BagReader(session_bag), folder, "csv")
    assert (tmp_path / "file").read_text() == "kept"
