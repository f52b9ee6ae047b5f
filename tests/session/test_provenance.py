# SPDX-License-Identifier: Apache-2.0
"""What a measurement says of itself goes with it everywhere, and the hash of its data is that of its files.
Readings that come one by one.
"""

import datetime
import hashlib
import json
import math
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from machine_tool_calibration.errors import SessionError
from machine_tool_calibration.methods.identify import identify
from machine_tool_calibration.recording.session_bag import reading_columns, session_from_bag, session_to_bag
from machine_tool_calibration.session import collect
from machine_tool_calibration.session.collect import Collector, Reading, Received
from machine_tool_calibration.session.description import Place
from machine_tool_calibration.session.folder import read_session, write_session
from machine_tool_calibration.session.parse import description_yaml, parse_description
from machine_tool_calibration.session.provenance import data_hash, provenance
from machine_tool_calibration.simulation.simulate import simulate
from machine_tool_calibration.simulation.spec import PRESETS, SimulationSpec

ABOUT = """about:
  machine: {name: VMC 850, serial: 007, software: 3.10}
  date: 2026-03-01
  operator: Müller, "Erika"
  instruments:
  - {name: laser, serial: 1e5, calibrated: 2025-11-02, in_use: true}
  place:
  remarks: |
    warm: 2 h
    # not a remark
"""
SAID = {
    "machine": {"name": "VMC 850", "serial": "007", "software": "3.10"},
    "date": "2026-03-01",
    "operator": 'Müller, "Erika"',
    "instruments": [{"name": "laser", "serial": "1e5", "calibrated": "2025-11-02", "in_use": "true"}],
    "place": "",
    "remarks": "warm: 2 h\n# not a remark\n",
}


@pytest.fixture(scope="module")
def session():
    plan = {"method": "tracking_interferometer", "dimension": 2, "repeats": 1}
    made = simulate(SimulationSpec.model_validate({"seed": 1, "plan": plan})).session
    text = description_yaml(made.description) + ABOUT
    labels = {"shift": np.array(["early, cold"] * len(made.readings))}
    columns = {**made.readings.columns, "spindle_load": np.arange(float(len(made.readings)))}
    readings = replace(made.readings, labels=labels, columns=columns)
    return replace(made, description=parse_description(text, "session.yaml"), readings=readings)


def test_descriptive_data_stand_as_they_were_written(session):
    assert session.description.about == SAID
    assert parse_description(description_yaml(session.description), "again").about == SAID


def test_from_a_program_they_may_be_numbers_and_dates(session):
    record = type(session.description)
    said = {**session.description.model_dump(), "about": {"serial": 7, "date": datetime.date(2026, 3, 1)}}
    assert record.model_validate(said).about == {"serial": "7", "date": "2026-03-01"}
    with pytest.raises(ValueError, match="must be text, a number, a date"):
        record.model_validate({**said, "about": {"what": object()}})


def test_they_must_be_a_mapping(session):
    bare = session.description.model_copy(update={"about": {}})
    text = description_yaml(bare) + "about: [1, 2]\n"
    with pytest.raises(SessionError, match="about must be a mapping"):
        parse_description(text, "session.yaml")


def test_a_folder_and_a_recording_agree(session, tmp_path: Path):
    write_session(session, tmp_path / "folder")
    session_to_bag(session, tmp_path / "bag")
    folder, bag = read_session(tmp_path / "folder"), session_from_bag(tmp_path / "bag")
    assert bag.description.about == SAID
    assert provenance([folder], model="free") == provenance([bag], model="free")
    files = b"".join((tmp_path / "folder" / name).read_bytes() for name in ("session.yaml", "observations.csv"))
    assert data_hash(bag) == hashlib.sha256(files).hexdigest()


def test_any_change_of_description_or_readings_shows(session):
    values = session.readings.displacement.copy()
    values[3] = np.nextafter(values[3], 1.0)
    other = session.with_readings(replace(session.readings, displacement=values))
    told = replace(session, description=session.description.model_copy(update={"about": {"operator": "other"}}))
    assert len({data_hash(one) for one in (session, other, told)}) == 3


def test_what_was_left_out_does_not_change_the_hash(session):
    gone = np.arange(len(session.readings)) < 3
    assert data_hash(session.without(gone).without(np.arange(141) > 100, as_lost=True)) == data_hash(session)


