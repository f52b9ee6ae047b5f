"""From a procedure to the list of its steps."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass

from machine_tool_calibration.errors import SessionError
from machine_tool_calibration.machine.chain import Chain
from machine_tool_calibration.procedure.description import Motion, Path, Procedure, Spread
from machine_tool_calibration.procedure.motion import AxisLimits, move

__all__ = ["Plan", "Step", "axis_limits", "plan", "targets_of"]

Position = Mapping[str, float]

_SPEED = {"linear": 0.25, "rotary": 1.0}
_ACCELERATION = {"linear": 1.0, "rotary": 5.0}


@dataclass(frozen=True)
class Step:
    """One target to be measured.

    Attributes:
        number: place in the plan, from 0.
        setup: id of the instrument's setup.
        repeat: repetition of that setup, from 0.
        position: commanded position of each axis, m or rad.
        direction: sign of each axis's last move before the reading, +1 or -1.
        via: positions to be passed on the way, which fix the direction of approach.
        aim: commanded target, m, machine frame; None for a probe.
        points: whether a pointer directs the beam at it; otherwise the beam is fixed for each setup.
        datum: whether the path is zeroed here, before the reading.
        target: index of the target on the table, or of the workpiece's point.
    """

    number: int
    setup: str
    repeat: int
    position: Position
    direction: Mapping[str, int]
    via: tuple[Position, ...] = ()
    aim: tuple[float, float, float] | None = None
    points: bool = True
    datum: bool = False
    target: int | None = None


@dataclass(frozen=True)
class Plan:
    """All steps of a procedure, in the order in which they are measured.

    Attributes:
        procedure: what was asked for.
        steps: one for each reading.
        limits: speed and acceleration of each axis.
        duration: time that all moves and waits take, s.
    """

    procedure: Procedure
    steps: tuple[Step, ...]
    limits: Mapping[str, AxisLimits]
    duration: float


def plan(procedure: Procedure) -> Plan:
    """Make the steps of a procedure.

    Raises:
        SessionError: a target is outside the machine's travel or names an axis that the machine does not have, or the
            path is not one of the method.
    """
    steps = tuple(_maker(procedure)(procedure))
    limits = axis_limits(procedure)
    return Plan(procedure, steps, limits, _duration(steps, limits, procedure.motion.dwell))


def _maker(procedure: Procedure) -> Callable[[Procedure], Iterator[Step]]:
    """What makes the steps of the session's method."""
    from machine_tool_calibration.procedure import runs
    from machine_tool_calibration.procedure.touches import touch_steps

    makers: dict[str, Callable[[Procedure], Iterator[Step]]] = {
        "tracking_interferometer": lambda chosen: _directed(chosen, _runs(chosen, targets_of(chosen))),
        "probing": touch_steps,
        "step_diagonal": runs.diagonal_steps,
        "rotary_axis": runs.rotary_steps,
        "direct": runs.direct_steps,
    }
    return makers[procedure.session.method]


def axis_limits(procedure: Procedure) -> dict[str, AxisLimits]:
    """Speed and acceleration of every axis of the machine, by its small letter.

    Raises:
        SessionError: the procedure names an axis that the machine does not have.
    """
    chain = Chain.parse(procedure.session.machine.chain)
    motion: Motion = procedure.motion
    names = [axis.lower() for axis in chain.axes]
    for key, table in (("speed", motion.speed), ("acceleration", motion.acceleration)):
        for name in table:
            if name not in names:
                raise SessionError(
                    f"procedure {procedure.name}: motion.{key} names the axis {name!r}; "
                    f"the machine has {', '.join(names)}"
                )
    kinds = {name: "linear" if name.upper() in chain.linear else "rotary" for name in names}
    return {
        name: AxisLimits(motion.speed.get(name, _SPEED[kind]), motion.acceleration.get(name, _ACCELERATION[kind]))
        for name, kind in kinds.items()
    }


def targets_of(procedure: Procedure) -> list[dict[str, float]]:
    """The targets of one run in their order, checked against the machine.

    Raises:
        SessionError: a target is outside the travel, or names an axis that the machine does not have.
    """
    machine, path = procedure.session.machine, procedure.path
    axes = {axis.lower() for axis in Chain.parse(machine.chain).axes}
    targets = list(_ordered(path))
    for name in targets[0]:
        if name not in axes:
            raise SessionError(
                f"procedure {procedure.name}: path names the axis {name!r}; the machine has {', '.join(sorted(axes))}"
            )
    for number, target in enumerate(targets):
        for name, value in target.items():
            low, high = machine.travel.get(name, (float("-inf"), float("inf")))
            if not low <= value <= high:
                raise SessionError(
                    f"procedure {procedure.name}: target {number} at {name} = {value:g} is outside the travel "
                    f"{low:g} to {high:g}"
                )
    return targets


def _ordered(path: Path) -> Iterator[dict[str, float]]:
    if path.points is not None:
        yield from (dict(point) for point in path.points)
        return
    grid = {
        name: entry.values() if isinstance(entry, Spread) else list(entry) for name, entry in (path.grid or {}).items()
    }
    names = list(grid)
    slow = names[:0:-1]  # all but the first, the slowest first
    back = False
    for outer in itertools.product(*(grid[name] for name in slow)):
        line = grid[names[0]]
        for value in reversed(line) if back else line:
            yield {names[0]: value, **dict(zip(reversed(slow), reversed(outer), strict=True))}
        back = not back and path.order == "serpentine"


def _runs(procedure: Procedure, targets: list[dict[str, float]]) -> Iterator[tuple[str, int, dict[str, float]]]:
    """Setup, repeat and target of every reading."""
    for setup in procedure.session.setups:
        for repeat in range(procedure.session.repeats):
            run = reversed(targets) if procedure.path.alternate and repeat % 2 else targets
            yield from ((setup.id, repeat, target) for target in run)


def _directed(procedure: Procedure, runs: Iterator[tuple[str, int, dict[str, float]]]) -> Iterator[Step]:
    """Steps with the direction from which each target is approached."""
    direction: dict[str, int] = {}
    before: dict[str, float] | None = None
    setup_before: str | None = None
    for number, (setup, repeat, target) in enumerate(runs):
        via: tuple[Position, ...] = ()
        if before is None:  # where the axes stand is not known: a short move makes the direction certain
            before = _beside(procedure, target)
            via = (before,) if before != target else ()
            direction = dict.fromkeys(target, 1)
        for name, value in target.items():
            if value != before[name]:
                direction[name] = 1 if value > before[name] else -1
        yield Step(
            number=number,
            setup=setup,
            repeat=repeat,
            position=target,
            direction=dict(direction),
            via=via,
            aim=(target.get("x", 0.0), target.get("y", 0.0), target.get("z", 0.0)),
            datum=setup != setup_before,
        )
        before, setup_before = target, setup


def _beside(procedure: Procedure, target: Mapping[str, float]) -> dict[str, float]:
    """A place near the target: below it on each axis, or above where the travel ends below."""
    approach = procedure.motion.approach
    place = {}
    for name, value in target.items():
        low, high = procedure.session.machine.travel.get(name, (float("-inf"), float("inf")))
        place[name] = value - approach if value - approach >= low else min(value + approach, high)
    return place


def _duration(steps: tuple[Step, ...], limits: Mapping[str, AxisLimits], dwell: float) -> float:
    total = 0.0
    here: Position | None = None
    for step in steps:
        for place in (*step.via, step.position):
            total += move(here, place, limits).duration if here is not None else 0.0
            here = place
        total += dwell
    return total
