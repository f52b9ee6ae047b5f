# SPDX-License-Identifier: Apache-2.0
"""A line that stands there twice is no repeat."""

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from machine_tool_calibration.cli.main import run
from machine_tool_calibration.errors import SessionError
from machine_tool_calibration.interface.session import load
from machine_tool_calibration.session.checks import check_session
from machine_tool_calibration.session.folder import read_session
from machine_tool_calibration.session.session import refuse_repeated

from ..again import measured_again

DATA = Path(__file__).parents[1] / "data"
METHODS = ["tracking_2d", "step_diagonal", "rotary_axis", "probing_cross"]


def copied(method: str, folder: Path, lines: list[int], place: int | None = None) -> Path:
    """A session of which some lines stand there twice: behind themselves, or at another place."""
    shutil.copytree(DATA / method, folder)
    file = folder / "observations.csv"
    text = file.read_text().splitlines(keepends=True)
    for line in sorted(lines, reverse=True):
        text.insert(line if place is None else place, text[line - 1])
    file.write_text("".join(text))
    return folder


@pytest.mark.parametrize("method", METHODS)
def test_a_line_that_was_copied_is_named_with_the_one_that_it_repeats(method: str, tmp_path: Path) -> None:
    folder = copied(method, tmp_path / "s", [20])
    with pytest.raises(SessionError) as caught:
        read_session(folder)
    text = str(caught.value).replace(f"{folder}/", "")
    assert text.startswith("observations.csv row 19 (line 21): the same reading as observations.csv row 18 (line 20)")
    assert "\n" not in text


def test_several_are_counted(tmp_path: Path) -> None:
    with pytest.raises(SessionError, match="and 2 more like it"):
        read_session(copied("tracking_2d", tmp_path / "s", [20, 30, 40]))


def test_equal_readings_at_different_times_are_readings() -> None:
    session = read_session(DATA / "tracking_2d")
    readings = session.readings
    displacement = readings.displacement.copy()
    displacement[19] = displacement[18]
    check_session(session.with_readings(replace(readings, displacement=displacement)))


def test_without_a_clock_that_tells_them_apart_equal_readings_may_be_different_ones(tmp_path: Path) -> None:
    folder = copied("tracking_2d", tmp_path / "s", [20])
    file = folder / "observations.csv"
    head, *rows = file.read_text().splitlines()
    k = head.split(",").index("time")
    rows = [",".join("0" if j == k else cell for j, cell in enumerate(row.split(","))) for row in rows]
    file.write_text("\n".join([head, *rows]) + "\n")
    assert len(read_session(folder).readings) == len(rows)


def test_missing_readings_that_are_alike_are_only_missing(tmp_path: Path) -> None:
    session = read_session(DATA / "tracking_2d")
    readings = session.readings
    rows = np.r_[: len(readings)]
    doubled = readings.select(np.insert(rows, 19, 18))
    displacement = doubled.displacement.copy()
    displacement[18:20] = np.nan
    check_session(session.with_readings(replace(doubled, displacement=displacement)))


def test_a_measurement_that_is_given_twice_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Under another name too: each reading would count as two."""
    shutil.copytree(DATA / "tracking_2d", tmp_path / "again")
    both = [str(DATA / "tracking_2d"), str(tmp_path / "again")]
    with pytest.raises(SessionError, match="tracking_2d and again are the same readings"):
        load(both)
    assert run(["identify", *both, "--json"]) == 1
    out, err = capsys.readouterr()
    assert out == "" and "tracking_2d and again are the same readings" in err
    other = read_session(measured_again(both[0], tmp_path / "other"))
    refuse_repeated([read_session(Path(both[0])), other], ["a", "b"])
