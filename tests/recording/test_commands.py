# SPDX-License-Identifier: Apache-2.0
"""mtcal info, recover and convert, as people and programs meet them."""

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from machine_tool_calibration.errors import RecordingError
from machine_tool_calibration.recording.cdr import NUMBERS, encode, part
from machine_tool_calibration.recording.reader import BagReader
from machine_tool_calibration.recording.session_bag import session_to_bag
from machine_tool_calibration.recording.tables import save_tables
from machine_tool_calibration.recording.writer import BagWriter
from machine_tool_calibration.session.folder import read_session

from ..told import Verb

DATA = Path(__file__).parents[1] / "data"


@pytest.fixture
def session_bag(tmp_path: Path) -> Path:
    session_to_bag(read_session(DATA / "rotary_axis"), tmp_path / "bag", start=1_700_000_000_000_000_000)
    return tmp_path / "bag"


def test_info_of_a_session(verb: Verb) -> None:
    text = verb("info", DATA / "rotary_axis").out
    assert "rotary axis, machine w-C-b-t" in text
    assert "216 readings in 56 min, 0 missing, 3 targets; declared standard uncertainty 0.270 µm" in text
    document = verb("info", DATA / "rotary_axis", "--json").document
    assert document["format"] == "mtcal-info/1"
    assert document["kind"] == "session"
    measurement = document["measurement"]
    assert (measurement["method"], measurement["readings"], measurement["missing"]) == ("rotary_axis", 216, 0)
    assert [setup["readings"] for setup in measurement["setups"]] == [54] * 4
    assert measurement["problem"] is None
    assert measurement["description"]["targets"][0]["id"] == "P"
    ranges = {column["name"]: (column["low"], column["high"]) for column in measurement["columns"]}
    assert ranges["time"] == (0.0, 3345.0)


def test_info_of_a_recording(verb: Verb, session_bag: Path) -> None:
    text = verb("info", session_bag).out
    assert "recording, 1 file" in text
    assert "217 messages in 3345.0 s, from 2023-11-14 22:13:20+00:00" in text
    assert "/reading" in text
    assert "216 readings" in text
    document = verb("info", session_bag, "--json").document
    assert document["bag"]["messages"] == 217
    assert document["measurement"]["readings"] == 216


def test_info_of_a_recording_without_a_measurement(verb: Verb, small_bag: Callable[..., Path]) -> None:
    path = small_bag()
    assert "No measurement in it" in verb("info", path).out
    document = verb("info", path, "--json").document
    assert document["measurement"] is None
    assert {topic["name"]: topic["messages"] for topic in document["bag"]["topics"]}["/text"] == 1


def test_info_of_what_cannot_be_identified(verb: Verb, tmp_path: Path) -> None:
    (tmp_path / "session.yaml").write_text((DATA / "tracking_2d" / "session.yaml").read_text())
    lines = (DATA / "tracking_2d" / "observations.csv").read_text().splitlines()
    (tmp_path / "observations.csv").write_text(
        "\n".join(line for line in lines if not any(f",{station}," in line for station in "BCD"))
    )
    told = verb("info", tmp_path, status=1)
    assert "72 readings" in told.out
    assert told.err == (
        f"mtcal: {tmp_path}/observations.csv: 1 station; tracking_interferometer in 2 dimensions needs at least 2 "
        "(no reading from B, C, D)\n"
    )


def test_info_names_the_line_as_other_verbs_do(verb: Verb, tmp_path: Path) -> None:
    folder = shutil.copytree(DATA / "tracking_2d", tmp_path / "session")
    with (folder / "observations.csv").open("r+", encoding="utf-8") as file:
        lines = file.readlines()
        file.write(lines[-1])
    told = verb("info", folder, status=1)
    assert "289 readings" in told.out and "(line 290): the same reading as" in told.err
    assert told.err == verb.refused("identify", folder)


def test_wrong_requests(verb: Verb, session_bag: Path, tmp_path: Path) -> None:
    assert verb.refused("info", tmp_path / "x") == f"mtcal: {tmp_path}/x: no such file or folder\n"
    (tmp_path / "empty").mkdir()
    assert "neither a session" in verb.refused("info", tmp_path / "empty")
    (tmp_path / "run" / "session").mkdir(parents=True)
    (tmp_path / "run" / "session" / "session.yaml").touch()
    assert verb.refused("info", tmp_path / "run").endswith(f"but a session in {tmp_path}/run/session\n")
    verb("info", session_bag, "--topic", "reading", status=2)
    assert "unknown role" in verb.refused("info", session_bag, "--topic", "what=/reading")
    assert "is not empty" in verb.refused("convert", DATA / "rotary_axis", session_bag)
    assert "no such file" in verb.refused("convert", tmp_path / "x", tmp_path / "y")
    verb("convert", session_bag, tmp_path / "a.csv", "--to", "parquet", status=2)


