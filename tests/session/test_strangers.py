# SPDX-License-Identifier: Apache-2.0
"""Files from strangers: bounded time and memory, and nothing but a SessionError.
Numbers that nothing measured has are refused in one line, where they stand.
"""

import re
import time
import tracemalloc
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from machine_tool_calibration.diagnosis.diagnose import diagnose
from machine_tool_calibration.errors import SessionError
from machine_tool_calibration.session.checks import check_session
from machine_tool_calibration.session.folder import read_session
from machine_tool_calibration.session.parse import parse_description
from machine_tool_calibration.session.session import Session
from machine_tool_calibration.session.text import load_yaml
from machine_tool_calibration.simulation import SimulationSpec, simulate
from machine_tool_calibration.simulation.spec import PLANS

from ..plates import with_columns

DATA = Path(__file__).parents[1] / "data"
YAML = (DATA / "tracking_2d" / "session.yaml").read_bytes()
CSV = (DATA / "tracking_2d" / "observations.csv").read_bytes()


def test_aliases_that_multiply() -> None:
    lines = ["a0: &a0 [x, x, x, x, x, x, x, x, x, x]"]
    lines += [f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 10)}]" for i in range(1, 30)]
    tracemalloc.start()
    with pytest.raises(SessionError, match=r"^s.yaml line 5: aliases repeat more than 100000 values$"):
        load_yaml("\n".join(lines), "s.yaml")
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 20e6


def test_an_alias_of_itself() -> None:
    with pytest.raises(SessionError, match="alias"):
        load_yaml("a: &a [*a]", "s.yaml")


def test_a_plain_alias_is_read() -> None:
    assert load_yaml("a: &a [1, 2]\nb: *a\n", "s.yaml").value == {"a": [1, 2], "b": [1, 2]}


@pytest.mark.parametrize("text", ["[" * 100_000, "{a: " * 100_000, "- " * 100_000, "? " * 10_000])
def test_deep_nesting(text: str) -> None:
    with pytest.raises(SessionError):
        load_yaml(text, "s.yaml")


def test_numbers_of_many_digits() -> None:
    value = load_yaml(f"a: {'9' * 10_000}\nb: 1e-7\nc: 007\nd: -0.0\ne: 1_000\nf: 0x10\n", "s.yaml").value
    assert value == {"a": float("inf"), "b": 1e-7, "c": "007", "d": 0.0, "e": "1_000", "f": "0x10"}
    with pytest.raises(SessionError, match="finite"):
        parse_description(YAML.decode().replace("-0.350022406484", "9" * 10_000), "s.yaml")


def test_a_file_that_is_too_large(tmp_path: Path) -> None:
    with (tmp_path / "session.yaml").open("wb") as stream:
        stream.truncate(1 << 30)
    (tmp_path / "observations.csv").write_bytes(CSV)
    with pytest.raises(SessionError, match="larger than the 16 MiB"):
        read_session(tmp_path)


def test_a_table_that_is_one_endless_line(tmp_path: Path) -> None:
    (tmp_path / "session.yaml").write_bytes(YAML)
    (tmp_path / "observations.csv").write_bytes(b"time," * 4_000_000)
    with pytest.raises(SessionError, match="a line of more than 1 MiB"):
        read_session(tmp_path)


def test_a_table_of_zeros_without_end(tmp_path: Path) -> None:
    (tmp_path / "session.yaml").write_bytes(YAML)
    with (tmp_path / "observations.csv").open("wb") as stream:
        stream.truncate(3 << 30)
    start = time.process_time()
    with pytest.raises(SessionError, match=r"a line of more|NUL"):
        read_session(tmp_path)
    assert time.process_time() - start < 5.0


def test_a_link_out_of_the_folder_is_only_read(tmp_path: Path) -> None:
    folder = tmp_path / "s"
    folder.mkdir()
    (folder / "session.yaml").symlink_to("/dev/zero")
    (folder / "observations.csv").write_bytes(CSV)
    with pytest.raises(SessionError, match="is not a file"):
        read_session(folder)


@pytest.mark.long
def test_many_rows_take_seconds(tmp_path: Path) -> None:
    rows = 100_000
    rng = np.random.default_rng(1)
    (tmp_path / "session.yaml").write_text(
        "format: mtcal-session/1\nmethod: direct\nmachine: {chain: w-X-b-t}\nsetups: [{id: a}]\n"
        "standard_uncertainty: {displacement: 1e-6}\n"
    )
    values = rng.normal(size=(rows, 4))
    with (tmp_path / "observations.csv").open("w") as stream:
        stream.write("time,setup,x,gx,gy,gz,displacement,load\n")
        stream.writelines(
            f"{i},a,{x!r},1,0,0,{d!r},{q!r}\n" for i, (x, d, q, _) in enumerate((values * [1, 1e-6, 1, 1]).tolist())
        )
    start = time.process_time()
    readings = read_session(tmp_path).readings
    assert time.process_time() - start < 7.0  # about a third of a second on one idle core
    assert np.array_equal(readings.displacement, values[:, 1] * 1e-6)


