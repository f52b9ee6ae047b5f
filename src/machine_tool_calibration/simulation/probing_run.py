"""A session of probing a part on the rotary table at several angles of C."""

from __future__ import annotations

from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field, model_validator

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.simulation.disturbance import Disturbance, Sight
from machine_tool_calibration.simulation.environment import Environment
from machine_tool_calibration.simulation.machine import VirtualMachine
from machine_tool_calibration.simulation.measurement import Measurement
from machine_tool_calibration.simulation.plan import Finite, Plan, Positive
from machine_tool_calibration.simulation.probe import probed
from machine_tool_calibration.simulation.random_machine import Amplitudes
from machine_tool_calibration.simulation.rotation import turn
from machine_tool_calibration.simulation.scene import Scene, ordered_times
from machine_tool_calibration.simulation.workpieces import WORKPIECES, PartPoint

__all__ = ["ProbingPlan", "plan_probing"]

_ANGLES: dict[str, tuple[float, ...]] = {
    "cross": (0, 75, 130, 210),
    "pins": (0, 31, 83, 137, 191, 227, 257, 313),
    "cam": (0, 50, 105, 170, 240, 300),
    "disc": (0, 75, 130, 210),
}


class ProbingPlan(Plan):
    """A part and the angles of C; without arguments the cross with two spheres at 0, 75, 130 and 210 degrees.

    Attributes:
        part: `cross`, `pins`, `cam` or `disc`.
        points: points of another part.
        angles: commanded angles of C, rad.
        grid: nodes of the error tables of X and Y, m.
        form: standard deviation of each point's form error, m.
        stylus_diameter: m.
        known_uncertainty: of the one measured length, m; None: it is not measured.
        tables: the machine's true motions are `smooth`, or `linear` between the nodes of the grid, as a
            look-up table is.
        columns: x and y of the session are where the sphere's `centre` is commanded to (where the axes
            stand), or the nominal `contact`; the machine's errors act at the same place.
    """

    method: Literal["probing"] = "probing"
    part: Literal["cross", "pins", "cam", "disc"] = "cross"
    points: tuple[PartPoint, ...] | None = None
    angles: Annotated[tuple[Finite, ...], Field(min_length=1)] | None = None
    grid: Annotated[tuple[Finite, ...], Field(min_length=2)] | None = None
    form: Annotated[float, Field(ge=0)] = 3e-6
    stylus_diameter: Positive = 0.006
    known_uncertainty: Positive | None = 2e-7
    tables: Literal["smooth", "linear"] = "smooth"
    columns: Literal["centre", "contact"] = "contact"
    interval: Positive = 10.0
    pause: Annotated[float, Field(ge=0)] = 0.0
    noise: Positive = 1e-6
    sign: Literal[-1, 1] = -1

    @model_validator(mode="after")
    def _check(self) -> ProbingPlan:
        grid = self.nodes()
        if np.any(np.diff(grid) <= 0):
            raise ValueError("grid must increase")
        return self

    def surface(self) -> tuple[PartPoint, ...]:
        """The points of the part."""
        return self.points if self.points is not None else WORKPIECES[self.part]()

    def turns(self) -> Array:
        """Commanded angles of C, rad."""
        return np.asarray(self.angles if self.angles else np.radians(_ANGLES[self.part]), float)

    def nodes(self) -> Array:
        """Nodes of the error tables, m."""
        if self.grid is not None:
            return np.asarray(self.grid, float)
        return np.arange(-5.0, 6.0) * (0.08 if self.part == "pins" else 0.022)

    def travel(self) -> dict[str, tuple[float, float]]:
        """Ends of X and Y, m; Z stands still at zero."""
        nodes = self.nodes()
        ends = (float(nodes[0]), float(nodes[-1]))
        return {"X": ends, "Y": ends, "Z": (-0.05, 0.05)}

    def errors(self) -> Amplitudes:
        """Errors of an ordinary machining centre; long waves, as the tables of the method can follow."""
        return Amplitudes(squareness=3e-5, line_position=1.5e-5, knots=5)

    def prepared(self, machine: VirtualMachine) -> VirtualMachine:
        """The machine with tables instead of smooth motions, if so planned."""
        return machine.tabulated({a: tuple(self.nodes()) for a in "XY"}) if self.tables == "linear" else machine


