# SPDX-License-Identifier: Apache-2.0
"""A session goes into a bag and comes back, beside whatever else is in the bag."""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from machine_tool_calibration.errors import RecordingError, SessionError
from machine_tool_calibration.recording.cdr import JOINT_STATE, TEXT, decode, encode, encode_joint_state, part
from machine_tool_calibration.recording.open import open_measurement
from machine_tool_calibration.recording.reader import BagReader
from machine_tool_calibration.recording.session_bag import reading_columns, session_from_bag, session_to_bag
from machine_tool_calibration.recording.tables import save_table, save_tables, tables
from machine_tool_calibration.recording.writer import BagWriter
from machine_tool_calibration.session.checks.suspicion import suspicions
from machine_tool_calibration.session.folder import read_session, readings_frame
from machine_tool_calibration.session.parse import description_yaml, parse_description
from machine_tool_calibration.session.session import Readings, Session

DATA = Path(__file__).parents[1] / "data"
NAMES = ("tracking_2d", "rotary_axis", "step_diagonal", "probing_cross")


def assert_equal(one: Session, other: Session) -> None:
    assert one.description == other.description
    assert one.readings.displacement.tobytes() == other.readings.displacement.tobytes()
    for name in ("setup", "repeat", "row"):
        assert np.array_equal(getattr(one.readings, name), getattr(other.readings, name))
    assert set(one.readings.columns) == set(other.readings.columns)
    for name, values in one.readings.columns.items():
        assert values.tobytes() == other.readings.columns[name].tobytes(), name
    assert set(one.readings.labels) == set(other.readings.labels)
    for name, labels in one.readings.labels.items():
        assert np.array_equal(labels, other.readings.labels[name]), name


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("namespace", ["", "cell_2/left"])
def test_there_and_back(name: str, namespace: str, tmp_path: Path) -> None:
    session = read_session(DATA / name)
    session_to_bag(session, tmp_path / "bag", start=1_700_000_000_000_000_000, namespace=namespace)
    assert_equal(session, session_from_bag(tmp_path / "bag"))
    assert_equal(session, open_measurement(tmp_path / "bag"))
    assert_equal(session, open_measurement(tmp_path / "bag" / "bag_0.mcap"))


def test_readings_are_in_the_frame_of_the_machine(tmp_path: Path) -> None:
    session = read_session(DATA / "rotary_axis")
    session_to_bag(session, tmp_path / "bag")
    messages = [decode(JOINT_STATE, message.data) for message in BagReader(tmp_path / "bag").messages(["/reading"])]
    assert {message.header.frame_id for message in messages} == {"machine"}
    setups = [message.position[message.name.index("setup_index")] for message in messages]
    assert setups == session.readings.setup.tolist()


def test_missing_values_and_text_columns(tmp_path: Path) -> None:
    session = read_session(DATA / "rotary_axis")
    readings = session.readings
    displacement = readings.displacement.copy()
    displacement[[3, 9]] = np.nan
    operator = np.array([f"Änne {i % 3}" for i in range(len(readings))])
    load = np.where(np.arange(len(readings)) % 5 == 0, np.nan, np.arange(len(readings)) / 7)
    changed = session.with_readings(
        replace(
            readings,
            displacement=displacement,
            labels={**readings.labels, "operator": operator},
            columns={**readings.columns, "load": load},
        )
    )
    session_to_bag(changed, tmp_path / "bag")
    assert_equal(changed, session_from_bag(tmp_path / "bag"))


def write(bag: BagWriter, session: Session, prefix: str = "", *, rows: slice = slice(None), at: int = 0) -> None:
    names, table = reading_columns(session)
    bag.add_topic(f"{prefix}/session", TEXT)
    bag.add_topic(f"{prefix}/reading", JOINT_STATE)
    bag.write(f"{prefix}/session", encode(TEXT, description_yaml(session.description)), at)
    for setup, row in list(zip(session.readings.setup, table, strict=True))[rows]:
        at += 1
        bag.write(f"{prefix}/reading", encode_joint_state(at, session.setup_ids[setup], names, row), at)


def test_foreign_topics_are_ignored(tmp_path: Path) -> None:
    session = read_session(DATA / "tracking_2d")
    with BagWriter(tmp_path / "bag") as bag:
        bag.add_topic("/other/session", JOINT_STATE)
        bag.add_topic("/reading", TEXT)
        bag.add_topic("/joint_states", JOINT_STATE)
        bag.add_topic("/own", "own_msgs/msg/Thing")
        for i, topic in enumerate(["/other/session", "/reading", "/joint_states", "/own"]):
            bag.write(topic, b"\x00\x01\x00\x00rubbish", i)
        write(bag, session, "/cell", at=100)
    assert_equal(session, session_from_bag(tmp_path / "bag"))


