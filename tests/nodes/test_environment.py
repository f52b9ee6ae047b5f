# SPDX-License-Identifier: Apache-2.0
"""What processes of nodes set for themselves.
Two graphs on one machine never get the same domain id by chance.
"""

import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from machine_tool_calibration.errors import CalibrationError
from machine_tool_calibration.nodes.graph import claimed_domain, free_domain
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


@pytest.mark.long
def test_a_node_starts_without_a_home(monkeypatch: pytest.MonkeyPatch, tmp_path: Path, ros_domain: int) -> None:
    monkeypatch.setenv("HOME", os.devnull)
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    code = f"from machine_tool_calibration.nodes.client import Client; Client({ros_domain}).close()"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=900, check=False)
    assert done.returncode == 0, done.stderr
    assert list(tmp_path.glob("ros-log-*/*.log"))


HOLDER = """
import os, sys
user = int(sys.argv[1])
from machine_tool_calibration.nodes.graph import free_domain
if user:
    os.setgid(user)
    os.setuid(user)
with free_domain(map(int, sys.argv[2:])) as domain:
    print(domain, flush=True)
    sys.stdin.read()
"""


@contextmanager
def held_elsewhere(ids: list[int], user: int = 0) -> Iterator[tuple[int, subprocess.Popen[str]]]:
    """Another process, perhaps another user's, that has claimed one of these ids."""
    command = [sys.executable, "-c", HOLDER, str(user), *map(str, ids)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdin is not None and process.stdout is not None
        yield int(process.stdout.readline()), process
        process.stdin.close()


@pytest.fixture
def ids() -> list[int]:
    """Three ids that nobody else looks for: a claim does not ask whether there are such domains."""
    first = 1000 + 3 * os.getpid()
    return [first, first + 1, first + 2]


def test_two_processes_never_have_the_same(ids: list[int]) -> None:
    with held_elsewhere(ids) as (first, _), held_elsewhere(ids) as (second, _), free_domain(ids) as third:
        assert [first, second, third] == ids
        with pytest.raises(CalibrationError, match="no ROS domain id is free"), free_domain(ids):
            pass


@pytest.mark.skipif(os.getuid() != 0, reason="only root can become another user")
@pytest.mark.parametrize("user", [1, 65534])
def test_nor_have_two_users(ids: list[int], user: int) -> None:
    with held_elsewhere(ids, user) as (theirs, _), free_domain(ids) as ours:
        assert [theirs, ours] == ids[:2]


def test_a_claim_ends_with_its_process_however_that_ends(ids: list[int]) -> None:
    with held_elsewhere(ids) as (first, process):
        assert first == ids[0]
        process.kill()
        process.wait(timeout=900)
        with free_domain(ids) as found:
            assert found == ids[0]


def test_a_claim_ends_with_its_context(ids: list[int]) -> None:
    with pytest.raises(KeyError), free_domain(ids):
        raise KeyError
    with free_domain(ids) as found:
        assert found == ids[0]


def test_a_measurement_takes_the_id_that_is_asked_for(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ROS_DOMAIN_ID", "17")
    with claimed_domain() as first, claimed_domain(namespace="cell") as second, claimed_domain(230) as third:
        assert [first, second, third] == [17, 17, 230]
        clash = pytest.raises(
            CalibrationError, match="another measurement is running in ROS domain 17, namespace /cell"
        )
        with clash, claimed_domain(17, "/cell/"):
            pass
    with claimed_domain() as again:
        assert again == 17
    monkeypatch.setenv("ROS_DOMAIN_ID", "")
    with claimed_domain() as first, claimed_domain() as second:
        assert first != second
    for wrong in ("233", "-1", "nine"):
        monkeypatch.setenv("ROS_DOMAIN_ID", wrong)
        with pytest.raises(CalibrationError, match="not a whole number from 0 to 232"), claimed_domain():
            pass
