"""Steps of the methods whose path follows from the session: step diagonals, rotary axes, runs of one axis."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.errors import SessionError
from machine_tool_calibration.procedure.description import Procedure
from machine_tool_calibration.procedure.plan import Step, targets_of
from machine_tool_calibration.session.description import Direct, RotaryAxis, StepDiagonal

__all__ = ["diagonal_positions", "diagonal_steps", "direct_steps", "rotary_steps", "sensing_direction"]



def diagonal_positions(description: StepDiagonal, index: int) -> list[dict[str, float]]:
    """Commanded positions of a setup's run: single-axis moves in the order that its id ends with, or x, y, z.

    Args:
        description: the session.
        index: of the setup.
    """
    setup = description.setups[index]
    suffix = setup.id.rsplit("_", 1)[-1]
    order = suffix if sorted(suffix) == ["x", "y", "z"] and "_" in setup.id else "xyz"
    signs = dict(zip("xyz", setup.direction, strict=True))
    moving = [axis for axis in order if signs[axis]]
    steps, start = dict(zip("xyz", description.step, strict=True)), dict(zip("xyz", setup.start, strict=True))
    made = dict.fromkeys("xyz", 0)
    positions = [dict(start)]
    for _ in range(description.blocks):
        for axis in moving:
            made[axis] += 1
            # From the start, so that no rounding adds up, and to the picometre, so that none is beyond the travel.
            positions.append({a: round(start[a] + made[a] * steps[a] * np.sign(signs[a]), 12) for a in "xyz"})
    return [{axis: float(value) for axis, value in place.items()} for place in positions]


def sensing_direction(description: Direct) -> Array:
    """(3,) direction along which an instrument of a direct session reads: that of its first term, as Y of EYX.

    Raises:
        SessionError: no term says so.
    """
    name = description.terms[0] if description.terms else ""
    if len(name) != 3 or name[0] != "E" or name[1] not in "XYZ":
        raise SessionError(
            "session: terms must begin with a translation such as EXX: it says along which axis the instrument reads"
        )
    return np.asarray(np.eye(3)["XYZ".index(name[1])])


def diagonal_steps(procedure: Procedure) -> Iterator[Step]:
    """Setup by setup, run by run; the path is zeroed at the start of each run."""
    session = procedure.session
    assert isinstance(session, StepDiagonal)
    runs = []
    for index, setup in enumerate(session.setups):
        positions = diagonal_positions(session, index)
        signs = {axis: sign or 1.0 for axis, sign in zip("xyz", setup.direction, strict=True)}
        runs += [(setup.id, repeat, None, positions, signs) for repeat in range(session.repeats)]
    yield from _steps(procedure, runs, points=False)


def rotary_steps(procedure: Procedure) -> Iterator[Step]:
    """Station by station, repetition by repetition, target by target, all angles."""
    session = procedure.session
    assert isinstance(session, RotaryAxis)
    axis = (session.machine.axis or "C").lower()
    forth = targets_of(procedure)
    if any(set(place) != {axis} for place in forth):
        raise SessionError(f"procedure {procedure.name}: path of a rotary axis names {axis} and nothing else")
    runs = []
    for setup in session.setups:
        for repeat in range(session.repeats):
            back = procedure.path.alternate and repeat % 2 == 1
            angles = forth[::-1] if back else forth
            if procedure.path.both_ways:
                angles = [*angles, *angles[::-1]]
            for target in range(len(session.targets)):
                runs.append((setup.id, repeat, target, angles, {axis: -1.0 if back else 1.0}))
    yield from _steps(procedure, runs, points=True)


def direct_steps(procedure: Procedure) -> Iterator[Step]:
    """Every run goes forth and back, with an overrun at both ends (ISO 230-2)."""
    session = procedure.session
    assert isinstance(session, Direct)
    sensing_direction(session)
    forth = targets_of(procedure)
    runs = [
        (setup.id, repeat, None, [*forth, *forth[::-1]], dict.fromkeys(forth[0], 1.0))
        for setup in session.setups
        for repeat in range(session.repeats)
    ]
    yield from _steps(procedure, runs, points=False, datum_per_run=False)


def _steps(
    procedure: Procedure,
    runs: Sequence[tuple[str, int, int | None, Sequence[Mapping[str, float]], Mapping[str, float]]],
    *,
    points: bool,
    datum_per_run: bool = True,
) -> Iterator[Step]:
    """Steps of runs (setup, repeat, target, positions, sense of the first approach)."""
    number = 0
    last_setup = ""
    before: dict[str, float] = {}
    direction: dict[str, int] = {}
    for setup, repeat, target, positions, sense in runs:
        for place, position in enumerate(positions):
            via: tuple[dict[str, float], ...] = ()
            if place == 0:  # from wherever the last run ended: a short move makes the direction certain
                via = (_beyond(procedure, position, {axis: -sign for axis, sign in sense.items()}),)
            elif position == positions[place - 1]:  # a turning point is approached from the other side
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
                via=via,
                aim=_aim(procedure, position, target),
                points=points,
                datum=place == 0 and (datum_per_run or setup != last_setup),
                target=target,
            )
            number, last_setup = number + 1, setup


def _beyond(procedure: Procedure, position: Mapping[str, float], sense: Mapping[str, float]) -> dict[str, float]:
    """A place beside a position, in a sense on each axis; on the other side where the travel ends."""
    approach = procedure.motion.approach
    place = {}
    for axis, value in position.items():
        low, high = procedure.session.machine.travel.get(axis, (float("-inf"), float("inf")))
        there = value + approach * np.sign(sense.get(axis, -1.0))
        other = value - approach * np.sign(sense.get(axis, -1.0))
        place[axis] = float(there if low <= there <= high else min(max(other, low), high))
    return place


def _aim(procedure: Procedure, position: Mapping[str, float], target: int | None) -> tuple[float, float, float]:
    """The commanded target in the machine frame."""
    session = procedure.session
    if isinstance(session, RotaryAxis) and target is not None:
        axis = session.machine.axis or "C"
        sign = session.rotation_sign or session.machine.rotation_sign or 1
        place = _turned(np.array(session.targets[target].position), axis, sign * position[axis.lower()])
        return float(place[0]), float(place[1]), float(place[2])
    return position.get("x", 0.0), position.get("y", 0.0), position.get("z", 0.0)


def _turned(point: Array, axis: str, angle: float) -> Array:
    """A point turned about an axis through the origin, right-handed."""
    k = "ABC".index(axis)
    i, j = (k + 1) % 3, (k + 2) % 3
    out = point.copy()
    out[i] = np.cos(angle) * point[i] - np.sin(angle) * point[j]
    out[j] = np.sin(angle) * point[i] + np.cos(angle) * point[j]
    return out
