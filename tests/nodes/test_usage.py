# SPDX-License-Identifier: Apache-2.0
"""`--help` of every executable says what it is and takes, and starts nothing."""

import os
import re
from importlib import import_module
from pathlib import Path

import pytest

from machine_tool_calibration.nodes.__main__ import main

ROOT = Path(__file__).parents[2]
EXECUTABLES = sorted(path.name for path in (ROOT / "scripts" / "nodes").iterdir())


@pytest.mark.parametrize("name", EXECUTABLES)
@pytest.mark.parametrize("given", [["--help"], ["-h", "--ros-args", "-p", "rate:=1.0"]])
def test_help_says_what_it_is_and_takes_and_starts_nothing(name, given, capsys, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("rclpy.init", lambda *_, **__: pytest.fail("it was started"))
    module = import_module(f"machine_tool_calibration.nodes.{name}")
    monkeypatch.setattr("signal.signal", lambda *_: None)
    assert main(name, given) == 0
    said = capsys.readouterr().out
    assert said.startswith(f"Usage: ros2 run machine_tool_calibration {name} ")
    assert module.__doc__.strip() in said
    declared = re.findall(r'\.declare\(\s*"(\w+)"', Path(module.__file__).read_text())
    assert declared
    assert all(re.search(rf"^\| .*`{key}`", said, re.M) for key in [*declared, "use_sim_time"])
    assert Path(said.strip().rpartition(": ")[2]).is_file()
    assert not list(tmp_path.iterdir())


def test_help_into_a_pipe_that_nobody_reads_any_more(monkeypatch):
    read, write = os.pipe()
    os.close(read)
    with os.fdopen(write, "w") as stream:
        monkeypatch.setattr("sys.stdout", stream)
        monkeypatch.setattr("signal.signal", lambda *_: None)
        assert main("estimator", ["--help"]) == 0
