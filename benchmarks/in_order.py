# SPDX-License-Identifier: Apache-2.0
"""Draws of a benchmark, spread over the processes of this machine or a cluster."""

from collections.abc import Callable, Sequence
from functools import partial

from machine_tool_calibration.errors import CalibrationError
from machine_tool_calibration.fleet.each import Found, Item, each


def in_order(
    work: Callable[[Item], Found], items: Sequence[Item], *, scheduler: str | None = None, workers: int | None = None
) -> list[Found]:
    """What `each` gives of all items, in their order: where none may fail.

    A CalibrationError as for `each`, or the work for an item failed.
    """
    found: dict[int, Found] = {}
    numbered = list(enumerate(items))
    for one in each(partial(_numbered, work), numbered, scheduler=scheduler, workers=workers):
        if one.found is None:
            raise CalibrationError(f"{one.item[1]}: {one.problem}")
        found[one.item[0]] = one.found[0]
    return [found[k] for k in range(len(numbered))]


def _numbered(work: Callable[[Item], Found], numbered: tuple[int, Item]) -> tuple[Found]:
    return (work(numbered[1]),)