def test_an_unfinished_recording_names_the_way_out(verb: Verb, session_bag: Path) -> None:
    (session_bag / "metadata.yaml").unlink()
    file = session_bag / "bag_0.mcap"
    file.write_bytes(file.read_bytes()[:-100])
    said = verb.refused("info", session_bag)
    assert f"`mtcal recover {session_bag}` makes it whole" in said
    document = verb("recover", session_bag, "--json").document
    assert document["messages"] == 217
    assert document["bag"] == f"{session_bag}_recovered"
    assert "216 readings" in verb("info", document["bag"]).out
    assert verb.refused("recover", session_bag).endswith("_recovered: is there already; -o names another folder\n")
    assert "217 messages of 2 topics" in verb("recover", session_bag, "-o", f"{session_bag}_2").out


@pytest.mark.parametrize("form", ["csv", "parquet"])
def test_topics_as_tables(verb: Verb, small_bag: Callable[..., Path], tmp_path: Path, form: str) -> None:
    read = {"csv": pd.read_csv, "parquet": pd.read_parquet}[form]
    path = small_bag()
    document = verb("convert", path, tmp_path / "tables", "--to", form, "--json").document
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


def test_a_bag_that_is_given_as_the_present_folder(verb: Verb, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    session_to_bag(read_session(DATA / "tracking_2d"), tmp_path / "bag")
    monkeypatch.chdir(tmp_path / "bag")
    verb("recover", ".")
    assert (tmp_path / "bag_recovered" / "metadata.yaml").exists()


def test_a_bag_without_a_name(verb: Verb) -> None:
    assert "has no name" in verb.refused("recover", "/")


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


def test_a_message_is_told_as_deep_as_its_type_goes(tmp_path: Path) -> None:
    header = part("std_msgs/msg/Header", part("builtin_interfaces/msg/Time", 7, 5), "machine")
    place, turn = (
        part("geometry_msgs/msg/Point", 1.5, 2.5, 3.5),
        part("geometry_msgs/msg/Quaternion", 0.0, 0.0, 0.0, 1.0),
    )
    pose, size = part("geometry_msgs/msg/Pose", place, turn), part("geometry_msgs/msg/Vector3", 1.0, 1.0, 1.0)
    color, life = part("std_msgs/msg/ColorRGBA", 0.0, 0.0, 0.0, 1.0), part("builtin_interfaces/msg/Duration", 0, 0)
    image = part("sensor_msgs/msg/CompressedImage", header, "", np.zeros(0, dtype=np.uint8))
    file = part("visualization_msgs/msg/MeshFile", "", np.zeros(0, dtype=np.uint8))
    look = ([], [], "", image, [], "", "", file, False)
    marker = part("visualization_msgs/msg/Marker", header, "", 0, 0, 0, pose, size, color, life, False, *look)
    control = part("visualization_msgs/msg/InteractiveMarkerControl", "", turn, 0, 0, True, [marker], False, "")
    whole = part("visualization_msgs/msg/InteractiveMarker", header, pose, "", "", 1.0, [], [control])
    update = "visualization_msgs/msg/InteractiveMarkerUpdate"
    with BagWriter(tmp_path / "bag") as bag:
        bag.add_topic("/markers", update)
        bag.write("/markers", encode(update, "server", 1, 0, [whole], [], []), 10)
    files, _ = save_tables(BagReader(tmp_path / "bag"), tmp_path / "tables", "csv")
    (told,) = json.loads(pd.read_csv(files["/markers"])["markers"][0])
    assert told["controls"][0]["markers"][0]["pose"]["position"] == {"x": 1.5, "y": 2.5, "z": 3.5}


def test_tables_are_not_written_among_other_files(session_bag: Path, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("kept")
    for folder, said in ((tmp_path, "is not empty"), (tmp_path / "file", "cannot be made: File exists")):
        with pytest.raises(RecordingError, match=said):
            save_tables(BagReader(session_bag), folder, "csv")
    assert (tmp_path / "file").read_text() == "kept"
