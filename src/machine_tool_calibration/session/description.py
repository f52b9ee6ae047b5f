# SPDX-License-Identifier: Apache-2.0
"""What `session.yaml` says, in SI units and radians: a frozen record per method; an unknown key is an error."""

from __future__ import annotations

import itertools
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from datetime import date
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal, TypeVar

from pydantic import AfterValidator, Field, model_validator

from machine_tool_calibration.errors import SessionError
from machine_tool_calibration.machine.chain import Chain
from machine_tool_calibration.machine.error_motions import SQUARENESS, parse_motion
from machine_tool_calibration.session.contributor import Contributors
from machine_tool_calibration.session.record import Record
from machine_tool_calibration.session.values import Finite, Identifier, Instrument, Positive, Sign, Vector2, Vector3

# Each has unknowns of its own, whether it was read or not: with some thousands a fit takes many minutes.
_SETUPS = Field(min_length=1, max_length=1000)


@dataclass(frozen=True)
class Place:
    """Names of a measurement's parts, for messages."""

    description: str  # what holds the description, such as the path of `session.yaml`
    readings: str  # what holds the readings, such as the path of `observations.csv`
    where: Callable[[int], str] | None = None  # names the place of a row, where the readings are a text file

    def row(self, row: int) -> str:
        """`file row 3`, or as `where` says, such as `file row 3 (line 5)`; rows count from 0, lines from 1."""
        return f"{self.readings} row {row}" if self.where is None else self.where(int(row))