def test_two_graphs_need_a_name(tmp_path: Path) -> None:
    first, second = read_session(DATA / "tracking_2d"), read_session(DATA / "step_diagonal")
    with BagWriter(tmp_path / "bag") as bag:
        write(bag, first, "/a")
        write(bag, second, "/b")
    with pytest.raises(SessionError, match=r"several measurements: /a/reading, /b/reading; say which, as in reading="):
        session_from_bag(tmp_path / "bag")
    assert_equal(second, session_from_bag(tmp_path / "bag", {"reading": "/b/reading"}))
    assert_equal(first, session_from_bag(tmp_path / "bag", {"session": "/a/session", "reading": "a/reading"}))


def test_other_names(tmp_path: Path) -> None:
    session = read_session(DATA / "tracking_2d")
    names, table = reading_columns(session)
    with BagWriter(tmp_path / "bag") as bag:
        bag.add_topic("/what", TEXT)
        bag.add_topic("/values", JOINT_STATE)
        # the description may come last
        for at, (setup, row) in enumerate(zip(session.readings.setup, table, strict=True)):
            bag.write("/values", encode_joint_state(at, session.setup_ids[setup], names, row), at)
        bag.write("/what", encode(TEXT, description_yaml(session.description)), 10_000)
    assert_equal(session, session_from_bag(tmp_path / "bag", {"session": "/what", "reading": "/values"}))
    path = tmp_path / "bag"
    for mapping, expected in (
        (None, f"{path}: no topic 'session' of type {TEXT} with messages; it holds /values, /what"),
        ({"session": "/x", "reading": "/values"}, f"{path}: no topic '/x'; it holds /values, /what"),
        ({"session": "/values"}, f"{path}: /values has the type {JOINT_STATE}, not {TEXT}"),
        ({"sessions": "/x"}, f"{path}: unknown role 'sessions' of a topic; the roles are session, reading"),
    ):
        with pytest.raises(SessionError) as caught:
            session_from_bag(path, mapping)
        assert str(caught.value) == expected


@pytest.mark.parametrize(
    ("name", "rows"),
    [
        pytest.param("step_diagonal", slice(None), id="another procedure"),
        pytest.param("tracking_2d", slice(None), id="the same procedure started again"),
        pytest.param("tracking_2d", slice(20, None), id="the description sent again, which changes nothing"),
    ],
)
def test_the_last_run_counts(name: str, rows: slice, tmp_path: Path) -> None:
    first, last = read_session(DATA / "tracking_2d"), read_session(DATA / name)
    with BagWriter(tmp_path / "bag") as bag:
        write(bag, first, rows=slice(0, 20))
        write(bag, last, rows=rows, at=1000)
    read = session_from_bag(tmp_path / "bag")
    assert_equal(last, read)
    told = "the recording holds another run before this one, of 20 readings, which is left out" in suspicions([read])
    assert told == (rows.start is None)


def damaged(tmp_path: Path, names: list[str], values: list[float]) -> str:
    session = read_session(DATA / "rotary_axis")
    with BagWriter(tmp_path / "bag") as bag:
        write(bag, session, rows=slice(0, 3))
        bag.write("/reading", encode_joint_state(9, "machine", names, np.array(values)), 10)
    with pytest.raises(SessionError) as caught:
        session_from_bag(tmp_path / "bag")
    return str(caught.value).removeprefix(f"{tmp_path}/bag ")


GOOD = ["time", "repeat", "setup_index", "target_index", "c", "displacement"]


@pytest.mark.parametrize(
    ("names", "values", "expected"),
    [
        (GOOD, [9, 0, 4, 0, 0, 0], "/reading row 3: setup_index is 4, not 0 to 3"),
        (GOOD, [9, 0, np.nan, 0, 0, 0], "/reading row 3: setup is empty; session has A, B, C, D"),
        (GOOD, [9, 0, 0, 7, 0, 0], "/reading row 3: target_index is 7, not 0 to 2"),
        (GOOD, [9, 0, 0, 0.5, 0, 0], "/reading row 3: target_index is 0.5, not 0 to 2"),
        (GOOD, [9, 0, 0, np.nan, 0, 0], "/reading row 3: target is empty; session has P, Q, K"),
        (GOOD, [9, 0.5, 0, 0, 0, 0], "/reading row 3: repeat is 0.5, not 0, 1, 2 …"),
        (GOOD, [1, 0, 0, 0, 0, 0], "/reading row 3: time runs backwards, from 6 s to 1 s"),
        (GOOD, [9, 0, 0, 0, 0, 0], "/reading: 1 station; rotary_axis needs at least 3 (no reading from B, C, D)"),
    ],
)
def test_defects(tmp_path: Path, names: list[str], values: list[float], expected: str) -> None:
    assert damaged(tmp_path, names, values) == expected


