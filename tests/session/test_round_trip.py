# SPDX-License-Identifier: Apache-2.0
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from machine_tool_calibration.errors import SessionError
from machine_tool_calibration.session.folder import read_session, write_session
from machine_tool_calibration.session.parse import description_yaml, parse_description
from machine_tool_calibration.session.session import Session
from machine_tool_calibration.session.summary import summarize
from machine_tool_calibration.session.text import load_yaml, yaml_text
from machine_tool_calibration.simulation import SimulationSpec, simulate
from machine_tool_calibration.simulation.spec import PLANS

DATA = Path(__file__).parents[1] / "data"
NAMES = ("tracking_2d", "rotary_axis", "step_diagonal", "probing_cross")


def same_bits(one: np.ndarray, other: np.ndarray) -> bool:
    return one.tobytes() == other.tobytes()


def assert_equal(one: Session, other: Session) -> None:
    assert one.description == other.description
    assert same_bits(one.readings.displacement, other.readings.displacement)
    assert np.array_equal(one.readings.setup, other.readings.setup)
    assert np.array_equal(one.readings.repeat, other.readings.repeat)
    assert np.array_equal(one.readings.row, other.readings.row)
    assert set(one.readings.columns) == set(other.readings.columns)
    for name, values in one.readings.columns.items():
        assert same_bits(values, other.readings.columns[name]), name
    assert set(one.readings.labels) == set(other.readings.labels)
    for name, values in one.readings.labels.items():
        assert np.array_equal(values, other.readings.labels[name]), name


@pytest.mark.parametrize("name", NAMES)
def test_written_session_comes_back_to_the_last_bit(name: str, tmp_path: Path) -> None:
    session = read_session(DATA / name)
    write_session(session, tmp_path / "copy")
    assert_equal(session, read_session(tmp_path / "copy"))


def test_contents_are_those_of_the_files() -> None:
    session = read_session(DATA / "tracking_2d")
    assert session.method == "tracking_interferometer"
    assert session.setup_ids == ("A", "B", "C", "D")
    assert len(session.readings) == 288
    assert session.sigma == 3.0e-7
    assert session.readings.column("azimuth")[0] == -0.1418682455588457
    assert session.readings.displacement[2] == 0.15889252135411236
    assert session.readings.row[-1] == 287


def test_a_summary_counts_what_each_setup_has(session_folder) -> None:
    folder = session_folder("tracking_2d")
    folder.set_field(3, "displacement", "")
    session = read_session(folder.path)
    found, time = summarize(session), session.readings.column("time")
    assert (found.readings, found.missing, found.targets, found.problem) == (288, 1, 36, None)
    assert [(one.id, one.readings, one.missing, one.repeats) for one in found.setups] == [
        ("A", 72, 1, 2), ("B", 72, 0, 2), ("C", 72, 0, 2), ("D", 72, 0, 2),
    ]  # fmt: skip
    assert found.duration == time.max() - time.min()
    for one, mine in zip(found.setups, (time[session.readings.setup == k] for k in range(4)), strict=True):
        assert (one.first_time, one.last_time) == (mine.min(), mine.max())


def test_missing_readings_are_kept_as_nan(session_folder) -> None:
    folder = session_folder("tracking_2d")
    folder.set_field(3, "displacement", "")
    folder.set_field(4, "displacement", "nan")
    session = read_session(folder.path)
    assert len(session.readings) == 288
    assert list(np.flatnonzero(np.isnan(session.readings.displacement))) == [3, 4]
    write_session(session, folder.path.parent / "copy")
    assert_equal(session, read_session(folder.path.parent / "copy"))


def test_unknown_columns_are_covariates_or_labels(session_folder) -> None:
    folder = session_folder("direct")
    lines = folder.lines()
    extra = [",load,operator", *[f",{i}.5,Anna {i % 2}" for i in range(8)]]
    folder.write_lines([line + more for line, more in zip(lines, extra, strict=True)])
    readings = read_session(folder.path).readings
    assert readings.columns["load"].tolist() == [i + 0.5 for i in range(8)]
    assert readings.labels["operator"].tolist() == [f"Anna {i % 2}" for i in range(8)]


