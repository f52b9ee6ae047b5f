# SPDX-License-Identifier: Apache-2.0
"""Further places of the instrument or the part: a station, an angle of C, runs of a step diagonal."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from machine_tool_calibration.arrays import Array, gaps_around
from machine_tool_calibration.methods.probing.geometry import touches
from machine_tool_calibration.methods.rotary_axis.spec import on_table
from machine_tool_calibration.methods.step_diagonal.geometry import Run, halts_of, run_of, runs_of
from machine_tool_calibration.planning.options import Option
from machine_tool_calibration.planning.sensing import Changed, appended, first_repetition, fresh_id
from machine_tool_calibration.procedure.steps import pointing
from machine_tool_calibration.session.description import (
    Probing,
    RotaryAxis,
    Setup,
    StepDiagonal,
    TrackingInterferometer,
)
from machine_tool_calibration.session.session import Session
from machine_tool_calibration.words import say, together

_ORDERS = ("yzx", "zxy")
# The four space diagonals; run backwards each is the same one.
_SPACE = ((1.0, 1.0, 1.0), (-1.0, 1.0, 1.0), (1.0, -1.0, 1.0), (-1.0, -1.0, 1.0))
_MOUNTED = "mounting the mirror again"


def further_runs(session: Session, description: StepDiagonal) -> Iterator[Option]:
    """Runs that were not made: missing space diagonals, linear runs off the edges, other orders of moves."""
    runs = runs_of(description)
    used = np.unique(session.readings.setup).tolist()
    yield from _diagonals(session, runs, used)
    yield from _offset(session, runs, used)
    yield from _orders(session, runs, used)


def _diagonals(session: Session, runs: Sequence[Run], used: Sequence[int]) -> Iterator[Option]:
    """The space diagonals that no setup runs, in the order of moves of the first that was run."""
    like = [k for k in used if np.all(runs[k].sign)]
    made = {tuple((runs[k].sign * runs[k].sign[2]).tolist()) for k in like}  # run towards increasing z
    missing = [sign for sign in _SPACE if sign not in made]
    if not like or not missing:
        return
    (low, high), order = _reach(runs, used), runs[like[0]].order
    new: list[tuple[int, dict[str, Any]]] = []
    for sign in missing:
        name = "".join("p" if s > 0 else "n" for s in sign) + (f"_{order}" if order != "xyz" else "")
        start = tuple(np.where(np.array(sign) > 0, low, high).tolist())
        new.append((like[0], {"id": name, "direction": sign, "start": start}))
    names = together((changed["id"][:3] for _, changed in new), say("text.and"))
    yield _option(session, new, "diagonal", say("measure.diagonals", n=len(new), names=names))


def _offset(session: Session, runs: Sequence[Run], used: Sequence[int]) -> Iterator[Option]:
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
                new.append((k, {"id": f"{runs[k].order.upper()}_at_{'xyz'[axis]}", "start": tuple(start.tolist())}))
    if new:
        axes = ", ".join(dict.fromkeys(runs[k].order.upper() for k, _ in new))
        yield _option(session, new, "offset", say("measure.offset", axes=axes))


def _orders(session: Session, runs: Sequence[Run], used: Sequence[int]) -> Iterator[Option]:
    """Every diagonal in an order of the single-axis moves in which it was not run."""
    for order in _ORDERS:
        have = {(runs[k].name, runs[k].order) for k in used}
        todo = {runs[k].name: k for k in used if runs[k].diagonal and len(runs[k].order) == 3}
        todo = {name: k for name, k in todo.items() if (name, order) not in have}
        if todo:
            new = [(k, {"id": f"{name}_{order}"}) for name, k in todo.items()]
            words = say("measure.diagonal_order", names=", ".join(todo), order=order.upper())
            yield _option(session, new, "order", words)


def _reach(runs: Sequence[Run], used: Sequence[int]) -> tuple[Array, Array]:
    """(3,) lower and (3,) upper ends of what was measured, m."""
    ends = np.array([place for k in used for place in (runs[k].start, runs[k].start + runs[k].motion)])
    return ends.min(axis=0), ends.max(axis=0)


def _option(session: Session, new: Sequence[tuple[int, dict[str, Any]]], kind: str, words: str) -> Option:
    """Runs that are made once, each at the pace of one that was made, with what its setup says otherwise."""
    description = session.description.as_a(StepDiagonal)
    setups = list(description.setups)
    rows, position, sign, displacement, setup = [], [], [], [], []
    for like, changed in new:
        name = fresh_id(changed["id"], [s.id for s in setups])
        own = description.setups[like].model_copy(update={**changed, "id": name})
        path, run = halts_of(own, description), run_of(own, description)
        mine = first_repetition(session, [like])
        rows.append(mine[np.minimum(np.arange(len(path)), len(mine) - 1)])
        position.append(path)
        sign.append(np.tile(run.sign, (len(path), 1)))
        displacement.append((path - run.start) @ run.beam)
        setup.append(np.full(len(path), len(setups), dtype=np.int64))
        setups.append(own)
    at, towards = np.concatenate(position), np.concatenate(sign)
    columns = {axis: at[:, j] for j, axis in enumerate("xyz") if axis in session.readings.columns}
    columns |= {f"dir_{a}": towards[:, j] for j, a in enumerate("xyz") if f"dir_{a}" in session.readings.columns}
    made = Changed(np.concatenate(rows), columns, np.concatenate(displacement))
    whole = description.model_copy(update={"setups": tuple(setups)})
    extended = appended(session, made, np.concatenate(setup), whole)
    return Option(kind=kind, measure=words, aside=_MOUNTED, **extended)


def _in_one_more(session: Session, setup: Setup, changed: Changed, kind: str, words: str, aside: str = "") -> Option:
    """The session followed by readings in a setup that is new."""
    description = session.description
    whole = description.model_copy(update={"setups": (*description.setups, setup)})
    new = np.full(len(changed.rows), len(description.setups), dtype=np.int64)
    return Option(kind=kind, measure=words, aside=aside, **appended(session, changed, new, whole))


def further_stations(session: Session, description: TrackingInterferometer | RotaryAxis) -> Iterator[Option]:
    """A station in the widest gap between the others as seen from the targets, and one twice as far."""
    old = np.array([setup.position for setup in description.setups])
    used = np.unique(session.readings.setup)
    rows = first_repetition(session, [int(used[0])])
    taken = session.readings.select(rows)
    points = taken.position() if isinstance(description, TrackingInterferometer) else on_table(session, taken)
    middle = points.mean(axis=0)
    arm = old[used] - middle
    angle, gaps = gaps_around(np.arctan2(arm[:, 1], arm[:, 0]))
    at = angle[np.argmax(gaps)] + gaps.max() / 2
    reach = float(np.median(np.hypot(arm[:, 0], arm[:, 1])))
    height = float(np.median(old[used, 2]))
    between = np.array([middle[0] + reach * np.cos(at), middle[1] + reach * np.sin(at), height])
    far = middle + 2.0 * arm[0]
    for place, where in ((between, "station_between"), (far, "station_far")):
        line = points - place
        distance = np.linalg.norm(line, axis=1)
        if distance.min() < 0.05:
            continue
        setup = description.setups[int(used[0])].model_copy(
            update={"id": fresh_id("new", session.setup_ids), "position": tuple(float(v) for v in place)}
        )
        changed = {}
        if "azimuth" in session.readings.columns:
            changed["azimuth"], changed["elevation"] = pointing(points, place)
            if description.axes == "xy":
                changed["elevation"] = np.zeros(len(points))
        words = say(f"measure.{where}", place=", ".join(f"{v:.2f}" for v in place))
        readings = Changed(rows, changed, distance - distance[0])
        yield _in_one_more(session, setup, readings, "station", words, "setting up the instrument")


def further_angles(session: Session, description: Probing) -> Iterator[Option]:
    """The workpiece at an angle of C in the middle of the widest gap."""
    used = np.unique(session.readings.setup)
    angle, gaps = gaps_around(np.array([description.setups[s].c for s in used]))
    widest = int(np.argmax(gaps))
    inner = np.argmax(gaps[:-1]) if len(gaps) > 1 else widest
    proposals = {float((angle[k] + gaps[k] / 2) % (2 * np.pi)) for k in {widest, int(inner)}}
    for c in sorted(proposals):
        yield from _at_index(session, description, int(used[0]), c)


def _at_index(session: Session, description: Probing, like: int, c: float) -> Iterator[Option]:
    rows = first_repetition(session, [like])
    readings = session.readings
    turned = np.full(len(rows), c)
    taken = readings.select(rows)
    where = touches(description, replace(taken, columns={**taken.columns, "c": turned}), session.rotation_sign)
    travel = description.machine.travel
    reach = np.ones(len(rows), dtype=bool)
    for j, axis in enumerate("xy"):
        if axis in travel:
            low, high = travel[axis]
            reach &= (where.contact[:, j] >= low) & (where.contact[:, j] <= high)
    if reach.mean() < 0.5:
        return
    rows, contact, normal = rows[reach], where.contact[reach], where.normal[reach]
    changed = {"x": contact[:, 0], "y": contact[:, 1], "c": turned[reach]}
    for j, axis in enumerate("xy"):
        if f"dir_{axis}" in readings.columns:
            changed[f"dir_{axis}"] = np.where(normal[:, j] > 0, -1.0, 1.0)
    setup = description.setups[like].model_copy(update={"id": fresh_id("new", session.setup_ids), "c": c})
    words = say("measure.angle", angle=f"{np.degrees(c):.0f}")
    yield _in_one_more(session, setup, Changed(rows, changed), "index", words)
