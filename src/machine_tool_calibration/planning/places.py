# SPDX-License-Identifier: Apache-2.0
"""Further places of the instrument or the part: another station, another angle of C, further diagonals."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from machine_tool_calibration.arrays import Array, IntArray, gaps_around
from machine_tool_calibration.instruments.tracking import pointing
from machine_tool_calibration.methods.probing.geometry import touches
from machine_tool_calibration.methods.rotary_axis.spec import on_table
from machine_tool_calibration.planning.options import Option
from machine_tool_calibration.planning.sensing import Changed, appended, first_repetition, fresh_id
from machine_tool_calibration.session.description import Probing, RotaryAxis, Setup, TrackingInterferometer
from machine_tool_calibration.session.session import Session
from machine_tool_calibration.words import say

__all__ = ["further_angles", "further_stations"]


def _in_one_more(session: Session, setup: Setup, changed: Changed) -> tuple[Session, float | None]:
    """The session followed by readings in a setup that is new, and their time, s."""
    description = session.description
    whole = description.model_copy(update={"setups": (*description.setups, setup)})
    new = np.full(len(changed.rows), len(description.setups), dtype=np.int64)
    return appended(session, changed, setup=new, description=whole)


def further_stations(session: Session, description: TrackingInterferometer | RotaryAxis) -> Iterator[Option]:
    """A station in the widest gap between the others as seen from the targets, and one twice as far."""
    old = np.array([setup.position for setup in description.setups])
    used = np.unique(session.readings.setup)
    rows = first_repetition(session, [int(used[0])])
    points = _points(session, description, rows)
    middle = points.mean(axis=0)
    arm = old[used] - middle
    angle = np.sort(np.arctan2(arm[:, 1], arm[:, 0]))
    gaps = np.diff(angle, append=angle[0] + 2 * np.pi)
    widest = int(np.argmax(gaps))
    at = angle[widest] + gaps[widest] / 2
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
            if getattr(description, "dimension", 3) == 2:
                changed["elevation"] = np.zeros(len(points))
        at_words = ", ".join(f"{v:.2f}" for v in place)
        words = say(f"measure.{where}", place=at_words)
        extended = _in_one_more(session, setup, Changed(rows, changed, distance - distance[0]))
        yield Option.of(session, "station", words, extended, "setting up the instrument")


def _points(session: Session, description: TrackingInterferometer | RotaryAxis, rows: IntArray) -> Array:
    readings = session.readings.select(rows)
    if isinstance(description, TrackingInterferometer):
        return readings.position()
    return on_table(session, readings)


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
    extended = _in_one_more(session, setup, Changed(rows, changed))
    yield Option.of(session, "index", say("measure.angle", angle=f"{np.degrees(c):.0f}"), extended)
