# SPDX-License-Identifier: Apache-2.0
"""A session of probing a part on the rotary table at several angles of C."""

from collections.abc import Callable, Iterable, Mapping
from functools import partial
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from machine_tool_calibration.arrays import Array, last_sign
from machine_tool_calibration.session.description import WorkpiecePoint
from machine_tool_calibration.session.record import Finite, Positive
from machine_tool_calibration.simulation.flaw import Disturbance, Sight
from machine_tool_calibration.simulation.machine import VirtualMachine
from machine_tool_calibration.simulation.machine_file import Amplitudes
from machine_tool_calibration.simulation.motions import turn
from machine_tool_calibration.simulation.plan import Interval, Measurement, Pause, Plan
from machine_tool_calibration.simulation.scene import Scene, ordered_times
from machine_tool_calibration.simulation.sensors import probed


class PartPoint(WorkpiecePoint):
    """A nominal point of a part's surface in the workpiece frame at c = 0."""

    curvature: Finite = 0.0  # of the surface, 1/m: positive for a pin, negative for a hole

    @model_validator(mode="after")
    def _check(self) -> Self:
        if abs(np.hypot(*self.normal) - 1.0) > 1e-6:
            raise ValueError(f"the normal of point {self.id} must have length 1")
        return self


_Point = tuple[str, float, float, float, float, float]
"""Feature, position and normal in x and y, curvature."""


def _numbered(points: Iterable[_Point]) -> tuple[PartPoint, ...]:
    return tuple(
        PartPoint(id=str(i), feature=feature, position=(x, y), normal=(nx, ny), curvature=bend)
        for i, (feature, x, y, nx, ny, bend) in enumerate(points)
    )


def _circle(feature: str, x: float, y: float, radius: float, count: int) -> list[_Point]:
    out = []
    for k in range(count):
        angle = 2.0 * np.pi * k / count
        nx, ny = float(np.cos(angle)), float(np.sin(angle))
        out.append((feature, x + radius * nx, y + radius * ny, nx, ny, 1.0 / radius))
    return out


def _spheres(first: tuple[float, float], second: tuple[float, float], radius: float) -> list[_Point]:
    return [*_circle("sphere1", *first, radius, 8), *_circle("sphere2", *second, radius, 8)]


def cross(half: float = 0.082, width: float = 0.018, spheres: bool = True) -> tuple[PartPoint, ...]:
    """A cross-shaped pocket: four arms of `half` length and half width `width`, walls probed from inside, m."""
    points = []
    for quarter in range(4):
        c, s = (1, 0, -1, 0)[quarter], (0, 1, 0, -1)[quarter]
        arm = [
            (float(x), side * width, 0.0, -side)
            for x in np.linspace(width + 0.004, half - 0.003, 8)
            for side in (1.0, -1.0)
        ]
        arm += [(half, float(y), -1.0, 0.0) for y in np.linspace(-width, width, 5)[1:-1]]
        points += [
            ("work", c * x - s * y, s * x + c * y, c * nx - s * ny, s * nx + c * ny, 0.0) for x, y, nx, ny in arm
        ]
    if spheres:
        points += _spheres((0.080, 0.065), (-0.075, -0.070), 0.0127)
    return _numbered(points)


def pins(count: int = 18, pitch_radius: float = 0.2, spheres: bool = True) -> tuple[PartPoint, ...]:
    """Cylindrical pins of 12 mm on a pitch circle, four points on each, m."""
    points = []
    for k, (_, x, y, *_) in enumerate(_circle("", 0.0, 0.0, pitch_radius, count), 1):
        points += _circle(f"pin{k}", x, y, 0.006, 4)
    if spheres:
        points += _spheres((0.31, 0.12), (-0.14, -0.29), 0.015)
    return _numbered(points)


