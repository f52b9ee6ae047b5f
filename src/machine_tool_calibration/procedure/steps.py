# SPDX-License-Identifier: Apache-2.0
"""From a procedure to its plan: its steps, one reading each, as each method goes them, and how long they take."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import islice, product

import numpy as np

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.errors import SessionError
from machine_tool_calibration.instruments.touch import Part
from machine_tool_calibration.machine.chain import Chain
from machine_tool_calibration.procedure.description import Motion, Path, Procedure, Spread
from machine_tool_calibration.procedure.motion import AxisLimits, move
from machine_tool_calibration.session import description as sessions
from machine_tool_calibration.session.catalogue import method_spec
from machine_tool_calibration.session.method import load

_MOVED = 1e-9

Position = Mapping[str, float]


@dataclass(frozen=True, slots=True)
class Step:
    """One target to be measured."""

    number: int  # place in the plan, from 0
    setup: str  # id of the instrument's setup
    repeat: int  # repetition of that setup, from 0
    position: Position  # commanded position of each axis, m or rad
    direction: Mapping[str, int]  # sign of each axis's last move before the reading, +1 or -1
    via: tuple[Position, ...] = ()  # positions to be passed on the way, which fix the direction of approach
    aim: tuple[float, float, float] | None = None  # commanded target, m, machine frame; None for a probe
    points: bool = True  # whether a pointer directs the beam at it; otherwise the beam is fixed for each setup
    datum: bool = False  # whether the path is zeroed here, before the reading
    target: int | None = None  # index of the target on the table, or of the workpiece's point


def touch_steps(procedure: Procedure) -> Iterator[Step]:
    """Angle by angle, repetition by repetition, all points; every second repetition backwards if so planned.

    A step's position is where the touch begins, `motion.approach` off the surface. `path.points` says where axes stand
    that the touches leave alone (z); between points Z goes to the upper end of its travel, if the session names it. A
    SessionError if no single height is given, a touch is outside the travel, or it could be meant for two points.
    """
    session = procedure.session
    assert isinstance(session, sessions.Probing)
    held = _held(procedure)
    part, standoff = Part(session), procedure.motion.approach
    if standoff <= 0:
        raise SessionError(f"{procedure.source}: motion.approach must be positive: a touch begins off the part")
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
            check_travel(procedure, position, f"point {session.workpiece[point].id!r} is touched from")
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
    if points is None or len(points) != 1 or "z" not in points[0] or {"x", "y", "c"} & points[0].keys():
        raise SessionError(
            f"{procedure.source}: path of a probing procedure says only where the other axes stand, as in "
            "points: [{z: -0.01}]; the points to be touched are the workpiece's"
        )
    return dict(points[0])


def check_travel(procedure: Procedure, position: Mapping[str, float], what: str) -> None:
    """Refuse (SessionError) a position of some axes outside of their travel; `what` begins the message."""
    for name, value in position.items():
        low, high = _travel(procedure, name)
        if not low <= value <= high:
            raise SessionError(
                f"{procedure.source}: {what} {name} = {value:.6g}, outside the travel {low:g} to {high:g}"
            )


def _travel(procedure: Procedure, axis: str) -> tuple[float, float]:
    """Lower and upper end of an axis; without end where the session does not say."""
    return procedure.session.machine.travel.get(axis, (-np.inf, np.inf))


def diagonal_steps(procedure: Procedure) -> Iterator[Step]:
    """Setup by setup, run by run; the path is zeroed at the start of each run."""
    session = procedure.session
    assert isinstance(session, sessions.StepDiagonal)
    runs = []
    for index, setup in enumerate(session.setups):
        positions = session.positions(index)
        signs = {axis: sign or 1.0 for axis, sign in zip("xyz", setup.direction, strict=True)}
        runs += [(setup.id, repeat, None, positions, signs) for repeat in range(session.repeats)]
    yield from _steps(procedure, runs, points=False)


def rotary_steps(procedure: Procedure) -> Iterator[Step]:
    """Station by station, repetition by repetition: all angles target by target, or all targets angle by angle."""
    session = procedure.session
    assert isinstance(session, sessions.RotaryAxis)
    axis = session.machine.table_axis.lower()
    forth = targets_of(procedure)
    if any(set(place) != {axis} for place in forth):
        raise SessionError(f"{procedure.source}: path of a rotary axis names {axis} and nothing else")
    runs = []
    marks = range(len(session.targets))
    for setup, repeat in product(session.setups, range(session.repeats)):
        back = procedure.path.alternate and repeat % 2 == 1
        angles = forth[::-1] if back else forth
        if procedure.path.both_ways:
            angles = [*angles, *angles[::-1]]
        sense = _first_sense(angles)
        if procedure.path.targets == "at_every_angle":
            places = [angle for angle in angles for _ in marks]
            runs.append((setup.id, repeat, [*marks] * len(angles), places, sense))
        else:
            runs += [(setup.id, repeat, [mark] * len(angles), angles, sense) for mark in marks]
    yield from _steps(procedure, runs, points=True)


def _first_sense(way: Sequence[Position]) -> dict[str, float]:
    """Sense in which each axis goes on from the first position of a way: upwards where it stays."""
    moves = {axis: (place[axis] - way[0][axis] for place in way) for axis in way[0]}
    return {axis: next((np.sign(move) for move in own if move), 1.0) for axis, own in moves.items()}


def direct_steps(procedure: Procedure) -> Iterator[Step]:
    """Every run goes forth and back, with an overrun at both ends (ISO 230-2)."""
    session = procedure.session
    assert isinstance(session, sessions.Direct)
    _ = session.sense  # refused here, and not after the first reading
    forth = targets_of(procedure)
    each = product(session.setups, range(session.repeats))
    runs = [(setup.id, repeat, None, [*forth, *forth[::-1]], _first_sense(forth)) for setup, repeat in each]
    yield from _steps(procedure, runs, points=False, datum_per_run=False)


_Run = tuple[str, int, Sequence[int] | None, Sequence[Position], Mapping[str, float]]
"""Setup, repeat, target of each position, positions, sense of the first approach."""


def _steps(
    procedure: Procedure, runs: Sequence[_Run], *, points: bool, datum_per_run: bool = True, approached: bool = True
) -> Iterator[Step]:
    """Steps of runs; where these are not `approached` each from its side, the axes go from one straight to the next."""
    number = 0
    last_setup = ""
    before: dict[str, float] = {}
    direction: dict[str, int] = {}
    for setup, repeat, targets, positions, sense in runs:
        for place, position in enumerate(positions):
            target = None if targets is None else targets[place]
            via: tuple[dict[str, float], ...] = ()
            if (place == 0 and approached) or not before:
                # from wherever the axes stand: a short move makes the direction certain
                via = (_beyond(procedure, position, {axis: -sign for axis, sign in sense.items()}),)
            elif approached and position == positions[place - 1] and (targets is None or target == targets[0]):
                # a turning point is approached from the other side
                via = (_beyond(procedure, position, direction),)
            for stop in (*via, position):
                for axis, value in stop.items():
                    if axis in before and value != before[axis]:
                        direction[axis] = 1 if value > before[axis] else -1
                    direction.setdefault(axis, 1)
                before = dict(stop)
            yield Step(
                number=number,
                setup=setup,
                repeat=repeat,
                position=dict(position),
                direction=dict(direction),
                via=() if via == (position,) else via,
                aim=_aim(procedure, position, target),
                points=points,
                datum=place == 0 and (datum_per_run or setup != last_setup),
                target=target,
            )
            number, last_setup = number + 1, setup


def _beyond(procedure: Procedure, position: Mapping[str, float], sense: Mapping[str, float]) -> dict[str, float]:
    """A place beside a position, in a sense on each axis, by default below; on the other side where the travel ends."""
    place = {}
    for axis, value in position.items():
        low, high = _travel(procedure, axis)
        step = procedure.motion.approach * sense.get(axis, -1.0)
        there, other = value + step, value - step
        place[axis] = there if low <= there <= high else min(max(other, low), high)
    return place


def _aim(procedure: Procedure, position: Mapping[str, float], target: int | None) -> tuple[float, float, float]:
    """The commanded target in the machine frame."""
    session = procedure.session
    if isinstance(session, sessions.RotaryAxis) and target is not None:
        axis = session.machine.table_axis
        sign = session.rotation_sign or session.machine.rotation_sign or 1
        angle, place = sign * position[axis.lower()], list(session.targets[target].position)
        i, j = (("ABC".index(axis) + k) % 3 for k in (1, 2))
        u, v = place[i], place[j]
        place[i], place[j] = np.cos(angle) * u - np.sin(angle) * v, np.sin(angle) * u + np.cos(angle) * v
        return float(place[0]), float(place[1]), float(place[2])
    return position.get("x", 0.0), position.get("y", 0.0), position.get("z", 0.0)


def pointing(target: Array, station: Array) -> tuple[Array, Array]:
    """(n,) azimuth about +Z from +X and elevation from the XY plane, rad, that direct the beam to commanded targets.

    Ibaraki et al. 2014, Eq. (1), with the four-quadrant arctangent and, in three dimensions, the elevation. Targets are
    (n, 3), the station's estimated rotation centre (3,) or (n, 3), in the machine frame, m.
    """
    line = target - station
    return np.arctan2(line[..., 1], line[..., 0]), np.arctan2(line[..., 2], np.hypot(line[..., 0], line[..., 1]))


def path_steps(procedure: Procedure) -> Iterator[Step]:
    """The targets of the path, from every setup and in every repeat."""
    targets, session = targets_of(procedure), procedure.session
    runs: list[_Run] = [
        (setup.id, repeat, None, targets[::-1] if procedure.path.alternate and repeat % 2 else targets, {})
        for setup, repeat in product(session.setups, range(session.repeats))
    ]
    steps = _steps(procedure, runs, points=True, datum_per_run=False, approached=False)
    return steps if procedure.path.azimuth is None else _held_beam(procedure, steps, procedure.path.azimuth)


def _held_beam(procedure: Procedure, steps: Iterator[Step], azimuth: Spread | tuple[float, ...]) -> Iterator[Step]:
    """Every step in every direction of the beam, back again in every second repetition if so planned."""
    session = procedure.session
    assert isinstance(session, sessions.TrackingInterferometer)
    stations = {setup.id: np.array(setup.position) for setup in session.setups}
    forth = azimuth.values() if isinstance(azimuth, Spread) else list(azimuth)
    number = 0
    for step in steps:
        back = procedure.path.alternate and step.repeat % 2 == 1
        for place, angle in enumerate(reversed(forth) if back else forth):
            x, y, z = stations[step.setup] + [np.cos(angle), np.sin(angle), 0.0]
            aimed = replace(step, number=number, aim=(float(x), float(y), float(z)))
            yield aimed if place == 0 else replace(aimed, via=(), datum=False)
            number += 1


def targets_of(procedure: Procedure) -> list[dict[str, float]]:
    """The targets of one run in their order; a SessionError if one is outside the travel, or names another axis."""
    axes = {axis.lower() for axis in Chain.parse(procedure.session.machine.chain).axes}
    targets = list(_ordered(procedure.path))
    for name in targets[0]:
        if name not in axes:
            raise SessionError(
                f"{procedure.source}: path names the axis {name!r}; the machine has {', '.join(sorted(axes))}"
            )
    for number, target in enumerate(targets):
        check_travel(procedure, target, f"target {number} is at")
    return targets


def _ordered(path: Path) -> Iterator[dict[str, float]]:
    if path.points is not None:
        yield from (dict(point) for point in path.points)
        return
    grid = {name: at.values() if isinstance(at, Spread) else list(at) for name, at in (path.grid or {}).items()}
    names = list(grid)
    slow = names[:0:-1]  # all but the first, the slowest first
    back = False
    for outer in product(*(grid[name] for name in slow)):
        line = grid[names[0]]
        for value in reversed(line) if back else line:
            yield {names[0]: value, **dict(zip(reversed(slow), reversed(outer), strict=True))}
        back = not back and path.order == "serpentine"


_SPEED = {"linear": 0.25, "rotary": 1.0}
_ACCELERATION = {"linear": 1.0, "rotary": 5.0}


@dataclass(frozen=True)
class Plan:
    """All steps of a procedure, in the order in which they are measured."""

    procedure: Procedure  # what was asked for
    steps: tuple[Step, ...]  # one for each reading
    limits: Mapping[str, AxisLimits]  # speed and acceleration of each axis
    ends: tuple[float, ...]  # time from the start to the end of each step, of its moves and its wait, s

    @property
    def duration(self) -> float:
        """Time that all moves and waits take, s."""
        return self.ends[-1] if self.ends else 0.0


def plan(procedure: Procedure, most: int | None = None) -> Plan:
    """Make the steps of a procedure.

    A SessionError: a target is outside the machine's travel or names an axis that the machine does not have, the path
    is not one of the method, or there are more readings than `most`.
    """
    if (maker := method_spec(procedure.session.method).steps) is None:
        raise SessionError(f"{procedure.source}: no procedure makes a {procedure.session.method} session")
    session = procedure.session
    has_pointer = isinstance(session, sessions.TrackingInterferometer) and session.pointing == "open_loop"
    if procedure.path.azimuth is not None and not (has_pointer and session.axes == "xy"):
        raise SessionError(
            f"{procedure.source}: path.azimuth is for an open-loop pointer in the plane, to find its rotation "
            "centre and zero angle"
        )
    steps = tuple(islice(load(maker)(procedure), None if most is None else most + 1))
    if most is not None and len(steps) > most:
        raise SessionError(
            f"{procedure.source}: has more than {most} readings, which are too many to forecast; fewer repeats "
            "or setups or a coarser grid tell as much: uncertainties fall with the root of the number of readings"
        )
    limits = axis_limits(procedure)
    return Plan(procedure, steps, limits, _ends(steps, limits, procedure.motion.dwell))


def axis_limits(procedure: Procedure) -> dict[str, AxisLimits]:
    """Speed and acceleration of every axis, by its small letter; a SessionError if the procedure names another axis."""
    chain = Chain.parse(procedure.session.machine.chain)
    motion: Motion = procedure.motion
    names = [axis.lower() for axis in chain.axes]
    for key, table in (("speed", motion.speed), ("acceleration", motion.acceleration)):
        for name in table:
            if name not in names:
                raise SessionError(
                    f"{procedure.source}: motion.{key} names the axis {name!r}; the machine has {', '.join(names)}"
                )
    kinds = {name: "linear" if name.upper() in chain.linear else "rotary" for name in names}
    return {
        name: AxisLimits(motion.speed.get(name, _SPEED[kind]), motion.acceleration.get(name, _ACCELERATION[kind]))
        for name, kind in kinds.items()
    }


def _ends(steps: tuple[Step, ...], limits: Mapping[str, AxisLimits], dwell: float) -> tuple[float, ...]:
    ends, total = [], 0.0
    here: Position | None = None
    for step in steps:
        for place in (*step.via, step.position):
            total += move(here, place, limits).duration if here is not None else 0.0
            here = place
        total += dwell
        ends.append(total)
    return tuple(ends)
