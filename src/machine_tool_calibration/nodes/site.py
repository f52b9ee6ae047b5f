"""The simulated machine and instrument behind the nodes: one description (YAML), shared by all simulating nodes.

Every quantity is a pure function of what is passed in, so that separate processes see the same world, and a process
that restarts sees it again. What is random (the machine's errors, the environment, where the stations really are) comes
from the seed.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Annotated

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.errors import CalibrationError
from machine_tool_calibration.machine.chain import Chain
from machine_tool_calibration.session.description import Description, StationSetup
from machine_tool_calibration.session.yaml_text import load_yaml
from machine_tool_calibration.simulation.disturbance import Disturbance, Sight, combine
from machine_tool_calibration.simulation.environment import Environment, random_environment
from machine_tool_calibration.simulation.flaw import Chosen
from machine_tool_calibration.simulation.flaws import choose_flaw
from machine_tool_calibration.simulation.machine import VirtualMachine
from machine_tool_calibration.simulation.machine_file import MachineSpec, build_machine, one_line
from machine_tool_calibration.simulation.scene import Scene
from machine_tool_calibration.simulation.spec import FlawSpec
from machine_tool_calibration.simulation.tracking import Pointer, distance, sensed_path

__all__ = ["Beam", "Moment", "PointerSpec", "Site", "SiteSpec", "read_site"]

Finite = Annotated[float, Field(allow_inf_nan=False)]
Size = Annotated[float, Field(ge=0, allow_inf_nan=False)]
_STREAMS = ("machine", "environment", "effects", "stations")
_DEFAULT_TRAVEL = {"x": (0.0, 0.4), "y": (0.0, 0.4), "z": (0.0, 0.4)}
_DEFAULT_CHAIN = "w-C-b-Y-X-Z-t"
_TURNS = (-20.0 * np.pi, 20.0 * np.pi)


class _Record(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")


class PointerSpec(_Record):
    """True errors of the rotary pointer: angles in rad, lengths in m, `radial` (cos, sin) by order of the azimuth."""

    zero_offset: Finite = 0.0
    elevation_offset: Finite = 0.0
    eccentricity: Finite = 0.0
    radial: dict[int, tuple[Finite, Finite]] = {}


class SiteSpec(_Record):
    """What is true in the simulated workshop.

    Attributes:
        seed: of all that is random.
        machine: chain, travel and true errors; random errors of a good machining centre by default.
        effects: physical effects at work, by the catalogue's ids.
        pointer: true errors of the rotary pointer.
        station_uncertainty: standard deviation of a true station from its estimate per coordinate, m; each setup's
            own `position_uncertainty` if absent.
        noise: standard deviation of a captured reading, m.
        repeatability: standard deviation of the machine's position at each visit, per coordinate, m.
        environment_swing: factor on all changes of temperature, pressure and humidity.
    """

    seed: Annotated[int, Field(ge=0)] = 0
    machine: MachineSpec = MachineSpec()
    effects: tuple[FlawSpec, ...] = ()
    pointer: PointerSpec = PointerSpec()
    station_uncertainty: Size | None = None
    noise: Size = 3e-7
    repeatability: Size = 0.0
    environment_swing: Size = 1.0


@dataclass(frozen=True)
class Moment:
    """Under which conditions something is looked at.

    Attributes:
        time: s since the origin of the site's time.
        position: commanded position of each axis, m or rad.
        direction: sign of each axis's last move.
        setup: index of the instrument's setup.
        setup_start: when that setup's first reading was taken, s.
    """

    time: float
    position: Mapping[str, float]
    direction: Mapping[str, int]
    setup: int = 0
    setup_start: float = 0.0


@dataclass(frozen=True)
class Beam:
    """The true beam: its origin (3,), m, and its unit direction (3,)."""

    origin: Array
    direction: Array


class Site:
    """The simulated world.

    Args:
        spec: what is true.

    Raises:
        CalibrationError: the machine cannot be built or an effect is unknown.
    """

    def __init__(self, spec: SiteSpec) -> None:
        self.spec = spec
        children = np.random.SeedSequence(spec.seed).spawn(len(_STREAMS))
        self._seeds = dict(zip(_STREAMS, children, strict=True))
        self.chosen: tuple[Chosen, ...] = tuple(self._choose(effect, i) for i, effect in enumerate(spec.effects))
        machine = build_machine(
            spec.machine,
            chain=_DEFAULT_CHAIN,
            travel=_DEFAULT_TRAVEL,
            seed=np.random.default_rng(self._seeds["machine"]),
        )
        fixed = self._disturbance(Moment(0.0, {}, {}))
        self.machine: VirtualMachine = machine.with_tables(fixed.tables).with_squareness(fixed.squareness)
        self.environment: Environment = random_environment(
            np.random.default_rng(self._seeds["environment"]), swing=spec.environment_swing
        )
        self.pointer = Pointer(**spec.pointer.model_dump())

    def _choose(self, effect: FlawSpec, index: int) -> Chosen:
        if effect.amplitude is not None:
            raise CalibrationError(f"effect {effect.id}: the graph takes a size, not an amplitude")
        rng = np.random.default_rng([self.spec.seed, 7, index])
        return choose_flaw(effect.id, effect.size, effect.parameters, rng)

    @cached_property
    def travel(self) -> dict[str, tuple[float, float]]:
        """Lower and upper end of each axis, by its small letter, m or rad."""
        ends = {axis.lower(): limits for axis, limits in self.machine.travel.items()}
        return {axis.lower(): ends.get(axis.lower(), _TURNS) for axis in self.chain.axes}

    @property
    def chain(self) -> Chain:
        """The machine's chain."""
        return self.machine.chain

    def sensed(self, time: float) -> dict[str, float]:
        """What the sensors of the environment show, by column name."""
        return {name: float(values[0]) for name, values in self.environment(np.array([time])).items()}

    def _disturbance(self, moment: Moment) -> Disturbance:
        if not self.chosen:
            return Disturbance()
        scene = Scene(
            time=np.array([moment.time]),
            setup=np.array([moment.setup]),
            repeat=np.zeros(1, int),
            position=np.array([[moment.position.get(axis, 0.0) for axis in "xyz"]]),
            angle=np.array([moment.position.get("c", 0.0)]),
            direction={axis.upper(): np.array([float(sign)]) for axis, sign in moment.direction.items()},
            environment=self.environment(np.array([moment.time])) if hasattr(self, "environment") else {},
            ends=getattr(getattr(self, "machine", None), "travel", {}),
            start=np.array([moment.setup_start]),
        )
        return combine(tuple(flaw.disturb(scene) for flaw in self.chosen))

    def functional_point(self, moment: Moment) -> Array:
        """(3,) where the functional point really is, m, workpiece frame."""
        disturbance = self._disturbance(moment)
        command = np.array([[moment.position.get(axis, 0.0) for axis in "xyz"]])
        point = self.machine.position(command, disturbance.axis)[0]
        return point if disturbance.point is None else point + disturbance.point[0]

    def station(self, description: Description, index: int) -> Array:
        """(3,) the true rotation centre of a setup, m: its estimate and a deviation drawn from the seed."""
        setup = description.setups[index]
        if not isinstance(setup, StationSetup):
            raise CalibrationError(f"setup {setup.id} of a {description.method} session is not a station")
        spread = self.spec.station_uncertainty
        spread = (setup.position_uncertainty or 0.0) if spread is None else spread
        drawn = np.random.default_rng([self.spec.seed, 11, index]).normal(size=3) * spread
        if getattr(description, "dimension", 3) == 2:
            drawn[2] = 0.0
        return np.asarray(np.array(setup.position) + drawn)

    def beam(self, station: Array, azimuth: float, elevation: float, moment: Moment) -> Beam:
        """The true beam for commanded angles, rad, of a pointer whose true rotation centre is `station` (3,)."""
        disturbance = self._disturbance(moment)
        centre = station if disturbance.station is None else station + disturbance.station[0]
        turn = 0.0 if disturbance.turn is None else disturbance.turn
        origin, direction = self.pointer.beam(np.array([azimuth]), np.array([elevation]), centre[None], turn)
        return Beam(origin[0], direction[0])

    def path(self, point: Array, beam: Beam, moment: Moment, *, tracking: bool, first: float | None = None) -> float:
        """What the interferometer senses, without noise, m.

        Args:
            point: (3,) true position of the retroreflector, m.
            beam: the true beam.
            moment: the conditions.
            tracking: whether the beam follows the retroreflector, instead of being held on its direction.
            first: geometric path of the setup's first reading, m; this one if absent.
        """
        if tracking:
            length = float(distance(point, beam.origin))
            direction = (point - beam.origin) / length
        else:
            direction = beam.direction
            length = float(sensed_path(point, beam.origin, direction))
        if not self.chosen:
            return length
        azimuth = float(np.arctan2(direction[1], direction[0])) - (0.0 if tracking else self.pointer.zero_offset)
        middle = [0.5 * sum(self.travel.get(axis, (0.0, 0.0))) for axis in "xyz"]
        facing = np.arctan2(middle[1] - beam.origin[1], middle[0] - beam.origin[0])
        sight = Sight(
            path=np.array([length]),
            direction=direction[None],
            azimuth=np.array([azimuth]),
            incidence=np.array([np.angle(np.exp(1j * (azimuth - facing)))]),
            change=np.array([0.0 if first is None else length - first]),
        )
        return length + float(self._disturbance(moment).added(sight)[0])


def read_site(path: str) -> SiteSpec:
    """The site described in a YAML file; the usual one for an empty path.

    Raises:
        CalibrationError: the file cannot be read, or a key or value is wrong.
    """
    if not path:
        return SiteSpec()
    try:
        content = load_yaml(Path(path).read_text(encoding="utf-8"), path).value
    except OSError as error:
        raise CalibrationError(f"{path}: cannot be read: {error.strerror}") from None
    except UnicodeDecodeError:
        raise CalibrationError(f"{path}: is not UTF-8 text") from None
    try:
        return SiteSpec.model_validate(content if content is not None else {})
    except ValidationError as error:
        raise CalibrationError(f"{path}: {one_line(error)}") from None
