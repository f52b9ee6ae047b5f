"""The session that a procedure will make, before it is made: readings of a machine without errors, and noise."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from machine_tool_calibration.arrays import Array, IntArray
from machine_tool_calibration.instruments.touch import Part
from machine_tool_calibration.instruments.tracking import pointing
from machine_tool_calibration.procedure.description import Procedure
from machine_tool_calibration.procedure.motion import move
from machine_tool_calibration.procedure.plan import Plan, Step, plan
from machine_tool_calibration.procedure.runs import sensing_direction
from machine_tool_calibration.session.description import (
    Direct,
    Probing,
    RotaryAxis,
    StationSetup,
    StepDiagonal,
    TrackingInterferometer,
)
from machine_tool_calibration.session.session import Readings, Session

__all__ = ["Planned", "planned_session"]

_SEED = 0
# How fast machine, table and workpiece follow the air.
_FOLLOWS = {"air": 1.0, "x": 0.7, "y": 0.6, "z": 0.5, "table": 0.4, "work": 0.8}
_OFF = 0.5  # K above 20 degrees Celsius at the start


@dataclass(frozen=True)
class Planned:
    """A measurement that was not made.

    Attributes:
        session: as if it had been read: a perfect machine, and the declared uncertainty as noise.
        seconds: of motion and waiting; putting up instruments comes on top.
    """

    session: Session
    seconds: float


def planned_session(procedure: Procedure, warming: float = 1.0) -> Planned:
    """The session that a procedure will make.

    Args:
        procedure: what is to be measured.
        warming: change of the air's temperature that is assumed, K per hour; the machine follows more slowly.

    Raises:
        SessionError: the procedure cannot be run.
    """
    made = plan(procedure)
    steps, description = made.steps, procedure.session
    setups: tuple[Any, ...] = description.setups
    ids = {entry.id: k for k, entry in enumerate(setups)}
    setup = np.array([ids[step.setup] for step in steps])
    repeat = np.array([step.repeat for step in steps])
    time = _times(made)
    columns: dict[str, Array] = {"time": time}
    for axis in sorted({name for step in steps for name in step.position}):
        columns[axis] = np.array([step.position.get(axis, 0.0) for step in steps])
        columns[f"dir_{axis}"] = np.array([float(step.direction.get(axis, 1)) for step in steps])
    for name, share in _FOLLOWS.items():
        columns[f"temperature_{name}"] = 20.0 + _OFF + share * warming * time / 3600.0
    columns["air_pressure"] = np.full(len(steps), 101_325.0)
    columns["relative_humidity"] = np.full(len(steps), 0.5)
    path, more, labels = _nominal(procedure, steps, setup)
    columns |= more
    noise = description.standard_uncertainty.displacement * np.random.default_rng(_SEED).normal(size=len(steps))
    reading = path + noise
    if not isinstance(description, Direct | Probing):
        zero = _zeros(description, setup, repeat, labels)
        reading = reading - reading[zero]
    readings = Readings(setup, repeat, reading, columns, labels, np.arange(len(steps)))
    return Planned(Session(description, readings, f"procedure {procedure.name}"), made.duration)


def _times(made: Plan) -> Array:
    """(n,) when each reading is taken: at the end of the wait, s."""
    out, total, here = [], 0.0, None
    for step in made.steps:
        for place in (*step.via, step.position):
            total += move(here, place, made.limits).duration if here is not None else 0.0
            here = place
        total += made.procedure.motion.dwell
        out.append(total)
    return np.array(out)


def _nominal(
    procedure: Procedure, steps: tuple[Step, ...], setup: IntArray
) -> tuple[Array, dict[str, Array], dict[str, np.ndarray]]:
    """Path that a perfect machine shows, further columns and labels."""
    description = procedure.session
    n = len(steps)
    if isinstance(description, Direct):
        direction = sensing_direction(description)
        return np.zeros(n), {f"g{axis}": np.full(n, direction[j]) for j, axis in enumerate("xyz")}, {}
    if isinstance(description, Probing):
        part = Part(description)
        points = [step.target or 0 for step in steps]
        angles = [description.setups[s].c for s in setup]
        centres = [
            part.touch(point, c, procedure.motion.approach).at(0.0) for point, c in zip(points, angles, strict=True)
        ]
        names = np.array([description.workpiece[point].id for point in points], dtype=object)
        return np.zeros(n), {axis: np.array([c[axis] for c in centres]) for axis in "xy"}, {"point": names}
    aim = np.array([step.aim or (0.0, 0.0, 0.0) for step in steps])
    if isinstance(description, StepDiagonal):
        motion = np.array([run.direction for run in description.setups]) * np.asarray(description.step)
        beam = motion / np.linalg.norm(motion, axis=1)[:, None]
        return np.asarray(np.einsum("nj,nj->n", aim, beam[setup])), {}, {}
    stations = np.array([s.position for s in description.setups if isinstance(s, StationSetup)])[setup]
    if isinstance(description, RotaryAxis):
        names = np.array([description.targets[step.target or 0].id for step in steps], dtype=object)
        return np.linalg.norm(aim - stations, axis=1), {}, {"target": names}
    assert isinstance(description, TrackingInterferometer)
    if description.dimension == 2:
        stations[:, 2] = aim[:, 2]
    azimuth, elevation = pointing(aim, stations)
    return np.linalg.norm(aim - stations, axis=1), {"azimuth": azimuth, "elevation": elevation}, {}


def _zeros(description: object, setup: IntArray, repeat: IntArray, labels: dict[str, np.ndarray]) -> IntArray:
    """(n,) the reading from which each counts: the first of its setup, or of its run."""
    keys = [setup]
    if not isinstance(description, TrackingInterferometer):
        keys.append(repeat)
    if "target" in labels:
        keys.append(np.unique(labels["target"].astype(str), return_inverse=True)[1])
    _, first, group = np.unique(np.column_stack(keys), axis=0, return_index=True, return_inverse=True)
    return np.asarray(first[group.reshape(-1)])