def flip(data: bytes, edits: list[tuple[int, int, bytes]]) -> bytes:
    for at, length, new in edits:
        at %= len(data) + 1
        data = data[:at] + new + data[at + length :]
    return data


TOKENS = [
    b"",
    b",",
    b"\n",
    b'"',
    b"nan",
    b"1e400",
    b"&a ",
    b"*a",
    b"!!x ",
    b"\xff",
    b"\0",
    b"{",
    b"[",
    b"-",
    b": ",
    b"\r",
]
piece = st.one_of(st.sampled_from(TOKENS), st.binary(max_size=6))
edits = st.lists(st.tuples(st.integers(0, 1 << 20), st.integers(0, 40), piece), max_size=6)
loose = settings(suppress_health_check=[HealthCheck.function_scoped_fixture])


@pytest.mark.parametrize("damaged", ["session.yaml", "observations.csv"])
@loose
@given(edits=edits)
def test_damaged_bytes(tmp_path: Path, damaged: str, edits: list[tuple[int, int, bytes]]) -> None:
    for name, sound in (("session.yaml", YAML), ("observations.csv", CSV)):
        (tmp_path / name).write_bytes(flip(sound, edits) if name == damaged else sound)
    only_session_errors(tmp_path)


@loose
@given(st.binary(max_size=300), st.binary(max_size=300))
def test_noise(tmp_path: Path, description: bytes, readings: bytes) -> None:
    (tmp_path / "session.yaml").write_bytes(description)
    (tmp_path / "observations.csv").write_bytes(readings)
    only_session_errors(tmp_path)


def only_session_errors(folder: Path) -> None:
    try:
        read_session(folder)
    except SessionError as error:
        text = str(error)
        assert len(text.splitlines()) == 1
        assert str(folder) in text
        assert len(text) < 600 + len(str(folder))


@pytest.fixture(scope="module")
def sound() -> Session:
    return simulate(SimulationSpec(plan=PLANS["direct"](), seed=3)).session


@pytest.mark.parametrize("value", [1e308, -1e308, 1e200, 5e-324])
@pytest.mark.parametrize("column", ["time", "y", "gx", "displacement", "temperature_x"])
def test_a_reading_that_nothing_gives(sound: Session, column: str, value: float) -> None:
    old = {**sound.readings.columns, "displacement": sound.readings.displacement}[column].copy()
    old[7] = value
    shown = re.escape(f"{value:g}")
    with pytest.raises(SessionError, match=rf"^\S+ row 7: {column} is {shown}, too (large|small) to have been read$"):
        check_session(with_columns(sound, **{column: old}))


def test_a_covariate_may_be_in_any_unit(sound: Session) -> None:
    # nanoseconds since 1970
    check_session(with_columns(sound, stamp=1.7e18 + 1e9 * np.arange(len(sound.readings))))


@pytest.mark.parametrize(
    ("session", "path", "value", "says"),
    [
        ("step_diagonal", ("setups", 0, "direction", 0), 1e308, "too large"),
        ("step_diagonal", ("setups", 0, "direction", 0), 0.5, "0.5 is no sign"),
        ("step_diagonal", ("step", 1), 5e-324, "too small"),
        ("tracking_2d", ("setups", 0, "position_uncertainty"), 1e200, "too large"),
        ("tracking_2d", ("standard_uncertainty", "displacement"), 1e-30, "must be at least 1e-15"),
        ("tracking_2d", ("machine", "travel", "x", 1), 1e308, "too large"),
        ("rotary_axis", ("targets", 0, "position", 2), -1e308, "too large"),
    ],
)
def test_a_description_that_nothing_fits(session: str, path: tuple[str | int, ...], value: float, says: str) -> None:
    content = yaml.safe_load((DATA / session / "session.yaml").read_text())
    part: Any = content
    for key in path[:-1]:
        part = part[key]
    part[path[-1]] = value
    with pytest.raises(SessionError, match=rf"^s.yaml line \d+: .*{says}"):
        parse_description(yaml.safe_dump(content), "s.yaml")


def test_no_measurement_has_thousands_of_setups() -> None:
    content = yaml.safe_load((DATA / "probing_cross" / "session.yaml").read_text())
    content["setups"] = [{"id": f"S{k}", "c": 0.0} for k in range(1001)]
    with pytest.raises(SessionError, match=r"^s.yaml line \d+: setups has 1001 entries, more than 1000$"):
        parse_description(yaml.safe_dump(content), "s.yaml")


def test_a_direction_of_approach_that_is_unknown_for_many_readings(sound: Session) -> None:
    columns = dict(sound.readings.columns)
    columns["dir_x"] = np.where(np.arange(len(sound.readings)) % 3 == 0, np.nan, columns["dir_x"])
    found = diagnose(sound.with_readings(replace(sound.readings, columns=columns)))
    assert found.excluded["backlash_x"] == "the column dir_x has missing values"
