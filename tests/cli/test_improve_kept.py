# SPDX-License-Identifier: Apache-2.0
"""`mtcal improve` keeps what it found whatever happens to its output, and says of its files what is true."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from machine_tool_calibration.cli.main import BROKEN_PIPE
from machine_tool_calibration.reports.history_file import read_history

from ..told import Verb

pytestmark = pytest.mark.usefixtures("found_once")

PICTURES = {"improve.png", "improve.csv", "residuals.csv"}


@pytest.fixture
def cube(original: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(original, tmp_path / "cube"))


def improve(cube: Path, output: Path) -> list[str]:
    return ["improve", str(cube), "-o", str(output)]


def test_a_closed_pipe_loses_nothing(cube: Path, tmp_path: Path) -> None:
    read, write = os.pipe()
    os.close(read)
    try:
        done = subprocess.run(
            [sys.executable, "-m", "machine_tool_calibration", *improve(cube, tmp_path / "out")],
            stdout=write, stderr=subprocess.PIPE, text=True, timeout=900, check=False,
        )  # fmt: skip
    finally:
        os.close(write)
    assert done.returncode == BROKEN_PIPE
    assert read_history(cube / "history.yaml").current == 2
    assert {file.name for file in (tmp_path / "out").iterdir()} == PICTURES
    assert f"{cube / 'history.yaml'}" in done.stderr
    assert done.stderr.count("\n") == 1


def test_what_was_not_written_is_not_said_to_be(cube: Path, tmp_path: Path, verb: Verb) -> None:
    history = cube / "history.yaml"
    wrote = next(line for line in verb(*improve(cube, tmp_path / "out")).err.splitlines() if line.startswith("wrote"))
    assert str(history) in wrote
    content = history.read_bytes()
    lines = verb(*improve(cube, tmp_path / "out")).err.splitlines()
    assert all(str(history) not in line for line in lines if line.startswith("wrote"))
    assert f"{history} holds these models already: unchanged, model 2 is the current one" in lines
    assert history.read_bytes() == content
    verb("history", cube, "--undo")
    shown = verb(*improve(cube, tmp_path / "out")).err
    assert str(history) in shown
    assert "no new model in the history; model 2 is the current one now" in shown
    assert len(read_history(history).models) == 2


def test_a_history_that_cannot_be_written_costs_no_pictures(cube: Path, tmp_path: Path, verb: Verb) -> None:
    (cube / "history.yaml.part").mkdir()  # a folder that is read-only stops no superuser
    shown = verb(*improve(cube, tmp_path / "out"), status=1)
    assert shown.out.startswith("Added backlash_y")
    assert {file.name for file in (tmp_path / "out").iterdir()} == PICTURES
    wrote, failure = shown.err.splitlines()
    assert wrote.startswith("wrote ")
    assert "history.yaml" not in wrote
    assert failure.startswith(f"mtcal: {cube / 'history.yaml'}: cannot be written: ")
    assert "--no-history" in failure
    assert not (cube / "history.yaml").exists()


def test_pictures_that_cannot_be_written_cost_no_history(cube: Path, tmp_path: Path, verb: Verb) -> None:
    (tmp_path / "out" / "improve.png").mkdir(parents=True)
    shown = verb(*improve(cube, tmp_path / "out"), status=1)
    assert shown.out.startswith("Added backlash_y")
    assert "cannot be written" in shown.err
    assert "-o names another folder" in shown.err
    assert read_history(cube / "history.yaml").current == 2
