# SPDX-License-Identifier: Apache-2.0
"""Circles as a procedure: place after place around the centre, counter-clockwise and clockwise in every repeat."""

from collections.abc import Iterator, Mapping
from itertools import product
from typing import Any

import numpy as np

from machine_tool_calibration.arrays import Array, IntArray
from machine_tool_calibration.errors import SessionError
from machine_tool_calibration.methods.ball_bar.circle import places
from machine_tool_calibration.procedure.description import Procedure, Spread
from machine_tool_calibration.procedure.steps import Step, check_travel
from machine_tool_calibration.session.description import BallBar, CircleSetup


def circle_steps(procedure: Procedure) -> Iterator[Step]:
    """Setup by setup, repeat by repeat, both ways round, with one place of run-in before the first.

    Raises:
        SessionError: the path does not name the angles of the circle, or a circle leaves the travel.
    """
    session = procedure.session.as_a(BallBar)
    angles = _angles(procedure)
    number, last = 0, ""
    for setup, repeat, sense in product(session.setups, range(session.repeats), (1, -1)):
        forth = angles[::sense]
        # The other way round the circle is entered where it ends.
        run_in = forth[0] - sense * abs(forth[1] - forth[0])
        before, direction = _place(procedure, setup, run_in), dict.fromkeys("xyz", 1)
        for k, angle in enumerate(forth):
            position = _place(procedure, setup, angle)
            for axis, value in position.items():
                if value != before[axis]:
                    direction[axis] = 1 if value > before[axis] else -1
            yield Step(
                number, setup.id, repeat, position, dict(direction), (before,) if k == 0 else (),
                (position["x"], position["y"], position["z"]), points=False, datum=setup.id != last,
            )  # fmt: skip
            before, number, last = position, number + 1, setup.id


def _angles(procedure: Procedure) -> list[float]:
    grid = procedure.path.grid or {}
    if set(grid) != {"angle"}:
        raise SessionError(
            f"{procedure.source}: path of circles is grid: {{angle: …}}, from the plane's first axis towards "
            "its second, rad; centre and radius are the setups'"
        )
    entry = grid["angle"]
    angles = entry.values() if isinstance(entry, Spread) else list(entry)
    if len(angles) < 2 or not (np.diff(angles) > 0).all():
        raise SessionError(f"{procedure.source}: path.grid.angle must increase, over two angles at least")
    return angles


def _place(procedure: Procedure, setup: CircleSetup, angle: float) -> Mapping[str, float]:
    # To the picometre, so that an axis that stands has not moved.
    place = dict(zip("xyz", np.round(places(setup, np.array([angle]))[0][0], 12).tolist(), strict=True))
    check_travel(procedure, {axis: place[axis] for axis in setup.plane.lower()}, f"circle {setup.id} reaches")
    return place


def nominal(
    procedure: Procedure, steps: tuple[Step, ...], setup: IntArray
) -> tuple[Array, dict[str, Array], dict[str, Any]]:
    """No deviation, of a bar at rest."""
    return np.zeros(len(steps)), {}, {}
