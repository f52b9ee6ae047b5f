# SPDX-License-Identifier: Apache-2.0
"""A flaw that can be put into a simulated measurement: an effect of the catalogue, or one in no catalogue."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.simulation.machine import VirtualMachine
from machine_tool_calibration.simulation.motions import Table, rotate, summed
from machine_tool_calibration.simulation.scene import Scene


@dataclass(frozen=True)
class Sight:
    """What the instrument looks at in each reading; what a method lacks is zero."""

    path: Array  # (n,) from the instrument (rotation centre, or the mirror at the start of a run) to the target, m
    direction: Array  # (n, 3) unit vector along which a displacement is sensed
    # (n,) azimuth of that direction (of the commanded beam, for a pointer), rad
    azimuth: Array = field(default_factory=lambda: np.zeros(1))
    # (n,) direction from which the beam meets the retroreflector, in the frame that carries it: an azimuth in the plane
    # or on a table, an angle to the spindle's axis in space, rad
    incidence: Array = field(default_factory=lambda: np.zeros(1))
    change: Array = field(default_factory=lambda: np.zeros(1))  # (n,) path minus that of the run's first reading, m


@dataclass(frozen=True)
class Disturbance:
    """Deviations from the ideal, each (n,) unless said otherwise; 0.0 where there are none."""

    # carriage or table ahead of its command along its own motion, by axis letter, m or rad
    axis: Mapping[str, Array] = field(default_factory=dict)
    point: Array | float = 0.0  # (n, 3) shift of the functional point, m
    station: Array | float = 0.0  # (n, 3) shift of the station's rotation centre, m
    turn: Array | float = 0.0  # turn of the beam's azimuth, rad
    mirror: Array | float = 0.0  # (n, 2) tilt of the flat mirror's normal off the beam, left and upwards, rad
    growth: Array | float = 0.0  # relative growth of the workpiece about the table's centre
    table_radial: Array | float = 0.0  # relative growth of the table's targets away from the axis
    table_axial: Array | float = 0.0  # relative growth along the axis
    reading: tuple[Callable[[Sight], Array], ...] = ()  # added to the reading, of what the instrument looks at
    tables: tuple[tuple[str, Table], ...] = ()  # further error motions of the machine
    squareness: Mapping[str, float] = field(default_factory=dict)  # further squareness, rad
    # further error motions of an axis at each reading, by letter: (n, 6) EX, EY, EZ (m) and EA, EB, EC (rad)
    errors: Mapping[str, Array] = field(default_factory=dict)
    table_shift: Array | float = 0.0  # (n, 3) shift of the rotary table's axis, m
    table_tilt: Array | float = 0.0  # (n, 3) small rotation of it about the machine's zero, rad

    def functional_point(self, machine: VirtualMachine, command: Array) -> Array:
        """(n, 3) where the functional point really is in the workpiece frame when x, y, z (n, 3) are commanded, m."""
        return np.asarray(machine.functional_point(command, self.axis, self.errors) + self.point)

    def on_table(self, machine: VirtualMachine, point: Array, angle: Array, axis: str) -> Array:
        """(n, 3) where points (n, 3) of the table, given in its own frame, really are in the machine frame, m."""
        return self.with_table(machine.on_table(self.grown(point, axis), angle, axis, self.axis.get(axis, 0.0)))

    def grown(self, points: Array, axis: str) -> Array:
        """Where points (n, 3) of the table are in its own frame when it, or the part on it, has grown, m."""
        axial = np.eye(3)["ABC".index(axis)]
        radial_growth = np.multiply.outer(self.growth + self.table_radial, 1.0 - axial)
        axial_growth = np.multiply.outer(self.growth + self.table_axial, axial)
        return np.asarray(points + (radial_growth + axial_growth) * points)

    def with_table(self, place: Array) -> Array:
        """Where points (n, 3) that the table carries are when its axis has moved, m."""
        # A node asks for each reading by itself: most tables do not tilt, and turning takes longer than all else here.
        turned = rotate(place, np.broadcast_to(self.table_tilt, place.shape)) if np.any(self.table_tilt) else place
        return np.asarray(turned + self.table_shift)

    def added(self, sight: Sight) -> Array:
        """(n,) the sum of what is added to the reading, m."""
        return sum((function(sight) for function in self.reading), np.zeros(len(sight.path)))


def combine(parts: tuple[Disturbance, ...]) -> Disturbance:
    """The sum of several disturbances."""
    total: dict[str, Any] = vars(Disturbance()).copy()
    for part in parts:
        for name, value in vars(part).items():
            total[name] = summed(total[name], value) if isinstance(value, Mapping) else total[name] + value
    return Disturbance(**total)


Parameters = Mapping[str, Any]
Disturb = Callable[[float, Parameters, Scene], Disturbance]
Draw = Callable[[np.random.Generator, Scene | None], Parameters]
ALL_METHODS = ("step_diagonal", "tracking_interferometer", "rotary_axis", "probing", "direct", "ball_bar")
LINEAR = ("step_diagonal", "tracking_interferometer", "probing", "direct", "ball_bar")
"""Methods that move linear axes."""
TABLE = ("rotary_axis", "probing")
"""Those that turn a table."""
CIRCLE = ("ball_bar",)
"""Those that go round circles."""
BEAM = ("step_diagonal", "tracking_interferometer", "rotary_axis")
"""Those of a beam of light."""
STATIONS = ("tracking_interferometer", "rotary_axis")
"""Those of a beam that is pointed from a station."""


@dataclass(frozen=True)
class Flaw:
    """How one effect disturbs a measurement."""

    id: str  # the catalogue's id, or one that begins with `unlisted_`
    formula: str  # what it does, in words or as a formula of its size
    unit: str  # unit of the size
    typical: float  # a size that shows in a measurement
    # (size, parameters, scene) -> disturbance; element by element: one reading at a time gives the same as all
    disturb: Disturb
    defaults: Parameters = field(default_factory=dict)  # parameters that the user may set, with their values
    draw: Draw | None = None  # (source of chance, scene or None) -> parameters that are random unless set
    methods: tuple[str, ...] = ALL_METHODS  # the methods in which it can occur
    axis: str = ""  # letter of the rotary axis on which it occurs; empty: any

    @property
    def listed(self) -> bool:
        """Whether the effect is in the catalogue."""
        return not self.id.startswith("unlisted_")


@dataclass(frozen=True)
class Chosen:
    """A flaw with its size and all its parameters settled."""

    flaw: Flaw
    size: float
    parameters: Parameters

    def disturb(self, scene: Scene) -> Disturbance:
        """The disturbance of readings taken under these conditions."""
        return self.flaw.disturb(self.size, self.parameters, scene)

    def document(self) -> dict[str, Any]:
        """For `truth.json`."""
        return {"id": self.flaw.id, "size": self.size, "unit": self.flaw.unit, **dict(self.parameters)}


def reads(change: Callable[[float, Parameters, Scene, Sight], Array]) -> Disturb:
    """A disturbance of the reading itself: (size, parameters, scene, sight) -> what is added, (n,) m."""
    return lambda size, given, scene: Disturbance(reading=(lambda sight: change(size, given, scene, sight),))


def drawn_phase(rng: np.random.Generator, _: Scene | None) -> Parameters:
    """Where in its turn a wave begins."""
    return {"phase": float(rng.uniform(0, 2 * np.pi))}


def drawn_seed(rng: np.random.Generator, _: Scene | None) -> Parameters:
    """Of what a flaw draws itself."""
    return {"seed": int(rng.integers(2**31))}
