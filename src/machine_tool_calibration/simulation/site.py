# SPDX-License-Identifier: Apache-2.0
"""The simulated workshop behind the nodes: one description (YAML), shared by all simulating nodes.

Every quantity is a pure function of what is passed in, so that separate processes, or one that restarts, see the same
world. What is random (the machine's errors, the environment, where the stations really are) comes from the seed.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from types import MappingProxyType
from typing import Annotated

import numpy as np
from pydantic import Field

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.errors import CalibrationError
from machine_tool_calibration.instruments.touch import NominalTouch, Part
from machine_tool_calibration.session.checks.nominal_geometry import nominal_points
from machine_tool_calibration.session.description import Description, StationSetup, Target
from machine_tool_calibration.session.record import NotNegative, Record
from machine_tool_calibration.simulation.flaw import Chosen, Disturbance, combine
from machine_tool_calibration.simulation.flaws import choose_flaw
from machine_tool_calibration.simulation.machine import VirtualMachine
from machine_tool_calibration.simulation.machine_file import MachineSpec, build_machine, read_record
from machine_tool_calibration.simulation.probing_run import touched
from machine_tool_calibration.simulation.scene import Drift, Scene, random_environment
from machine_tool_calibration.simulation.sensors import Pointer
from machine_tool_calibration.simulation.spec import FlawSpec


class LiveMachine:
    """A machine, given without its flaws, whose errors depend on time, temperature and direction."""

    def __init__(
        self,
        machine: VirtualMachine,
        flaws: Iterable[Chosen] = (),
        environment: Mapping[str, Drift] = MappingProxyType({}),
    ) -> None:
        self.machine, self.flaws, self.environment = machine, tuple(flaws), environment
        fixed = self.disturbance(self.scene(0.0, np.zeros(3)))
        # with the flaws' extra error motions and squareness
        self.machine = machine.with_errors(fixed.tables, fixed.squareness)

    def scene(
        self,
        time: Array | float,
        position: Array | Iterable[float],
        direction: Mapping[str, Array | float] | None = None,
        *,
        angle: Array | float = 0.0,
        axis: str = "C",
        setup: int = 0,
        start: float = 0.0,
    ) -> Scene:
        """The conditions of one or more moments: s since the start of the session, a number or (n,).

        Positions are commanded x, y, z, (3,) or (n, 3), m; directions signs of the last move by axis letter, +1 where
        absent; `angle` is that of the rotary axis, rad, `setup` the instrument's, and `start` the time of its first
        reading, s.
        """
        at = np.atleast_2d(np.asarray(position, float))
        n = max(len(at), np.size(time))

        def each(value: Array | float) -> Array:
            return np.broadcast_to(np.asarray(value, float), n)

        return Scene(
            time=each(time),
            setup=np.full(n, setup),
            repeat=np.zeros(n, np.int64),
            position=np.broadcast_to(at, (n, 3)),
            angle=each(angle),
            direction={name: each(value) for name, value in (direction or {}).items()},
            environment=self.environment,
            axis=axis,
            ends=self.machine.travel,
            start=each(start),
        )

    def disturbance(self, scene: Scene) -> Disturbance:
        """What the flaws do at these moments."""
        return combine(tuple(flaw.disturb(scene) for flaw in self.flaws))

    def functional_point(self, scene: Scene) -> Array:
        """(n, 3) where the functional point really is in the workpiece frame, m."""
        return self.disturbance(scene).functional_point(self.machine, scene.position)

    def tool_rotation(self, scene: Scene) -> Array:
        """(n, 3, 3) rotation of the tool with respect to the workpiece."""
        return self.machine.tool_rotation(scene.position, self.disturbance(scene).errors)

    def on_table(self, scene: Scene, point: Array) -> Array:
        """(n, 3) where a point of the table (its target, the workpiece) really is in the machine frame, m."""
        return self.disturbance(scene).on_table(self.machine, point, scene.angle, scene.axis)


_DEFAULT_TRAVEL = {"x": (0.0, 0.4), "y": (0.0, 0.4), "z": (0.0, 0.4)}
_DEFAULT_CHAIN = "w-C-b-Y-X-Z-t"
_NOISE = 3e-7
_CENTRED = 2e-5  # m: standard deviation to which a ball bar's cup is put in its place
_TURNS = (-20.0 * np.pi, 20.0 * np.pi)


class SiteSpec(Record):
    """What is true in the simulated workshop."""

    seed: Annotated[int, Field(ge=0)] = 0  # of all that is random
    machine: MachineSpec = MachineSpec()  # chain, travel and true errors; random ones of a good machine if absent
    effects: tuple[FlawSpec, ...] = ()  # physical effects at work, by the catalogue's ids
    pointer: Pointer = Pointer()  # true errors of the rotary pointer
    # standard deviation of true stations per coordinate, m; each setup's own `position_uncertainty` if absent
    station_uncertainty: NotNegative | None = None
    target_uncertainty: NotNegative | None = None  # likewise of a target on the table
    mirror_tilt: NotNegative = 1e-3  # angle between a flat mirror's normal and its beam, in a random direction, rad
    noise: NotNegative | None = None  # standard deviation of a reading, m; the session's declared uncertainty if absent
    repeatability: NotNegative = 0.0  # standard deviation of the machine's position at each visit, per coordinate, m
    environment_swing: NotNegative = 1.0  # factor on all changes of temperature, pressure and humidity


@dataclass(frozen=True)
class Beam:
    """The true beam: its origin (3,), m, and its unit direction (3,)."""

    origin: Array
    direction: Array

    def off(self, points: Array) -> Array:
        """(n,) distance of points (n, 3) from the beam, m."""
        return np.asarray(np.linalg.norm(np.cross(points - self.origin, self.direction), axis=-1))


NO_BEAM = Beam(np.full(3, np.nan), np.full(3, np.nan))
"""Stands for the beam of an instrument that has not been told of any, or whose beam is fixed."""


class Site(LiveMachine):
    """The simulated world; a CalibrationError if the machine cannot be built or an effect is unknown."""

    def __init__(self, spec: SiteSpec) -> None:
        self.spec = spec
        of_machine, of_environment = map(np.random.default_rng, np.random.SeedSequence(spec.seed).spawn(2))
        super().__init__(
            build_machine(spec.machine, chain=_DEFAULT_CHAIN, travel=_DEFAULT_TRAVEL, seed=of_machine),
            [self._choose(effect, index) for index, effect in enumerate(spec.effects)],
            random_environment(of_environment, swing=spec.environment_swing),
        )

    def _choose(self, effect: FlawSpec, index: int) -> Chosen:
        if effect.amplitude is not None:
            raise CalibrationError(f"effect {effect.id}: the graph takes a size, not an amplitude")
        rng = np.random.default_rng([self.spec.seed, 7, index])
        return choose_flaw(effect.id, effect.size, effect.parameters, rng)

    @property
    def noise(self) -> float:
        """Standard deviation of a captured reading, m."""
        return _NOISE if self.spec.noise is None else self.spec.noise

    @cached_property
    def travel(self) -> dict[str, tuple[float, float]]:
        """Lower and upper end of each axis, by its small letter, m or rad."""
        ends = {axis.lower(): limits for axis, limits in self.machine.travel.items()}
        return {axis.lower(): ends.get(axis.lower(), _TURNS) for axis in self.machine.chain.axes}

    @cached_property
    def table_axis(self) -> str:
        """Letter of the rotary axis that carries the workpiece; empty if there is none."""
        return next((axis for axis in self.machine.chain.workpiece_side if axis in "ABC"), "")

    def sensed(self, time: float) -> dict[str, float]:
        """What the sensors of the environment show, by column name."""
        return {name: float(drift(np.array([time]))[0]) for name, drift in self.environment.items()}

    def moment(
        self,
        time: float,
        position: Mapping[str, float] = MappingProxyType({}),
        direction: Mapping[str, int] = MappingProxyType({}),
        setup: int = 0,
        start: float = 0.0,
    ) -> Scene:
        """The conditions of one moment, s since the origin of the site's time.

        By small letters of axes their commanded positions, m or rad, 0 where absent, and the signs of their last moves,
        +1 where absent; `setup` is the instrument's, and `start` when its first reading was taken, s.
        """
        axis = self.table_axis or "C"
        place, angle = [position.get(name, 0.0) for name in "xyz"], position.get(axis.lower(), 0.0)
        signs = {name.upper(): float(sign) for name, sign in direction.items()}
        return self.scene(time, place, signs, angle=angle, axis=axis, setup=setup, start=start)

    def table(self, moment: Scene) -> tuple[Array, Array]:
        """Where the table's frame really is: (3,) its origin, m, and (3, 3) its rotation, in the machine frame."""
        disturbance = self.disturbance(moment)
        corners = np.vstack([np.zeros(3), np.eye(3)])
        angle, shift = np.repeat(moment.angle, 4), disturbance.axis.get(moment.axis, 0.0)
        placed = disturbance.with_table(self.machine.on_table(corners, angle, moment.axis, shift))
        return placed[0], (placed[1:] - placed[0]).T

    def station(self, description: Description, index: int) -> Array:
        """(3,) the true rotation centre of a setup, m: its estimate and a deviation drawn from the seed."""
        setup = description.setups[index]
        if not isinstance(setup, StationSetup):
            raise CalibrationError(f"setup {setup.id} of a {description.method} session is not a station")
        drawn = self._drawn(11, index, self.spec.station_uncertainty, setup.position_uncertainty)
        if description.axes == "xy":
            drawn[2] = 0.0
        return np.array(setup.position) + drawn

    def target(self, target: Target, index: int) -> Array:
        """(3,) the true position of a target on the table, m, table frame: its estimate and a deviation."""
        drawn = self._drawn(13, index, self.spec.target_uncertainty, target.position_uncertainty)
        return np.array(target.position) + drawn

    def _drawn(self, stream: int, index: int, spread: float | None, declared: float | None) -> Array:
        size = (declared or 0.0) if spread is None else spread
        return np.random.default_rng([self.spec.seed, stream, index]).normal(size=3) * size

    def mirror_tilt(self, index: int) -> Array:
        """(2,) tilt of a setup's flat mirror off its beam, rad, in a direction drawn from the seed."""
        angle = np.random.default_rng([self.spec.seed, 17, index]).uniform(0.0, 2.0 * np.pi)
        return self.spec.mirror_tilt * np.array([np.cos(angle), np.sin(angle)])

    def cup_offset(self, index: int) -> Array:
        """(3,) how far a ball bar's cup of a setup stands beside its place, m, drawn from the seed."""
        return self._drawn(19, index, None, _CENTRED)

    def true_beam(self, moment: Scene, azimuth: float, elevation: float, station: Array) -> Beam:
        """The beam for commanded angles, rad, of the pointer whose true rotation centre is at a station (3,)."""
        disturbance, flat, up = self.disturbance(moment), np.array([azimuth]), np.array([elevation])
        origin, direction = self.spec.pointer.beam(flat, up, station + disturbance.station, disturbance.turn)
        return Beam(origin[0], direction[0])