def cam(count: int = 80, radius: float = 0.06, spheres: bool = True) -> tuple[PartPoint, ...]:
    """A smooth disc cam r = radius + 12 mm cos(t) + 6 mm cos(2t + 0.7), normals and curvature from it, m."""
    lift = (0.012, 0.006)
    t = np.arange(count) * 2.0 * np.pi / count
    r = radius + lift[0] * np.cos(t) + lift[1] * np.cos(2.0 * t + 0.7)
    d = -lift[0] * np.sin(t) - 2.0 * lift[1] * np.sin(2.0 * t + 0.7)
    dd = -lift[0] * np.cos(t) - 4.0 * lift[1] * np.cos(2.0 * t + 0.7)
    bend = (r**2 + 2.0 * d**2 - r * dd) / (r**2 + d**2) ** 1.5
    nx, ny = r * np.cos(t) + d * np.sin(t), r * np.sin(t) - d * np.cos(t)
    length = np.hypot(nx, ny)
    rows = zip(r * np.cos(t), r * np.sin(t), nx / length, ny / length, bend, strict=True)
    points = [("work", float(x), float(y), float(u), float(v), float(k)) for x, y, u, v, k in rows]
    if spheres:
        points += _spheres((0.080, 0.065), (-0.075, -0.070), 0.0127)
    return _numbered(points)


def disc(count: int = 36, radius: float = 0.08) -> tuple[PartPoint, ...]:
    """A circular disc; C's angular positioning cannot be seen on it, m."""
    return _numbered(_circle("work", 0.0, 0.0, radius, count))


WORKPIECES: Mapping[str, Callable[[], tuple[PartPoint, ...]]] = {"cross": cross, "pins": pins, "cam": cam, "disc": disc}
"""Parts by name."""

_ANGLES: dict[str, tuple[float, ...]] = {
    "cross": (0, 75, 130, 210),
    "pins": (0, 31, 83, 137, 191, 227, 257, 313),
    "cam": (0, 50, 105, 170, 240, 300),
    "disc": (0, 75, 130, 210),
}


def touched(
    machine: VirtualMachine,
    disturbance: Disturbance,
    nominal: Array,
    outward: Array,
    form: Array,
    angle: Array,
    actual: Array,
    normal: Array,
    radius: float,
    curvature: Array | float = 0.0,
) -> Array:
    """(n,) displacements at which the probe triggers, along the planned normals, m.

    Args:
        machine: with all its errors.
        disturbance: what else the flaws do.
        nominal: (n, 3) points of the part in its own frame, m.
        outward: (n, 3) their normals there, unit.
        form: (n,) how far the part's surface is outside of them, m.
        angle: (n,) commanded, of C, rad.
        actual: (n, 3) where the sphere's centre really is when the probe is commanded to the nominal contact, m.
        normal: (n, 3) planned outward normals in the machine frame, unit.
        radius: of the sphere, m.
        curvature: (n,) of the surface, 1/m.
    """
    place = disturbance.grown(nominal, "C") + form[:, None] * outward
    shift = disturbance.axis.get("C", 0.0)
    surface = disturbance.with_table(machine.on_table(place, angle, "C", shift))
    facing = machine.on_table(outward, angle, "C", shift) - machine.on_table(np.zeros(3), angle, "C", shift)
    sight = Sight(np.zeros(len(angle)), -normal, azimuth=np.arctan2(normal[:, 1], normal[:, 0]))
    return probed(actual, normal, surface, facing, radius, curvature) + disturbance.added(sight)