@pytest.mark.parametrize("content", [b"", b"\0\1\0\0", b"\0\1\0\0" + b"\xff" * 40])
def test_where_a_damaged_message_stands_is_said(content: bytes, tmp_path: Path) -> None:
    session = read_session(DATA / "rotary_axis")
    with BagWriter(tmp_path / "bag") as bag:
        write(bag, session, rows=slice(0, 3))
        bag.write("/reading", content, 10)
    with pytest.raises(RecordingError, match=r"bag: /reading at 10 ns: a sensor_msgs/msg/JointState is damaged: "):
        session_from_bag(tmp_path / "bag")


def test_a_damaged_description(tmp_path: Path) -> None:
    session = read_session(DATA / "tracking_2d")
    with BagWriter(tmp_path / "bag") as bag:
        bag.add_topic("/session", TEXT)
        bag.add_topic("/reading", JOINT_STATE)
        bag.write("/session", encode(TEXT, description_yaml(session.description).replace("repeats", "repeatz")), 0)
        bag.write("/reading", encode_joint_state(1, "machine", GOOD, np.zeros(len(GOOD))), 1)
    with pytest.raises(SessionError) as caught:
        session_from_bag(tmp_path / "bag")
    assert str(caught.value) == (f"{tmp_path}/bag /session line 9: unknown key 'repeatz' (did you mean 'repeats'?)")


def test_what_no_node_takes_spoils_no_recording(tmp_path: Path) -> None:
    """A text that describes nothing, and messages that are no readings, among those of a measurement."""
    session = read_session(DATA / "tracking_2d")
    with BagWriter(tmp_path / "bag") as bag:
        bag.add_topic("/session", TEXT)
        bag.add_topic("/reading", JOINT_STATE)
        bag.write("/session", encode(TEXT, ""), 0)
        bag.write("/reading", encode_joint_state(1, "machine", ["setup_index"], np.array([1e9])), 1)
        write(bag, session, at=1)
        bag.write("/session", encode(TEXT, "{}"), 900)
        for names, count in ((["displacement"], 1), (GOOD, 5), ([*GOOD, "c"], 7)):
            bag.write("/reading", encode_joint_state(901, "machine", names, np.zeros(count)), 901)
    read = session_from_bag(tmp_path / "bag")
    assert_equal(session, read)
    n, why = len(session.readings), ("it has no setup_index", "6 names and 5 values", "a name stands twice in time")
    assert all(f"/reading row {n}: {one}" in told for one, told in zip(why, read.no_readings[1:], strict=True))
    assert any(told.startswith("4 messages among the readings are none") for told in suspicions([read]))
    with BagWriter(tmp_path / "none") as bag:
        write(bag, session, rows=slice(0, 0))
        bag.write("/reading", encode_joint_state(1, "machine", ["setup_index"], np.array([0.0])), 1)
    with pytest.raises(SessionError, match=r"/reading row 0: it has no displacement$"):
        session_from_bag(tmp_path / "none")


def test_neither_session_nor_recording(tmp_path: Path) -> None:
    for path, expected in (
        (
            tmp_path,
            "neither a session (session.yaml, observations.csv) nor a recording (metadata.yaml, .mcap) is in "
            "this folder",
        ),
        (tmp_path / "x", "no such file or folder"),
        (Path(__file__), "is neither a session folder nor a recording (.mcap)"),
    ):
        with pytest.raises(SessionError) as caught:
            open_measurement(path)
        assert str(caught.value) == f"{path}: {expected}"


def test_nothing_is_left_of_tables_of_which_one_cannot_be_ended(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "bag") as bag:
        bag.add_topic("/a", TEXT)
        bag.add_topic("/b", TEXT)
        bag.write("/a", encode(TEXT, "whole"), 1)
        bag.write("/b", b"\x00\x01\x00\x00rubbish", 2)
    with pytest.raises(RecordingError, match="/b at 2 ns"):
        save_tables(BagReader(tmp_path / "bag"), tmp_path / "tables", "csv")
    assert not list((tmp_path / "tables").iterdir())


def test_nothing_is_left_of_a_table_that_cannot_be_ended(tmp_path: Path) -> None:
    def pieces() -> Iterator[pd.DataFrame]:
        yield pd.DataFrame({"a": [1.0]})
        raise RecordingError("damaged")

    for form in ("csv", "parquet"):
        with pytest.raises(RecordingError, match="damaged"):
            save_table(pieces(), tmp_path / f"table.{form}")
    assert not list(tmp_path.iterdir())


