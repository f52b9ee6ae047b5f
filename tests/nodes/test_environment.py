"""What processes of nodes set for themselves."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from machine_tool_calibration.nodes.ros.process import default_environment

SETTINGS = ("ROS_AUTOMATIC_DISCOVERY_RANGE", "ROS_LOCALHOST_ONLY", "ROS_LOG_DIR", "ROS_HOME")


@pytest.fixture(autouse=True)
def nothing_set(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in SETTINGS:
        monkeypatch.setenv(name, "")  # so that it is put back afterwards
        monkeypatch.delenv(name)


def test_discovery_stays_on_this_machine_unless_the_user_says_otherwise(monkeypatch: pytest.MonkeyPatch) -> None:
    default_environment()
    assert os.environ.pop("ROS_AUTOMATIC_DISCOVERY_RANGE") == "LOCALHOST"
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "SUBNET")
    default_environment()
    assert os.environ.pop("ROS_AUTOMATIC_DISCOVERY_RANGE") == "SUBNET"
    monkeypatch.setenv("ROS_LOCALHOST_ONLY", "0")
    default_environment()
    assert "ROS_AUTOMATIC_DISCOVERY_RANGE" not in os.environ


def test_logs_stay_where_ros_puts_them(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("HOME", str(tmp_path / "not there yet"))
    default_environment()
    assert "ROS_LOG_DIR" not in os.environ
    monkeypatch.setenv("HOME", os.devnull)
    monkeypatch.setenv("ROS_HOME", str(tmp_path))
    default_environment()
    assert "ROS_LOG_DIR" not in os.environ


def test_a_node_starts_without_a_home(monkeypatch: pytest.MonkeyPatch, tmp_path: Path, ros_domain: int) -> None:
    monkeypatch.setenv("HOME", os.devnull)
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    code = f"from machine_tool_calibration.nodes.operator import Operator; Operator({ros_domain}).__exit__()"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=900, check=False)
    assert done.returncode == 0, done.stderr
    assert list(tmp_path.glob("ros-log-*/*.log"))