def read_site(path: str) -> SiteSpec:
    """The site described in a YAML file, which must be right; the usual one for an empty path."""
    return read_record(Path(path), SiteSpec) if path else SiteSpec()


_FORM_STREAM = 41


class SimulatedPart:
    """True place of the sphere, true surface on the true table, with a scatter (`form`, m)."""

    def __init__(self, site: Site, part: Part, form: float) -> None:
        self._site, self._machine = site, replace(site.machine, rotation_sign=part.sign)
        self.part = part
        noise = site.spec.noise
        self.noise = part.description.standard_uncertainty.displacement if noise is None else noise
        self._place, self._normal = (np.pad(vectors, ((0, 0), (0, 1))) for vectors in nominal_points(part.description))
        self._form = form * np.random.default_rng([site.spec.seed, _FORM_STREAM]).normal(size=len(self._place))

    def trigger(self, touch: NominalTouch, c: float, z: float, time: float, setup: int) -> float:
        """Displacement at which the probe triggers, along the outward normal from the nominal surface, m.

        Of a touch as planned, at a commanded c, rad, and height z, m, `time` after the origin of the site's time, s.
        """
        normal, own = np.array([[*touch.normal, 0.0]]), [touch.point]
        direction = {axis: -1.0 if way > 0 else 1.0 for axis, way in zip("XY", touch.normal, strict=True)}
        scene = self._site.scene(time, [*touch.centre, z], direction, angle=c, setup=setup)
        disturbance = self._site.disturbance(scene)
        # The workpiece turns in the plane: heights are the probe's own.
        actual = disturbance.functional_point(self._machine, scene.position) * [1.0, 1.0, 0.0]
        surface = self._place[own], self._normal[own], self._form[own]
        errors = (self._machine, disturbance)
        return float(touched(*errors, *surface, scene.angle, actual, normal, self.part.radius)[0])
