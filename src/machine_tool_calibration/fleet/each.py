# SPDX-License-Identifier: Apache-2.0
"""The same work for each of many: on Dask's workers, or one after the other in this process.

Dask hands the work out, starts workers that died again and repeats what they had not handed in. What is worked out is
the same bit for bit wherever that is: linear algebra takes one thread, and nothing is summed over workers.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any, Generic, TypeVar

from machine_tool_calibration.errors import CalibrationError, one_line
from machine_tool_calibration.estimation.reduction import single_blas

if TYPE_CHECKING:
    from distributed import Client, LocalCluster

# Without these a session takes a quarter more time: for a profiler that looks at the stack every 10 ms, and to fetch
# memory anew that was handed back to the system after every array, by a threshold of Dask's or an arena of a thread.
_SWIFT = {
    "distributed.worker.profile.enabled": False,
    "distributed.nanny.pre-spawn-environ": {
        "MALLOC_ARENA_MAX": 1, "OMP_NUM_THREADS": 1, "MKL_NUM_THREADS": 1, "OPENBLAS_NUM_THREADS": 1,
    },
}  # fmt: skip
_PATIENCE = "10s"  # how long a scheduler may take to answer
_LOOK = 2.0  # seconds between two looks whether processes of this machine are gone for good
# Of processes of this machine. What dies is told in the answer, and not in lines between those of the progress.
_LOCAL: dict[str, Any] = {
    "threads_per_worker": 1,
    "silence_logs": logging.CRITICAL,
    "dashboard_address": "127.0.0.1:0",
    "scheduler_kwargs": {"dashboard": False},
}

Item = TypeVar("Item")
Found = TypeVar("Found")


@dataclass(frozen=True)
class Done(Generic[Item, Found]):
    """The work for one of many."""

    item: Item  # what it was done for
    found: Found | None  # what came of it; None where it failed
    problem: str = ""  # why it failed, in one line; empty where it did not


def each(
    work: Callable[[Item], Found], items: Sequence[Item], *, scheduler: str | None = None, workers: int | None = None
) -> Iterator[Done[Item, Found]]:
    """What came of the work for each item as soon as it is finished; one that fails is told as such, and ends nothing.

    By a Dask scheduler (address such as tcp://10.0.0.5:8786), or by so many processes of this machine, as many as it
    has processors if None; with 0 one item after the other in this process, else in any order. Work, items and what it
    gives have to be such as pickle can send; on a cluster the work finds the files that items name under the same
    names. A CalibrationError if Dask is not installed, or its scheduler does not answer or goes away.
    """
    if workers == 0 and scheduler is None:
        yield from map(partial(_attempt, work), items)
        return
    with ExitStack() as stack:
        yield from _on_dask(_client(stack, scheduler, workers), work, items)


def _attempt(work: Callable[[Item], Found], item: Item) -> Done[Item, Found]:
    try:
        with single_blas():
            return Done(item, work(item))
    except CalibrationError as error:
        return Done(item, None, one_line(error))
    except Exception as error:  # a fault of this package shall not end the work for all others either
        return Done(item, None, f"unexpected {type(error).__name__}: {one_line(error)}")


def _client(stack: ExitStack, scheduler: str | None, workers: int | None) -> Client:
    """Of the scheduler, or of processes that end with the stack."""
    try:
        import dask
        from distributed import Client, LocalCluster
    except ImportError:
        raise CalibrationError(
            "many sessions at once need Dask: pip install 'machine_tool_calibration[fleet]' "
            "(or --workers 0: one after the other, without it)"
        ) from None
    try:
        if not scheduler:
            stack.enter_context(dask.config.set(_SWIFT))
        place = scheduler or _kept(stack.enter_context(LocalCluster(n_workers=workers, **_LOCAL)))
        return stack.enter_context(Client(place, timeout=_PATIENCE))
    except (OSError, ValueError) as error:
        raise CalibrationError(f"{scheduler or 'Dask'}: no scheduler answers: {one_line(error)}") from None


def _kept(cluster: LocalCluster) -> LocalCluster:
    """With as many processes as it has now: what watches over one gives up where it dies while it is being started."""
    count = len(cluster.workers)

    def keep() -> None:
        if cluster.status.name == "running":
            cluster.scale(count)
            cluster.loop.call_later(_LOOK, keep)

    cluster.loop.add_callback(keep)
    return cluster


def _on_dask(client: Client, work: Callable[[Item], Found], items: Sequence[Item]) -> Iterator[Done[Item, Found]]:
    from distributed import CancelledError, as_completed
    from distributed.scheduler import KilledWorker

    attempt = partial(_attempt, work)
    futures = client.map(attempt, items, pure=False)  # two items that are equal are two
    named = dict(zip((future.key for future in futures), items, strict=True))
    finished = as_completed(futures)
    del futures  # what has been taken over need not stay in the workers' memory
    suspects: list[Item] = []
    try:
        for future in finished:
            try:
                yield future.result()
            except KilledWorker:
                suspects.append(named[future.key])
        # Dask suspects all that waited beside what ended a process as well: by itself each shows what it does.
        for item in suspects:
            try:
                yield client.submit(attempt, item, pure=False).result()
            except KilledWorker:
                yield Done(item, None, "every process that worked on it died")
    except CancelledError as error:
        raise CalibrationError(f"Dask's scheduler went away: {one_line(error)}") from None