def plan_probing(plan: ProbingPlan, environment: Environment, rng: np.random.Generator) -> Measurement:
    """The measurement of a plan: angle by angle, repeat by repeat, all points."""
    part, turns = plan.surface(), plan.turns()
    nominal = np.array([[*p.position, 0.0] for p in part])
    outward = np.array([[*p.normal, 0.0] for p in part])
    bend = np.array([p.curvature for p in part])
    form = plan.form * rng.normal(size=len(part))
    length_error = rng.normal()
    shape = (len(turns), plan.repeats, len(part))
    setup, repeat, label = (index.ravel() for index in np.indices(shape))
    angle = turns[setup]
    time = ordered_times(setup, plan.interval, plan.pause)
    contact = turn(nominal[label], "C", plan.sign * angle)
    normal = turn(outward[label], "C", plan.sign * angle)
    radius = 0.5 * plan.stylus_diameter
    centre = contact + radius * normal
    command = centre if plan.columns == "centre" else contact
    direction = {axis: _approach(-normal[:, i]) for i, axis in enumerate("XY")}
    moved = np.sign(np.diff(turns, prepend=turns[0] - 1.0))
    direction["C"] = moved[setup]
    scene = Scene(time, setup, repeat, command, angle, direction, environment(time), label,
                  rates=environment.rate(time), lagged=environment.behind(time), ends=plan.travel())

    def read(machine: VirtualMachine, disturbance: Disturbance) -> Array:
        grown = 1.0 if disturbance.growth is None else 1.0 + disturbance.growth[:, None]
        place = nominal[label] * grown + form[label][:, None] * outward[label]
        shift = disturbance.axis.get("C", np.zeros(len(angle)))
        surface = disturbance.with_table(machine.on_table(place, angle, "C", shift))
        facing = machine.table_direction(outward[label], angle, "C", shift)
        actual = centre + machine.functional_point(command, disturbance.axis, disturbance.errors) - command
        if disturbance.point is not None:
            actual = actual + disturbance.point
        touched = probed(actual, normal, surface, facing, radius, bend[label])
        sight = Sight(np.zeros(len(angle)), -normal, np.arctan2(normal[:, 1], normal[:, 0]),
                      np.zeros(len(angle)), np.zeros(len(angle)))
        return touched + disturbance.added(sight)

    def judged(machine: VirtualMachine) -> dict[str, Any]:
        nodes = plan.nodes()
        x, y = (axis.ravel() for axis in np.meshgrid(nodes, nodes))
        grid = np.column_stack([x, y, np.zeros(len(x))])
        return {
            "workpiece_error": form.tolist(),
            "grid": grid[:, :2].tolist(),
            "position_error": machine.position_error(grid)[:, :2].tolist(),
            "c_errors": {"c": turns.tolist(), **_table_errors(machine, turns)},
            "squareness": dict(machine.squareness),
        }

    def describe(machine: VirtualMachine) -> dict[str, Any]:
        nodes = plan.nodes().tolist()
        known = {}
        if plan.known_uncertainty is not None:
            true = float(machine.motion("EXX", np.array([nodes[-1]]))[0] - machine.motion("EXX", np.zeros(1))[0])
            value = true + plan.known_uncertainty * length_error
            known = {"EXX": {"position": nodes[-1], "value": value, "standard_uncertainty": plan.known_uncertainty}}
        return {
            "method": "probing",
            "machine": {
                "chain": plan.chain,
                "rotation_sign": plan.sign,
                "travel": {"x": [nodes[0], nodes[-1]], "y": [nodes[0], nodes[-1]]},
                "table_grid": {"x": nodes, "y": nodes},
            },
            "probe": {"stylus_diameter": plan.stylus_diameter},
            "workpiece": [
                {"id": p.id, "feature": p.feature, "position": list(p.position), "normal": list(p.normal)} for p in part
            ],
            "setups": [{"id": f"C{i + 1}", "c": float(c)} for i, c in enumerate(turns)],
            "known": known,
        }

    columns = {
        "c": angle,
        "x": command[:, 0],
        "y": command[:, 1],
        **{f"dir_{axis.lower()}": values for axis, values in direction.items()},
    }
    labels = {"point": np.array([p.id for p in part], dtype=object)[label]}
    return Measurement(describe, scene, read, None, columns, labels, judged)


def _approach(move: Array) -> Array:
    """Sign of the last move of one axis, where an approach at right angles to it leaves it where it was."""
    sign = np.where(np.abs(move) < 1e-9, 0.0, np.sign(move))
    last = np.maximum.accumulate(np.where(sign != 0, np.arange(len(sign)), -1))
    return np.where(last >= 0, sign[np.maximum(last, 0)], 1.0)


def _table_errors(machine: VirtualMachine, angle: Array) -> dict[str, list[float]]:
    """EXC and EYC with the axis average line's position in them, and ECC, as the method finds them."""
    origin = machine.on_table(np.zeros(3), angle)
    return {
        "EXC": origin[:, 0].tolist(),
        "EYC": origin[:, 1].tolist(),
        "ECC": (machine.motion("ECC", angle) + machine.average_line.get("C0C", 0.0)).tolist(),
    }