def test_a_file_of_the_session_names_it() -> None:
    assert_equal(read_session(DATA / "tracking_2d"), open_measurement(DATA / "tracking_2d" / "session.yaml"))


def direct_session() -> Session:
    """Readings with names of points, which the description does not list, and values of every kind."""
    description = parse_description(
        "format: mtcal-session/1\nmethod: direct\ndatum: rigid\nmachine: {chain: w-Y-X-b-Z-t}\n"
        "standard_uncertainty: {displacement: 1e-6}\nsetups: [{id: 'Plätte, 1'}, {id: '2'}]\n",
        "session.yaml",
    )
    n = 12
    rng = np.random.default_rng(2)
    values = rng.normal(size=n) * 1e-6
    values[[2, 5]] = np.nan
    columns = {axis: rng.normal(size=n) for axis in "xy"} | {
        "gx": np.ones(n),
        "gy": np.full(n, -0.0),
        "gz": np.zeros(n),
    }
    columns["time"] = np.array([0, 1, np.nan, 3, 3, 4, np.nan, np.nan, 5, 6, 7, 8.0])
    columns["load"] = np.where(np.arange(n) % 3 == 0, np.nan, 5e-324 * np.arange(n))
    labels = {
        "point": np.array([f"B{k:02d}" for k in range(n)]),
        "target": np.array(["", "T,1"] * 6),
        "operator": np.array(['Änne "A"', "", "line\nfeed"] * 4),
    }
    readings = Readings(
        setup=np.arange(n) % 2,
        repeat=np.arange(n) // 4,
        displacement=values,
        columns=columns,
        labels=labels,
        row=np.arange(n),
    )
    return Session(description, readings)


@pytest.mark.parametrize("name", [*NAMES, "direct"])
@pytest.mark.parametrize("form", ["csv", "parquet"])
def test_the_readings_as_a_table_are_complete(name: str, form: str, tmp_path: Path) -> None:
    session = direct_session() if name == "direct" else read_session(DATA / name)
    session_to_bag(session, tmp_path / "bag")
    bag = session_from_bag(tmp_path / "bag", check=False)
    frame = readings_frame(bag)
    save_table(iter([frame]), tmp_path / f"t.{form}")
    back = (
        pd.read_parquet(tmp_path / "t.parquet")
        if form == "parquet"
        else pd.read_csv(tmp_path / "t.csv", keep_default_na=False, dtype=str)
    )
    assert list(back.columns) == list(readings_frame(session).columns)
    ids = np.asarray(session.setup_ids)[session.readings.setup]
    assert back["setup"].tolist() == ids.tolist()
    numbers = {"displacement": session.readings.displacement, **session.readings.columns}
    for column, values in numbers.items():
        found = back[column] if form == "parquet" else back[column].replace("", "nan").astype(float)
        assert found.to_numpy().tobytes() == values.tobytes(), column
    for column, texts in session.readings.labels.items():
        assert back[column].tolist() == texts.tolist()


@pytest.mark.parametrize("rows", [60, 50_000])
def test_topics_as_tables_have_every_value(rows: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Names that come late, come twice, or are taken; values without names; in one piece and in several."""
    monkeypatch.setattr("machine_tool_calibration.recording.tables._ROWS", rows)
    with BagWriter(tmp_path / "bag") as bag:
        bag.add_topic("/states", JOINT_STATE)
        for k in range(150):
            bag.write("/states", encode_joint_state(k, "f", ["x", "log_time"], [k / 7, 0.5]), k)
        bag.write("/states", encode_joint_state(150, "f", ["x", "x", "late"], [1.0, 2.0, np.nan]), 150)
        header = part("std_msgs/msg/Header", part("builtin_interfaces/msg/Time", 0, 151), "f")
        values = (np.array(entries) for entries in ([3.0, 4.0], [5.0], [6.0, 7.0]))
        bag.write("/states", encode(JOINT_STATE, header, ["x"], *values), 151)
    reader = BagReader(tmp_path / "bag")
    pieces = list(tables(reader, reader.topics["/states"]))
    assert len(pieces) == (3 if rows == 60 else 1)
    frame = pd.concat(pieces)
    assert list(frame.columns) == [
        *("log_time", "publish_time", "stamp", "frame_id", "x", "log_time_2", "x_2", "late"),
        *("position.1", "velocity.x", "effort.x", "effort.1"),
    ]
    assert frame["log_time"].tolist() == list(range(152))
    assert frame["x"].tolist() == [*(k / 7 for k in range(150)), 1.0, 3.0]
    assert frame["x_2"].tolist()[150] == 2.0
    last = frame.iloc[151]
    assert (last["position.1"], last["velocity.x"], last["effort.x"], last["effort.1"]) == (4.0, 5.0, 6.0, 7.0)
