# SPDX-License-Identifier: Apache-2.0
"""Further runs of a step diagonal: the diagonal that is missing, other orders of the moves, runs off the edges."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.methods.step_diagonal.geometry import Run, runs_of
from machine_tool_calibration.planning.options import Option
from machine_tool_calibration.planning.sensing import Changed, appended, first_repetition, fresh_id
from machine_tool_calibration.session.description import StepDiagonal
from machine_tool_calibration.session.session import Session
from machine_tool_calibration.words import say, together

__all__ = ["further_runs"]

_ORDERS = ("yzx", "zxy")
# The four space diagonals; run backwards each is the same one.
_SPACE = ((1.0, 1.0, 1.0), (-1.0, 1.0, 1.0), (1.0, -1.0, 1.0), (-1.0, -1.0, 1.0))
_MOUNTED = "mounting the mirror again"


def further_runs(session: Session, description: StepDiagonal) -> Iterator[Option]:
    """Runs that were not made: missing space diagonals, linear runs off the edges, diagonals in other orders of moves.

    Args:
        session: what was measured.
        description: of it.
    """
    runs = runs_of(description)
    used = np.unique(session.readings.setup).tolist()
    yield from _diagonals(session, description, runs, used)
    yield from _offset(session, description, runs, used)
    yield from _orders(session, description, runs, used)


def _diagonals(
    session: Session, description: StepDiagonal, runs: Sequence[Run], used: Sequence[int]
) -> Iterator[Option]:
    """The space diagonals that no setup runs, in the order of moves of the first that was run."""
    made = {_forward(runs[k].sign) for k in used if np.all(runs[k].sign)}
    like = [k for k in used if np.all(runs[k].sign)]
    missing = [sign for sign in _SPACE if sign not in made]
    if not like or not missing:
        return
    low, high = _reach(runs, used)
    new = []
    for sign in missing:
        name = "".join("p" if s > 0 else "n" for s in sign)
        start = np.where(np.array(sign) > 0, low, high)
        motion = np.array(sign) * np.abs(runs[like[0]].motion)
        beam = motion / np.linalg.norm(motion)
        new.append((like[0], replace(runs[like[0]], id=name, name=name, sign=np.array(sign), start=start,
                                     motion=motion, beam=beam)))  # fmt: skip
    names = together((run.id for _, run in new), say("text.and"))
    yield _option(session, description, new, "diagonal", say("measure.diagonals", n=len(new), names=names))


def _offset(session: Session, description: StepDiagonal, runs: Sequence[Run], used: Sequence[int]) -> Iterator[Option]:
    """Linear runs as they were made, with each other axis at its far end."""
    low, high = _reach(runs, used)
    linear = [k for k in used if not runs[k].diagonal]
    made = {(runs[k].order, tuple(np.round(runs[k].start, 9))) for k in linear}
    new = []
    edges = {runs[k].order: k for k in reversed(linear)}  # the first of each axis
    for k in edges.values():
        for axis in range(3):
            if runs[k].sign[axis] or high[axis] - low[axis] < 1e-9:
                continue
            at = runs[k].start[axis]
            far = high[axis] if high[axis] - at >= at - low[axis] else low[axis]
            start = np.where(np.arange(3) == axis, far, runs[k].start)
            key = (runs[k].order, tuple(np.round(start, 9)))
            if key not in made:
                made.add(key)
                new.append((k, replace(runs[k], id=f"{runs[k].order.upper()}_at_{'xyz'[axis]}", start=start)))
    if new:
        axes = ", ".join(dict.fromkeys(run.order.upper() for _, run in new))
        words = say("measure.offset", axes=axes)
        yield _option(session, description, new, "offset", words)


def _orders(session: Session, description: StepDiagonal, runs: Sequence[Run], used: Sequence[int]) -> Iterator[Option]:
    """Every diagonal in an order of the single-axis moves in which it was not run."""
    for order in _ORDERS:
        have = {(runs[k].name, runs[k].order) for k in used}
        todo = {runs[k].name: k for k in used if runs[k].diagonal and len(runs[k].order) == 3}
        todo = {name: k for name, k in todo.items() if (name, order) not in have}
        if todo:
            new = [(k, replace(runs[k], id=f"{name}_{order}", order=order)) for name, k in todo.items()]
            words = say("measure.diagonal_order", names=", ".join(todo), order=order.upper())
            yield _option(session, description, new, "order", words)


def _forward(sign: Array) -> tuple[float, ...]:
    """Signs of a diagonal run towards increasing z."""
    return tuple((sign * sign[2]).tolist())


def _reach(runs: Sequence[Run], used: Sequence[int]) -> tuple[Array, Array]:
    """(3,) lower and (3,) upper ends of what was measured, m."""
    ends = np.array([place for k in used for place in (runs[k].start, runs[k].start + runs[k].motion)])
    return ends.min(axis=0), ends.max(axis=0)


def _option(
    session: Session, description: StepDiagonal, new: Sequence[tuple[int, Run]], kind: str, words: str
) -> Option:
    """Runs that are made once, each at the pace of one that was made.

    Args:
        session: what was measured.
        description: of it.
        new: for each run the setup that it is like, and the run.
        kind: of the option.
        words: what to do.
    """
    setups = list(description.setups)
    rows, position, sign, displacement, setup = [], [], [], [], []
    for like, run in new:
        path = run.path(description.blocks)
        mine = first_repetition(session, [like])
        rows.append(mine[np.minimum(np.arange(len(path)), len(mine) - 1)])
        position.append(path)
        sign.append(np.tile(run.sign, (len(path), 1)))
        displacement.append((path - run.start) @ run.beam)
        setup.append(np.full(len(path), len(setups), dtype=np.int64))
        name = fresh_id(run.id, [s.id for s in setups])
        changed = {"id": name, "direction": tuple(run.sign.tolist()), "start": tuple(run.start.tolist())}
        setups.append(description.setups[like].model_copy(update=changed))
    at, towards = np.concatenate(position), np.concatenate(sign)
    columns = {axis: at[:, j] for j, axis in enumerate("xyz") if axis in session.readings.columns}
    columns |= {f"dir_{a}": towards[:, j] for j, a in enumerate("xyz") if f"dir_{a}" in session.readings.columns}
    extended = appended(
        session,
        Changed(np.concatenate(rows), columns, np.concatenate(displacement)),
        setup=np.concatenate(setup),
        description=description.model_copy(update={"setups": tuple(setups)}),
    )
    return Option.of(session, kind, words, extended, _MOUNTED)
