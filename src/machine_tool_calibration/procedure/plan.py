# SPDX-License-Identifier: Apache-2.0
"""From a procedure to its plan: all steps, and how long they take."""

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import islice

from machine_tool_calibration.errors import SessionError
from machine_tool_calibration.machine.chain import Chain
from machine_tool_calibration.procedure.description import Motion, Procedure
from machine_tool_calibration.procedure.motion import AxisLimits, move
from machine_tool_calibration.procedure.steps import Position, Step
from machine_tool_calibration.session.catalogue import method_spec
from machine_tool_calibration.session.description import TrackingInterferometer
from machine_tool_calibration.session.method import load

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
    maker = method_spec(procedure.session.method).steps
    if maker is None:
        raise SessionError(f"procedure {procedure.name}: no procedure makes a {procedure.session.method} session")
    session = procedure.session
    flat = isinstance(session, TrackingInterferometer) and session.pointing == "open_loop" and session.dimension == 2
    if procedure.path.azimuth is not None and not flat:
        raise SessionError(
            f"procedure {procedure.name}: path.azimuth is for an open-loop pointer in the plane, to find its rotation "
            "centre and zero angle"
        )
    steps = tuple(islice(load(maker)(procedure), None if most is None else most + 1))
    if most is not None and len(steps) > most:
        raise SessionError(
            f"procedure {procedure.name}: has more than {most} readings, which are too many to forecast; fewer repeats "
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
                    f"procedure {procedure.name}: motion.{key} names the axis {name!r}; "
                    f"the machine has {', '.join(names)}"
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