def _check_about(value: Any, where: str = "about") -> Any:
    """Nested texts; what is not text, such as a number or date from a program, becomes its text."""
    if isinstance(value, dict):
        return {str(key): _check_about(entry, f"{where}.{key}") for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [_check_about(entry, f"{where}[{k}]") for k, entry in enumerate(value)]
    if value is None or isinstance(value, str | int | float | date):
        return "" if value is None else value.isoformat() if isinstance(value, date) else str(value)
    raise ValueError(f"{where} must be text, a number, a date, or a list or mapping of such")


About = Annotated[dict[str, Any], AfterValidator(_check_about)]
"""Free descriptive data: nested texts, as they stand in the file."""


def _by_small_letters(axes: dict[str, Any] | None) -> dict[str, Any] | None:
    """What is said of axes, by their names as columns have them."""
    if axes is not None and len({name.lower() for name in axes}) < len(axes):
        raise ValueError(f"names an axis twice: {', '.join(axes)}")
    return None if axes is None else {name.lower(): own for name, own in axes.items()}


class Machine(Record):
    """The machine tool's chain and travel."""

    chain: str  # axes from workpiece to tool in the order of ISO 10791, such as `w-C-b-Y-X-Z-t`
    # lower and upper end of each axis, m or rad
    travel: Annotated[dict[str, Vector2], AfterValidator(_by_small_letters)] = Field(default_factory=dict)
    # nodes of the error tables of each axis, m (probing)
    table_grid: Annotated[
        dict[str, Annotated[tuple[Finite, ...], Field(min_length=2)]] | None, AfterValidator(_by_small_letters)
    ] = None
    # sense in which the workpiece turns, seen from +Z, for C positive: -1 clockwise (probing), +1 counter-clockwise
    rotation_sign: Literal[-1, 1] | None = None
    axis: str | None = None  # the rotary axis under test (rotary_axis)
    # from the point to which the axes' positions refer (where the lever arms of the axes' angular errors end if
    # nothing is said) to the functional point, x, y, z, m
    tool_offset: Vector3 | None = None

    @property
    def table_axis(self) -> str:
        """Letter of the rotary axis under test, or that carries the workpiece: the one named, the chain's, else C."""
        rotary = Chain.parse(self.chain).rotary
        return (self.axis or (rotary[0] if len(rotary) == 1 else "C")).upper()

    @property
    def kinematics(self) -> Chain:
        """The chain, with the functional point at its end."""
        return replace(Chain.parse(self.chain), tool_offset=self.tool_offset or (0.0, 0.0, 0.0))

    @model_validator(mode="after")
    def _check(self) -> Machine:
        chain = Chain.parse(self.chain)
        for name, (low, high) in self.travel.items():
            if name.upper() not in chain.axes:
                raise ValueError(f"travel names axis {name!r}, which the chain {self.chain} does not have")
            if not low < high:
                raise ValueError(f"travel of {name} must run from low to high, not {low} to {high}")
        for name, nodes in (self.table_grid or {}).items():
            if any(b <= a for a, b in itertools.pairwise(nodes)):
                raise ValueError(f"table_grid of {name} must increase")
        if self.axis is not None and self.axis.upper() not in chain.rotary:
            raise ValueError(f"axis is {self.axis!r}, which is no rotary axis of the chain {self.chain}")
        return self


class DeclaredUncertainty(Record):
    """Standard uncertainty (k = 1) of one reading, of the form a + b L."""

    displacement: Positive  # a, m
    # b, m/m; L is the nominal path from the instrument to the functional point, or, of deviations that are read
    # directly, the distance from the machine's zero along the sensed direction
    per_length: Annotated[Finite, Field(ge=0)] = 0.0


class StandardUncertainty(DeclaredUncertainty):
    """The same for all readings, or for single setups otherwise."""

    # by id, for setups whose readings are better or worse than the others
    setups: dict[str, DeclaredUncertainty] = Field(default_factory=dict)


class KnownLength(Record):
    """One measured positioning error that fixes the absolute length: value at a position of an axis."""

    position: Finite
    value: Finite
    standard_uncertainty: Annotated[Finite, Field(ge=0)]


class Target(Record):
    """A retroreflector on the rotary table: its position in the table frame at c = 0, m."""

    id: Identifier
    position: Vector3
    position_uncertainty: Positive | None = None


class WorkpiecePoint(Record):
    """A probed point: nominal position and outward normal in the workpiece frame at c = 0."""

    id: Identifier
    feature: str = "work"
    position: Vector2
    normal: Vector2


class Probe(Record):
    """The touch-trigger probe: stylus sphere's diameter, m."""

    stylus_diameter: Positive


class Setup(Record):
    """A setup of the instrument; methods add what they need to know of it."""

    id: Identifier


_ORDER = re.compile(r"^(?P<name>.+?)[_.-](?P<order>[xyzXYZ]{2,3})$")


class DiagonalSetup(Setup):
    """A step diagonal or linear run with a flat mirror; its id may carry the order of moves, as `ppp_yzx`, else xyz."""

    kind: Literal["diagonal", "linear"]
    direction: tuple[Sign, Sign, Sign]  # of the motion along x, y, z
    start: Vector3  # where the run begins, m
    mirror: Literal["flat"] = "flat"

    @property
    def name_and_order(self) -> tuple[str, str]:
        """The id without the order, and the order of the moves; one letter for a linear run."""
        moving = "".join(axis for axis, sign in zip("xyz", self.direction, strict=True) if sign)
        found = _ORDER.match(self.id)
        declared = "".join(letter for letter in found["order"].lower() if letter in moving) if found else ""
        # Letters that are not all moving axes, once each, are a name and no order.
        return (found["name"], declared) if found and sorted(declared) == sorted(moving) else (self.id, moving)

    def path(self, step: Sequence[float], blocks: int) -> list[tuple[float, ...]]:
        """Places x, y, z at which it is read, m: moves of a step along single axes, block after block."""
        made, motion = [0, 0, 0], [length * sign for length, sign in zip(step, self.direction, strict=True)]
        places: list[tuple[float, ...]] = [self.start]
        for axis in self.name_and_order[1] * blocks:
            made["xyz".index(axis)] += 1
            # From the start, so that no rounding adds up.
            places.append(tuple(s + k * m for s, k, m in zip(self.start, made, motion, strict=True)))
        return places


class StationSetup(Setup):
    """A station of a tracking interferometer: estimate of its rotation centre, machine frame, m."""

    position: Vector3
    position_uncertainty: Positive | None = None


class IndexSetup(Setup):
    """One angular position of C at which the workpiece is probed, rad."""

    c: Finite


class CircleSetup(Setup):
    """A circle: its two axes, the centre where it is meant to be, m, the bar's nominal length, m."""

    plane: Literal["XY", "YZ", "ZX"]  # counter-clockwise is from its first axis towards its second
    centre: Vector3
    radius: Positive
    feed: Positive | None = None  # path speed, m/s, where the readings do not say it in a column `feed`


Said = TypeVar("Said", bound="Description")


class Description(Record):
    """What every method says; each adds its `method`, its `setups`, and what else it has to say."""

    reads: ClassVar[str | None] = None  # the instrument, unless the session says it
    turns: ClassVar[int] = 1  # sense in which C turns the workpiece if not said: +1 counter-clockwise from +Z

    if TYPE_CHECKING:
        method: str
        setups: tuple[Setup, ...]

    format: Literal["mtcal-session/1"]
    machine: Machine
    repeats: Annotated[int, Field(ge=1)] = 1
    standard_uncertainty: StandardUncertainty
    trust_units: bool = False  # whether sizes, units and places are taken as they are, however implausible
    # who, what, when: machine, serial numbers, instruments, certificates, operator, place, date, …
    about: About = Field(default_factory=dict)
    budget: Contributors = ()  # contributors to the uncertainty of the readings, beside their own scatter

    @property
    def axes(self) -> str:
        """Those along which places are told: `xy` of a measurement in a plane."""
        return "xyz"

    def as_a(self, kind: type[Said]) -> Said:
        """The same, where its method is known; a TypeError if it is of another one."""
        if not isinstance(self, kind):
            raise TypeError(f"a description of {self.method} is no {kind.__name__}")
        return self

    @model_validator(mode="after")
    def _check_ids(self) -> Any:
        for key in ("setups", "targets", "workpiece"):
            ids = [entry.id for entry in getattr(self, key, ())]
            twice = sorted({i for i in ids if ids.count(i) > 1}) if len(set(ids)) < len(ids) else []
            if twice:
                raise ValueError(f"{key} has the id {twice[0]!r} twice")
        known = [entry.id for entry in getattr(self, "setups", ())]
        for name in self.standard_uncertainty.setups:
            if name not in known:
                raise ValueError(f"standard_uncertainty.setups names {name!r}, which is no setup")
        return self


class StepDiagonal(Description):
    """Laser step diagonal measurement, Ibaraki and Hata 2010."""

    reads: ClassVar[str | None] = "laser_interferometer"

    method: Literal["step_diagonal"]
    step: tuple[Positive, Positive, Positive]
    blocks: Annotated[int, Field(ge=1)]
    setups: Annotated[tuple[DiagonalSetup, ...], _SETUPS]

    def positions(self, index: int) -> list[dict[str, float]]:
        """Commanded positions of a setup's run, m: to the picometre, so that none is beyond the travel."""
        path = self.setups[index].path(self.step, self.blocks)
        return [{axis: round(place, 12) for axis, place in zip("xyz", places, strict=True)} for places in path]


class TrackingInterferometer(Description):
    """Tracking interferometer, open-loop or with a beam that follows the target, Ibaraki et al. 2014."""

    reads: ClassVar[str | None] = "tracking_interferometer"

    method: Literal["tracking_interferometer"]
    dimension: Literal[2, 3]
    pointing: Literal["open_loop", "tracking"]
    setups: Annotated[tuple[StationSetup, ...], _SETUPS]

    @property
    def axes(self) -> str:
        """In two dimensions `xy`."""
        return "xyz"[: self.dimension]


class RotaryAxis(Description):
    """Rotary axis by sequential multilateration, Zhang et al. 2015."""

    reads: ClassVar[str | None] = "laser_tracker"

    method: Literal["rotary_axis"]
    targets: Annotated[tuple[Target, ...], Field(min_length=1)]
    setups: Annotated[tuple[StationSetup, ...], _SETUPS]
    rotation_sign: Literal[-1, 1] | None = None


class Probing(Description):
    """Probing self-calibration of a free-form part on a rotary table."""

    reads: ClassVar[str | None] = "touch_probe"
    turns: ClassVar[int] = -1

    method: Literal["probing"]
    workpiece: Annotated[tuple[WorkpiecePoint, ...], Field(min_length=1)]
    probe: Probe | None = None
    setups: Annotated[tuple[IndexSetup, ...], _SETUPS]
    known: dict[str, KnownLength] = Field(default_factory=dict)


class Direct(Description):
    """An instrument that reads deviations directly: ISO 230-2 run, grid encoder, CMM and others."""

    method: Literal["direct"]
    instrument: Instrument | None = None  # what read; effects of air and beam are looked for if it has a beam
    datum: Literal["none", "offset", "rigid"] = "none"  # what the instrument leaves open in every setup
    terms: tuple[str, ...] = ()  # the machine errors in the model
    setups: Annotated[tuple[Setup, ...], _SETUPS]

    @model_validator(mode="after")
    def _check_terms(self) -> Direct:
        for k, name in enumerate(self.terms):
            if name in self.terms[:k]:
                raise ValueError(f"terms names {name!r} twice")
            for axis in SQUARENESS.get(name) or parse_motion(name).axis:
                if axis not in self.machine.kinematics.linear:
                    raise ValueError(f"terms names {name!r}, but the chain has no linear axis {axis}")
        return self

    @property
    def sense(self) -> Vector3:
        """Direction along which the instrument of a procedure reads: that of the first term, as Y of EYX."""
        name = self.terms[0] if self.terms else ""
        if len(name) != 3 or name[0] != "E" or name[1] not in "XYZ":
            raise SessionError(
                "session: terms must begin with a translation such as EXX: it says along which axis the instrument "
                "reads"
            )
        return (float(name[1] == "X"), float(name[1] == "Y"), float(name[1] == "Z"))


class BallBar(Description):
    """Deviations of the distance between tool and centre from the bar's nominal length, all around."""

    reads: ClassVar[str | None] = "ball_bar"

    method: Literal["ball_bar"]
    setups: Annotated[tuple[CircleSetup, ...], _SETUPS]
    # standard uncertainty of the bar's length, m: of one that was calibrated, radial deviations are reported
    length_uncertainty: Positive | None = None

    @model_validator(mode="after")
    def _check_axes(self) -> BallBar:
        for setup in self.setups:
            for axis in setup.plane:
                if axis not in self.machine.kinematics.linear:
                    raise ValueError(
                        f"setup {setup.id} is in {setup.plane}, and the chain {self.machine.chain} has no axis {axis}"
                    )
        return self
