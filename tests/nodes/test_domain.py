# SPDX-License-Identifier: Apache-2.0
"""Two graphs on one machine never get the same domain id by chance."""

import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager

import pytest

from machine_tool_calibration.errors import CalibrationError
from machine_tool_calibration.nodes.ros.domain import claimed_domain, free_domain

HOLDER = """
import os, sys
user = int(sys.argv[1])
from machine_tool_calibration.nodes.ros.domain import free_domain
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
    with claimed_domain() as first, claimed_domain() as second, claimed_domain(230) as third:
        assert [first, second, third] == [17, 17, 230]
    monkeypatch.setenv("ROS_DOMAIN_ID", "")
    with claimed_domain() as first, claimed_domain() as second:
        assert first != second
    for wrong in ("233", "-1", "nine"):
        monkeypatch.setenv("ROS_DOMAIN_ID", wrong)
        with pytest.raises(CalibrationError, match="not a whole number from 0 to 232"), claimed_domain():
            pass