def test_several_in_any_order_are_the_same_data(session):
    other = replace(session, description=session.description.model_copy(update={"about": {}}))
    one, two = provenance([session, other], ["a", "b"]), provenance([other, session], ["b", "a"])
    assert one.sha256 == two.sha256 != provenance([session]).sha256
    assert [origin.label for origin in one.sessions] == ["a", "b"]


def test_a_result_and_its_document_carry_it(session):
    result = identify(session, effects=["backlash_x"])
    document = json.loads(json.dumps(result.document()["provenance"]))
    read = result.provenance
    assert read.document() == document
    assert (read.model, read.effects) == (result.model_name, ("backlash_x",))
    assert read.sha256 == data_hash(session)
    assert read.evaluated == "2026-01-01T00:00:00+00:00"  # as SOURCE_DATE_EPOCH says
    assert read.footer.split("  ·  ") == [
        "VMC 850", "measured 2026-03-01", "evaluated 2026-01-01", read.software, "free, backlash_x",
        f"data {read.sha256[:12]}",
    ]  # fmt: skip
    assert ("instruments[1].serial", "1e5") in read.lines()


DATA = Path(__file__).parents[1] / "data"


@pytest.mark.parametrize("block", [1, 7, 4096])
def test_the_same_session_whatever_the_blocks(block: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(collect, "_BLOCK", block)
    session = read_session(DATA / "rotary_axis")
    names, table = reading_columns(session)
    collector = Collector(session.description, Place("session", "reading"))
    assert np.isnan(collector.last_time)
    for row in table:
        collector.add(names, row)
    assert collector.last_time == 3345.0
    assert len(collector) == 216
    other = collector.session("live")
    assert other.readings.displacement.tobytes() == session.readings.displacement.tobytes()
    for name, values in session.readings.columns.items():
        assert values.tobytes() == other.readings.columns[name].tobytes()
    assert np.array_equal(other.readings.labels["target"], session.readings.labels["target"])


def test_names_that_change_on_the_way() -> None:
    session = read_session(DATA / "tracking_2d")
    collector = Collector(session.description, Place("session", "reading"))
    base = ["time", "repeat", "setup_index", "x", "y", "azimuth", "displacement"]
    collector.add(base, [0.0, 0, 0, 1, 2, 3, 4])
    collector.add([*base, "load"], [1.0, 0, 0, 1, 2, 3, 4, 9])
    collector.add(base[::-1], [40, 30, 20, 10, 0, 0, 2.0])
    readings = collector.session("live", check=False).readings
    assert readings.columns["time"].tolist() == [0.0, 1.0, 2.0]
    assert readings.columns["x"].tolist() == [1.0, 1.0, 10.0]
    assert readings.displacement.tolist() == [4.0, 4.0, 40.0]
    assert np.array_equal(readings.columns["load"], [np.nan, 9.0, np.nan], equal_nan=True)


def test_a_setup_is_told_by_its_place() -> None:
    session = read_session(DATA / "tracking_2d")
    base = ["time", "repeat", "x", "y", "azimuth", "displacement"]
    collector = Collector(session.description, Place("session", "reading"))
    collector.add([*base, "setup_index"], [0.0, 0, 1, 2, 3, 4, 2.0])
    readings = collector.session("live", check=False).readings
    assert readings.setup.tolist() == [2]
    assert "setup_index" not in readings.columns
    collector = Collector(session.description, Place("session", "reading"))
    with pytest.raises(SessionError, match=r"^reading row 0: it has no setup_index$"):
        collector.add(base, [1.0, 0, 1, 2, 3, 4])


def test_a_session_can_be_taken_before_the_last_reading() -> None:
    session = read_session(DATA / "tracking_2d")
    names, table = reading_columns(session)
    collector = Collector(session.description, Place("session", "reading"))
    with pytest.raises(SessionError, match=r"^reading: no readings$"):
        collector.session("live")
    for count, row in enumerate(table[:20], 1):
        collector.add(names, row)
        assert len(collector.session("live", check=False).readings) == count
    with pytest.raises(SessionError, match=r"^reading: 1 station; "):
        collector.session("live")


def message(time: float, index: float = math.nan) -> Reading:
    return Reading(("time", "reading_index", "setup_index", "displacement"), (time, index, 0.0, 0.0))


def test_what_is_received_is_in_the_order_of_time_and_once() -> None:
    received = Received()
    for time in (2.0, 1.0, 2.0):
        assert not received.add(round(time * 1e9), message(time))
    assert [reading.values[0] for reading in received.in_order()] == [1.0, 2.0]
    # Its clock began at another moment: another session.
    assert received.add(5_000_000_000, message(1.0)) == 2
    assert len(received) == 1


def test_readings_of_one_time_that_differ_are_of_two_sessions() -> None:
    received = Received()
    for time in (1.0, 2.0):
        assert not received.add(round(time * 1e9), message(time, time))
    assert not received.add(2_000_000_000, message(2.0, 2.0))
    other = Reading(("time", "reading_index", "setup_index", "displacement"), (2.0, 2.0, 0.0, 1e-5))
    assert received.add(2_000_000_000, other) == 2
    assert received.in_order() == [other] and received.missing == 2


def test_readings_that_never_came_are_counted() -> None:
    received = Received()
    assert (received.missing, received.expected, received.lacks_the_first) == (0, 0, False)
    for index in (3, 4):
        received.add(index, message(math.nan, index))
    assert (received.missing, received.expected, received.lacks_the_first) == (3, 5, True)
    received.add(7, message(math.nan, 7))
    assert (received.missing, received.expected, received.lacks_the_first) == (5, 8, False)
    received.forget()
    assert received.missing == 0


@pytest.mark.parametrize(("columns", "why"), [
    ({"setup_index": 0.0}, "it has no displacement"),
    ({"displacement": 1e-6}, "it has no setup_index"),
    ({"displacement": 1e-6, "setup_index": 0.5}, "setup_index is 0.5"),
    ({"displacement": 1e-6, "setup_index": 9.0}, "setup_index is 9, not 0 to 2"),
])  # fmt: skip
def test_a_message_that_can_be_no_reading_of_the_session_changes_nothing(columns: dict[str, float], why: str) -> None:
    description = simulate(SimulationSpec(plan=PRESETS["tracking_2d"], seed=1)).session.description
    description = description.model_copy(update={"setups": description.setups[:3]})
    received = Received()
    received.add(1, message(math.nan, 0.0))
    with pytest.raises(SessionError, match=f"^{re.escape(why)}$"):
        received.add(2, Reading(tuple(columns), tuple(columns.values())), description)
    assert len(received) == 1 and received.missing == 0


@pytest.mark.parametrize(("preset", "names", "values", "why"), [
    ("tracking_2d", ("setup_index", "displacement"), (math.nan, 1e-6), "setup_index is nan"),
    ("rotary_axis", ("setup_index", "target_index", "displacement"), (0.0, math.nan, 1e-6), "target_index is nan"),
    ("tracking_2d", ("setup_index", "displacement", "x", "x"), (0.0, 1e-6, 0.1, 0.2), "a name stands twice"),
    ("tracking_2d", ("setup_index", "displacement", "y", "repeat"), (0.0, 1e-6, 0.1, 0.0), "x is missing"),
    ("tracking_2d", ("setup_index", "displacement", "x", "y", "repeat"), (0.0, 1e-6, 0.1, math.nan, 0.0), "y is"),
    ("tracking_2d", ("setup_index", "displacement", "dir_x"), (0.0, math.nan, 7.0), r"dir_x is 7, not \+1 or -1"),
])  # fmt: skip
def test_a_message_that_lacks_its_place_or_has_a_name_twice_spoils_no_readings(
    preset: str, names: tuple[str, ...], values: tuple[float, ...], why: str
) -> None:
    description = simulate(SimulationSpec(plan=PRESETS[preset], seed=1)).session.description
    received = Received()
    received.add(1, Reading(("setup_index", "displacement"), (0.0, 1e-6)))
    with pytest.raises(SessionError, match=f"^{why}"):
        received.add(2, Reading(names, values), description)
    # A lost one has no place, where the instrument saw nothing.
    received.add(3, Reading(("setup_index", "target_index", "displacement"), (0.0, 0.0, math.nan)), description)
    assert len(received) == 2
