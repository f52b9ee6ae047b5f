# SPDX-License-Identifier: Apache-2.0
"""What fails is told and ends nothing; with Dask and without it is the same, also where processes die."""

import multiprocessing
import os
import signal
import sys
from collections.abc import Iterator
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from machine_tool_calibration.errors import CalibrationError
from machine_tool_calibration.fleet.each import _LOCAL, _kept, each, in_order


@pytest.fixture(scope="module")
def scheduler() -> Iterator[str]:
    """Address of a cluster of two workers, which know nothing of this file."""
    distributed = pytest.importorskip("distributed")
    import cloudpickle

    cloudpickle.register_pickle_by_value(sys.modules[__name__])
    with distributed.LocalCluster(n_workers=2, **_LOCAL) as cluster:
        yield _kept(cluster).scheduler_address
    cloudpickle.unregister_pickle_by_value(sys.modules[__name__])


def halved(number: int) -> int:
    """Refuses odd numbers; 13 is a fault."""
    if number == 13:
        raise ZeroDivisionError("13\nis none")
    if number % 2:
        raise CalibrationError(f"{number} is odd")
    return number // 2


def test_what_fails_is_told_and_ends_nothing() -> None:
    found = list(each(halved, [2, 3, 13, 8], workers=0))
    assert [one.item for one in found] == [2, 3, 13, 8]
    assert [one.found for one in found] == [1, None, None, 4]
    assert [one.problem for one in found] == ["", "3 is odd", "unexpected ZeroDivisionError: 13 is none", ""]


def test_processes_of_this_machine_end_with_it() -> None:
    pytest.importorskip("distributed")
    before = set(multiprocessing.active_children())
    assert sorted(one.found for one in each(abs, [-1, -2], workers=1) if one.found) == [1, 2]
    assert set(multiprocessing.active_children()) <= before  # here, as those of `scheduler` come and go


def test_without_dask_it_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(CalibrationError, match=r"pip install 'machine_tool_calibration\[fleet\]'.*--workers 0"):
        list(each(halved, [2]))


def test_what_is_no_scheduler_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("distributed")
    monkeypatch.setattr("machine_tool_calibration.fleet.each._PATIENCE", "0.5s")
    for address in ("tcp://127.0.0.1:9", "nonsense://there"):
        with pytest.raises(CalibrationError, match=f"{address}: no scheduler answers"):
            list(each(halved, [2], scheduler=address))


def solved(seed: int) -> bytes:
    """Of a system of equations, whose last bits depend on the order of the sums."""
    rng = np.random.default_rng(seed)
    return np.linalg.lstsq(rng.standard_normal((300, 80)), rng.standard_normal(300), rcond=None)[0].tobytes()


def test_on_dask_it_is_the_same_bit_for_bit(scheduler: str) -> None:
    there = {one.item: one.found for one in each(solved, range(12), scheduler=scheduler)}
    assert there == {one.item: one.found for one in each(solved, range(12), workers=0)}
    failed = sorted(one.problem for one in each(halved, [2, 3, 13, 8], scheduler=scheduler) if one.found is None)
    assert failed == ["3 is odd", "unexpected ZeroDivisionError: 13 is none"]


def dying(number: int, folder: Path, *, always: bool) -> int:
    """Of 5 the process dies, the first time or always."""
    mark = folder / "died"
    if number == 5 and (always or not mark.exists()):
        mark.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return number * number


def test_a_killed_worker_loses_nothing(scheduler: str, tmp_path: Path) -> None:
    work = partial(dying, folder=tmp_path, always=False)
    found = {one.item: one.found for one in each(work, range(20), scheduler=scheduler)}
    assert (tmp_path / "died").exists() and found == {number: number * number for number in range(20)}


def test_what_kills_every_process_is_told_and_nothing_beside_it_is_lost(scheduler: str, tmp_path: Path) -> None:
    work = partial(dying, folder=tmp_path, always=True)
    found = {one.item: one for one in each(work, range(12), scheduler=scheduler)}
    assert found.pop(5).problem == "every process that worked on it died"
    assert {number: one.found for number, one in found.items()} == {n: n * n for n in range(12) if n != 5}


@pytest.mark.timeout(300)
def test_processes_that_are_gone_for_good_are_replaced() -> None:
    """Dask's own watch gives up where one dies while it is being started: without the replacement this would wait."""
    distributed, dask = pytest.importorskip("distributed"), pytest.importorskip("dask")
    with (
        dask.config.set({"distributed.deploy.lost-worker-timeout": "200ms"}),
        distributed.LocalCluster(n_workers=1, **_LOCAL) as cluster,
    ):
        _kept(cluster)
        (watch,) = cluster.workers.values()
        cluster.sync(watch.close)
        assert in_order(abs, [-1, -2], scheduler=cluster.scheduler_address) == [1, 2]


def test_in_order_nothing_may_fail() -> None:
    assert in_order(halved, [8, 2, 2, 4], workers=0) == [4, 1, 1, 2]
    with pytest.raises(CalibrationError, match="3: 3 is odd"):
        in_order(halved, [2, 3], workers=0)