def test_byte_order_mark_crlf_blank_lines_and_quotes_are_read(session_folder) -> None:
    folder = session_folder("direct")
    lines = folder.lines()
    lines[3] = '"fwd",0.2, 1,0 ,0,"2e-6"'
    text = "\r\n".join([*lines[:5], "", "  ", *lines[5:], ""])
    folder.observed.write_bytes(b"\xef\xbb\xbf" + text.encode())
    folder.described.write_bytes(b"\xef\xbb\xbf" + folder.described.read_bytes())
    readings = read_session(folder.path).readings
    assert readings.displacement.tolist() == [i * 1e-6 for i in range(2)] + [2e-6] + [
        float(f"{i}e-6") for i in range(3, 8)
    ]


def test_numbers_without_a_point_and_ids_like_numbers(session_folder) -> None:
    folder = session_folder("direct")
    folder.edit_yaml("[{id: fwd}]", "[{id: 007}, {id: 1}, {id: on}, {id: Y}]")
    ids = ["007", "1", "on", "Y"]
    folder.edit_rows(lambda fields, row: {**fields, "setup": ids[row % 4]})
    session = read_session(folder.path)
    assert session.setup_ids == tuple(ids)
    assert session.readings.setup.tolist() == [0, 1, 2, 3, 0, 1, 2, 3]
    assert session.sigma == 1e-6


def test_times_since_an_epoch_count_from_the_first_reading(tmp_path: Path) -> None:
    session = simulate(SimulationSpec(plan=PLANS["tracking_interferometer"](), seed=3)).session
    time = session.readings.columns["time"]
    late = replace(session.readings, columns={**session.readings.columns, "time": time + 1.7e9})
    write_session(session.with_readings(late), tmp_path / "late")
    np.testing.assert_allclose(read_session(tmp_path / "late").readings.columns["time"], time - time[0], atol=1e-6)


def test_an_existing_session_is_not_overwritten(tmp_path: Path) -> None:
    session = read_session(DATA / "tracking_2d")
    write_session(session, tmp_path)
    with pytest.raises(SessionError, match="holds a session already"):
        write_session(session, tmp_path)
    write_session(session, tmp_path, overwrite=True)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["observations.csv", "session.yaml"]


def is_identifier(text: str) -> bool:
    return text.isprintable() and text == text.strip() and text not in "BCD" and text.lower() != "nan"


# As large and as small as anything of a machine may be, in any unit.
finite = st.one_of(st.just(0.0), st.floats(1e-100, 1e12), st.floats(-1e12, -1e-100))


@given(
    x=finite,
    position=st.tuples(finite, finite, finite),
    sigma=st.floats(min_value=1e-15, max_value=1e12),
    identifier=st.text(min_size=1, max_size=8).filter(is_identifier),
)
def test_any_description_comes_back(
    x: float, position: tuple[float, float, float], sigma: float, identifier: str
) -> None:
    text = (DATA / "tracking_2d" / "session.yaml").read_text()
    description = parse_description(text, "session.yaml")
    setup = description.setups[0].model_copy(update={"id": identifier, "position": position})
    changed = description.model_copy(
        update={
            "setups": (setup, *description.setups[1:]),
            "standard_uncertainty": description.standard_uncertainty.model_copy(update={"displacement": sigma}),
        }
    )
    assert parse_description(description_yaml(changed), "session.yaml") == changed


def test_text_that_looks_like_a_number_comes_back_as_text():
    content = {"feature": "1e5", "features": ["2e3", "007", "-.5e1", "3.10"], "size": 1e-7, "count": 3}
    assert load_yaml(yaml_text(content), "content").value == content
