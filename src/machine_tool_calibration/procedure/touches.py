"""The steps of a probing procedure: every point at every angle of C, approached along its normal."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import product

from machine_tool_calibration.errors import SessionError
from machine_tool_calibration.instruments.touch import Part
from machine_tool_calibration.procedure.description import Procedure
from machine_tool_calibration.procedure.plan import Step
from machine_tool_calibration.session.description import Probing

__all__ = ["touch_steps"]

_MOVED = 1e-9


def touch_steps(procedure: Procedure) -> Iterator[Step]:
    """Angle by angle, repetition by repetition, all points; every second repetition backwards if so planned.

    A step's position is where the touch begins, `motion.approach` off the surface. `path.points` says where axes stand
    that the touches leave alone (z); between points Z goes to the upper end of its travel, if the session names it.

    Raises:
        SessionError: no single height is given, a touch is outside the travel, or it could be meant for two points.
    """
    session = procedure.session
    assert isinstance(session, Probing)
    held = _held(procedure)
    part, standoff = Part(session), procedure.motion.approach
    if standoff <= 0:
        raise SessionError(f"procedure {procedure.name}: motion.approach must be positive: a touch begins off the part")
    safe = {"z": session.machine.travel["z"][1]} if "z" in session.machine.travel else {}
    order = range(len(session.workpiece))
    before: dict[str, float] | None = None
    last = {"x": 1, "y": 1, "c": 1}
    number = 0
    for setup, repeat in product(session.setups, range(session.repeats)):
        back = procedure.path.alternate and repeat % 2 == 1
        for point in reversed(order) if back else order:
            touch = part.touch(point, setup.c, standoff)
            position = {**touch.at(standoff), "c": setup.c, **held}
            _check(procedure, position, session.workpiece[point].id)
            part.meant(position, 2 * standoff)  # refuses where it could be meant for two points
            above = {**position, **safe}
            via = () if not safe else (above,) if before is None else ({**before, **safe}, above)
            for axis, place in position.items():
                if axis in last and before is not None and abs(place - before[axis]) > _MOVED:
                    last[axis] = 1 if place > before[axis] else -1
            approach = {a: -1 if n > 0 else 1 for a, n in zip("xy", touch.normal, strict=True) if abs(n) > _MOVED}
            yield Step(number, setup.id, repeat, position, {**last, **approach}, via, target=point)
            # The stylus backs off the way it came.
            last |= {axis: -sign for axis, sign in approach.items()}
            before, number = position, number + 1


def _held(procedure: Procedure) -> dict[str, float]:
    points = procedure.path.points
    if points is None or len(points) != 1 or {"x", "y", "c"} & points[0].keys():
        raise SessionError(
            f"procedure {procedure.name}: path of a probing procedure says only where the other axes stand, as in "
            "points: [{z: -0.01}]; the points to be touched are the workpiece's"
        )
    return dict(points[0])


def _check(procedure: Procedure, position: dict[str, float], point: str) -> None:
    for name, value in position.items():
        low, high = procedure.session.machine.travel.get(name, (float("-inf"), float("inf")))
        if not low <= value <= high:
            raise SessionError(
                f"procedure {procedure.name}: point {point!r} is touched from {name} = {value:.6g}, outside the travel "
                f"{low:g} to {high:g}"
            )
