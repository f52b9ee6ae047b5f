# SPDX-License-Identifier: Apache-2.0
"""What processes of nodes set for themselves."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from machine_tool_calibration.nodes.ros.process import default_environment

MIDDLEWARE = ("FASTRTPS_DEFAULT_PROFILES_FILE", "FASTDDS_DEFAULT_PROFILES_FILE", "RMW_FASTRTPS_USE_QOS_FROM_XML")
SETTINGS = ("ROS_AUTOMATIC_DISCOVERY_RANGE", "ROS_LOCALHOST_ONLY", "ROS_LOG_DIR", "ROS_HOME", *MIDDLEWARE)


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


def test_the_middleware_gives_memory_back_unless_it_is_set_up_by_the_user(monkeypatch: pytest.MonkeyPatch) -> None:
    default_environment()
    assert "<historyMemoryPolicy>DYNAMIC<" in Path(os.environ[MIDDLEWARE[0]]).read_text()
    assert os.environ[MIDDLEWARE[2]] == "1"
    for name in MIDDLEWARE:
        for other in MIDDLEWARE:
            monkeypatch.delenv(other, raising=False)
        monkeypatch.setenv(name, "/home/user/own.xml")
        default_environment()
        assert {other: os.environ[other] for other in MIDDLEWARE if other in os.environ} == {name: "/home/user/own.xml"}


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
    code = f"from machine_tool_calibration.nodes.client import Client; Client({ros_domain}).close()"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=900, check=False)
    assert done.returncode == 0, done.stderr
    assert list(tmp_path.glob("ros-log-*/*.log"))