class ProbingPlan(Plan):
    """A part and the angles of C; without arguments the cross with two spheres at 0, 75, 130 and 210 degrees."""

    method: Literal["probing"] = "probing"
    part: Literal["cross", "pins", "cam", "disc"] = "cross"  # `cross`, `pins`, `cam` or `disc`
    points: Annotated[tuple[PartPoint, ...], Field(min_length=1)] | None = None  # points of another part
    angles: Annotated[tuple[Finite, ...], Field(min_length=1)] | None = None  # commanded angles of C, rad
    grid: Annotated[tuple[Finite, ...], Field(min_length=2)] | None = None  # nodes of the error tables of X and Y, m
    form: Annotated[float, Field(ge=0)] = 3e-6  # standard deviation of each point's form error, m
    stylus_diameter: Positive = 0.006  # m
    known_uncertainty: Positive | None = 2e-7  # of the one measured length, m; None: it is not measured
    # the machine's true motions are `smooth`, or `linear` between the nodes of the grid, as a look-up table is
    tables: Literal["smooth", "linear"] = "smooth"
    # x and y of the session are where the sphere's `centre` is commanded to (where the axes stand), or the nominal
    # `contact`; the machine's errors act at the same place
    columns: Literal["centre", "contact"] = "contact"
    interval: Interval = 10.0
    pause: Pause = 0.0
    noise: Positive = 1e-6
    sign: Literal[-1, 1] = -1

    @model_validator(mode="after")
    def _check(self) -> Self:
        if np.any(np.diff(self.nodes()) <= 0):
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

    def machine(self) -> dict[str, Any]:
        """Chain, sense of C, ends of X and Y, and the nodes of their error tables."""
        nodes = self.nodes().tolist()
        ends = [nodes[0], nodes[-1]]
        return {
            "chain": self.chain,
            "rotation_sign": self.sign,
            "travel": {"x": ends, "y": ends},
            "table_grid": {"x": nodes, "y": nodes},
        }

    def errors(self) -> Amplitudes:
        """Errors of an ordinary machining centre; long waves, as the tables of the method can follow."""
        return Amplitudes(squareness=3e-5, line_position=1.5e-5, knots=5)

    def prepared(self, machine: VirtualMachine) -> VirtualMachine:
        """The machine with tables instead of smooth motions, if so planned."""
        return machine.tabulated({a: tuple(self.nodes()) for a in "XY"}) if self.tables == "linear" else machine

    def measured(self, rng: np.random.Generator) -> Measurement:
        """The measurement of a plan: angle by angle, repeat by repeat, all points."""
        part, turns = self.surface(), self.turns()
        nominal = np.array([[*p.position, 0.0] for p in part])
        outward = np.array([[*p.normal, 0.0] for p in part])
        bend = np.array([p.curvature for p in part])
        form = self.form * rng.normal(size=len(part))
        length_error = rng.normal()
        shape = (len(turns), self.repeats, len(part))
        setup, repeat, label = (index.ravel() for index in np.indices(shape))
        angle = turns[setup]
        time = ordered_times(setup, self.interval, self.pause)
        contact = turn(nominal[label], "C", self.sign * angle)
        normal = turn(outward[label], "C", self.sign * angle)
        radius = 0.5 * self.stylus_diameter
        centre = contact + radius * normal
        command = centre if self.columns == "centre" else contact
        # an approach at right angles to an axis leaves it where it was
        direction = {axis: last_sign(-normal[:, i], 1e-9) for i, axis in enumerate("XY")}
        direction["C"] = np.sign(np.diff(turns, prepend=turns[0] - 1.0))[setup]
        scene = Scene(time, setup, repeat, command, angle, direction, ends=self.travel())

        def read(machine: VirtualMachine, disturbance: Disturbance) -> Array:
            actual = centre + disturbance.functional_point(machine, command) - command
            errors = (machine, disturbance)
            return touched(
                *errors, nominal[label], outward[label], form[label], angle, actual, normal, radius, bend[label]
            )

        labels = {"point": np.array([p.id for p in part], dtype=object)[label]}
        description = {
            "probe": {"stylus_diameter": self.stylus_diameter},
            "workpiece": [point.model_dump(exclude={"curvature"}) for point in part],
            "setups": [{"id": f"C{i + 1}", "c": float(c)} for i, c in enumerate(turns)],
        }
        judged, known = partial(self._judged, form), partial(self._known, length_error)
        return Measurement(description, scene, read, None, labels=labels, truth=judged, known=known)

    def _judged(self, form: Array, machine: VirtualMachine) -> dict[str, Any]:
        """What the measurement should find."""
        nodes, turns = self.nodes(), self.turns()
        x, y = (axis.ravel() for axis in np.meshgrid(nodes, nodes))
        grid = np.column_stack([x, y, np.zeros(len(x))])
        # Of the table as the method finds it, with the axis average line's position and orientation.
        origin, own = machine.on_table(np.zeros(3), turns), machine.motion("ECC", turns)
        turned = own + machine.average_line.get("C0C", 0.0)
        table = {"EXC": origin[:, 0].tolist(), "EYC": origin[:, 1].tolist(), "ECC": turned.tolist()}
        return {
            "workpiece_error": form.tolist(),
            "grid": grid[:, :2].tolist(),
            "position_error": machine.position_error(grid)[:, :2].tolist(),
            "c_errors": {"c": turns.tolist(), **table},
            "squareness": dict(machine.squareness),
        }

    def _known(self, length_error: float, machine: VirtualMachine) -> dict[str, Any]:
        """The length that was measured otherwise, off by so many of its uncertainties."""
        if self.known_uncertainty is None:
            return {}
        end = self.nodes()[-1:]
        true = float(machine.motion("EXX", end)[0] - machine.motion("EXX", np.zeros(1))[0])
        value = true + self.known_uncertainty * length_error
        return {"EXX": {"position": end.item(), "value": value, "standard_uncertainty": self.known_uncertainty}}
