# SPDX-License-Identifier: Apache-2.0
"""Sessions are found below a folder, and each is worked out as if it were the only one.
What fails is told and ends nothing; with Dask and without it is the same, also where processes die.
"""

import json
import multiprocessing
import os
import signal
import sys
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from shutil import copytree

import numpy as np
import pandas as pd
import pytest
from in_order import in_order

from machine_tool_calibration.cli.diagnosing import Wanted, fit_one
from machine_tool_calibration.errors import CalibrationError, SessionError
from machine_tool_calibration.fleet.each import _LOCAL, _kept, each
from machine_tool_calibration.fleet.parquet import identified_tables, write_tables
from machine_tool_calibration.fleet.sessions import Place, evaluated, identified, is_known, places
from machine_tool_calibration.interface.identification import identify
from machine_tool_calibration.reports.result_tables import tidy
from machine_tool_calibration.session.folder import read_session
from machine_tool_calibration.session.provenance import data_hash

LABELS = ["lathe/2026-01-05", "mill/2026-01-06", "mill/x"]
FIT = partial(fit_one, wanted=Wanted((), (), "rigid_body", ()))


def test_sessions_are_found_in_and_below_folders(measurements: Path, tmp_path: Path) -> None:
    assert [one.label for one in places([measurements])] == LABELS
    (alone,) = places([measurements / "mill/x"])
    assert alone.label == "x"
    assert [one.label for one in places([measurements, measurements / "mill"])] == LABELS
    assert [one.label for one in places([measurements / "mill", measurements / "lathe"])] == LABELS
    assert alone.told(f"{alone.path}/observations.csv: broken") == "observations.csv: broken"
    with pytest.raises(SessionError, match="no session"):
        places([tmp_path])
    with pytest.raises(SessionError, match="no such folder"):
        places([tmp_path / "nowhere"])


@pytest.mark.long
def test_links_are_followed_and_a_folder_is_found_once(measurements: Path, tmp_path: Path) -> None:
    (tmp_path / "links").mkdir()
    (tmp_path / "links" / "one").symlink_to(measurements / "mill/x", target_is_directory=True)
    (tmp_path / "links" / "round").symlink_to(tmp_path / "links", target_is_directory=True)
    (found,) = places([tmp_path / "links"])
    assert found.label == "one"
    assert [one.label for one in places([measurements, tmp_path / "links"])] == [
        str((measurements / label).relative_to(os.path.commonpath([measurements, tmp_path / "links"])))
        for label in LABELS
    ]


def test_each_is_identified_as_it_is_alone_with_dask_and_without(measurements: Path, tmp_path: Path) -> None:
    """In the variant of the model that is wanted; the one that is broken has its line."""
    pytest.importorskip("distributed")
    tables = []
    for workers in (0, 2):
        done = list(each(partial(identified, fit=FIT), places([measurements]), workers=workers))
        tables.append(identified_tables(done))
    for name in ("sessions", "values"):
        pd.testing.assert_frame_equal(tables[0][name], tables[1][name], check_exact=True)
    sessions, values = tables[0]["sessions"].set_index("session"), tables[0]["values"]
    assert [bool(problem) for problem in sessions["problem"]] == [False, False, True]
    assert "observations.csv" in sessions["problem"][LABELS[2]]
    assert list(sessions["model"])[:2] == ["rigid_body", "rigid_body"]
    alone = tidy(identify(measurements / LABELS[1], model="rigid_body").result)
    own = values[values["session"] == LABELS[1]].reset_index(drop=True)[list(alone)]
    np.testing.assert_array_equal(own["value"], alone["value"])
    write_tables(tables[1], tmp_path)
    duckdb = pytest.importorskip("duckdb")
    count = f"SELECT count(*) FROM '{tmp_path}/values.parquet' WHERE session = '{LABELS[1]}' AND u > 0"
    assert duckdb.sql(count).fetchall() == [(int((alone["u"] > 0).sum()),)]
    pd.testing.assert_frame_equal(pd.read_parquet(tmp_path / "values.parquet"), values, check_dtype=False)


@pytest.mark.long
def test_folders_say_machine_and_date_where_the_session_does_not(measurements: Path, tmp_path: Path) -> None:
    place = places([measurements])[0]
    found = evaluated(place, FIT)
    assert (found.entry.machine, found.entry.date, found.entry.label) == ("lathe", "2026-01-05", LABELS[0])
    assert {"EXX", "B_mean_X", "volumetric"} <= {size.name for size in found.entry.sizes}
    assert json.loads(json.dumps(found.diagnosis))["verdict"] == "adequate"
    copytree(place.path, tmp_path / "january")
    with pytest.raises(CalibrationError, match="nothing says which machine"):
        evaluated(Place("january", tmp_path / "january"), FIT)


def test_a_session_is_known_however_its_table_is_laid_out(measurements: Path, tmp_path: Path) -> None:
    place = places([measurements])[0]
    known = frozenset({data_hash(read_session(place.path))})
    assert is_known(place, known) and not is_known(place, frozenset({"0"}))
    copytree(place.path, tmp_path / "again")
    table = tmp_path / "again/observations.csv"
    table.write_text(table.read_text(encoding="utf-8").replace(",", " , "), encoding="utf-8")
    assert is_known(Place("again", tmp_path / "again"), known)
    assert not is_known(places([measurements])[2], known)


@pytest.fixture(scope="module")
def scheduler() -> Iterator[str]:
    """Address of a cluster of two workers, which know nothing of this file; what ended two of them is not tried again.

    By Dask's own choice it would be four: to start one takes two seconds.
    """
    distributed, dask = pytest.importorskip("distributed"), pytest.importorskip("dask")
    import cloudpickle

    cloudpickle.register_pickle_by_value(sys.modules[__name__])
    once_more = dask.config.set({"distributed.scheduler.allowed-failures": 1})
    with once_more, distributed.LocalCluster(n_workers=2, **_LOCAL) as cluster:
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


@pytest.mark.long
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


@pytest.mark.long
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


@pytest.mark.long
def test_a_killed_worker_loses_nothing(scheduler: str, tmp_path: Path) -> None:
    work = partial(dying, folder=tmp_path, always=False)
    found = {one.item: one.found for one in each(work, range(20), scheduler=scheduler)}
    assert (tmp_path / "died").exists() and found == {number: number * number for number in range(20)}


@pytest.mark.long
def test_what_kills_every_process_is_told_and_nothing_beside_it_is_lost(scheduler: str, tmp_path: Path) -> None:
    work = partial(dying, folder=tmp_path, always=True)
    found = {one.item: one for one in each(work, range(12), scheduler=scheduler)}
    assert found.pop(5).problem == "every process that worked on it died"
    assert {number: one.found for number, one in found.items()} == {n: n * n for n in range(12) if n != 5}


@pytest.mark.long
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
