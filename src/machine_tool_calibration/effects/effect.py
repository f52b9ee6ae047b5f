# SPDX-License-Identifier: Apache-2.0
"""What a physical effect states of itself, so that it can be simulated, fitted, ranked, added and drawn."""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.model.observations import SAME_POSITION, Observations
from machine_tool_calibration.words import Said


@dataclass(frozen=True)
class Coefficient:
    """A coefficient of an effect; by itself a linear one."""

    name: str  # short name in the formula
    unit: str  # SI
    low: float  # smallest plausible value; 0 where it is positive by its nature
    high: float  # largest plausible value
    meaning: str = ""  # what it is, in a few words
    usual: float = np.inf  # largest size that is usual; what lies between it and the limits occurs, but seldom
    # whether it is positive by convention alone, as a control compensates, or directions were exchanged
    by_convention: bool = False

    @property
    def least(self) -> float:
        """Smallest value that is looked for: a sign by convention is expected, and no wall."""
        return -self.high if self.by_convention else self.low


@dataclass(frozen=True)
class Shape(Coefficient):
    """A coefficient that enters nonlinearly: a time constant, a lead."""

    step: float = 1e-4  # share of its value over which slopes are taken
    discrete: bool = False  # whether it is chosen from a list, such as a number of harmonics, and has no uncertainty


class Effect(ABC):
    """One physical effect."""

    id: str  # the catalogue's name
    title: str  # in a few words
    formula: str  # as text
    source: str  # where it is described
    kind: Literal["position", "reading"]  # whether it displaces the functional point or changes the reading itself
    coefficients: tuple[Coefficient, ...] = ()  # the linear ones
    shapes: tuple[Shape, ...] = ()  # the nonlinear ones; at most one or two
    needs: tuple[str, ...] = ()  # columns of the session that it uses
    methods: tuple[str, ...] = ()  # in which it can act; all if empty
    # that can have it; all if empty. A direct session that does not name its instrument has none of these effects:
    # nothing says that there was a beam, and slow changes of the air look like any drift
    instruments: tuple[str, ...] = ()
    covariates: tuple[str, ...] = ()  # what the readings depend on through the effect; its columns if empty
    tolerance: float = 0.1  # share of its size to which the law holds, one standard deviation
    seldom: bool = False  # whether other causes are usual: a finer point of one, or one of a dozen of a kind
    setup_level: bool = False  # whether its coefficients belong to single setups, which then are the sample
    contains: tuple[str, ...] = ()  # ids of simpler effects that are a special case of it: a model does not hold both
    beside: str = ""  # id of the effect beside which alone it is looked for, as it would else look the same
    chain: str = ""  # letters of linear axes that the machine must have
    moves: str = ""  # letter of one of them that must have moved in the readings
    definition: Mapping[str, Any] | None = None  # of one by formula, what makes it anew; None of one that is a class

    @property
    def of_session(self) -> bool:
        """Whether each of several sessions has linear coefficients of its own; otherwise they are the machine's.

        What changes the reading itself is the instrument's, set up anew for each session. Time counts from a session's
        start, and how warm the machine then was differs. Nonlinear coefficients (a time constant, a lead) are always
        one for all sessions.
        """
        return self.setup_level or self.kind == "reading" or "time" in (*self.needs, *self.covariates)

    @property
    def of_state(self) -> bool:
        """Whether it depends on more than place and direction of approach: on time, or on what a sensor says."""
        columns = {*self.needs, *self.covariates}.difference("xyzabc")
        return any(not name.startswith("dir_") for name in columns)

    def why_not(self, observations: Observations) -> str | None:
        """Why the effect cannot be looked for in these readings; None if it can."""
        for axis in self.chain:
            if axis not in observations.session.description.machine.kinematics.linear:
                return f"the chain has no axis {axis}"
        if self.methods and observations.session.method not in self.methods:
            return f"does not occur with {observations.session.method.replace('_', ' ')}"
        instrument = observations.session.instrument
        if self.instruments and instrument is None:
            return f"the session does not say what read (instrument: {' or '.join(self.instruments)})"
        if self.instruments and instrument not in self.instruments:
            return f"does not occur with instrument {instrument}"
        for name in self.needs:
            values = observations.readings.columns.get(name)
            if values is None and name in observations.readings.labels:
                return f"the column {name} holds texts, and no numbers"
            if values is None:
                axis = name.rpartition("_")[2].upper()
                if axis in ("X", "Y", "Z") and axis not in observations.session.description.machine.kinematics.linear:
                    return f"the chain has no axis {axis}"
                return unrecorded(name)
            if not np.isfinite(values).all():
                return with_gaps(name)
        if self.moves and stands_still(observations, self.moves.lower()):
            return f"{self.moves} did not move"
        return None

    def coefficients_for(self, observations: Observations, shape: tuple[float, ...] = ()) -> tuple[Coefficient, ...]:
        """The coefficients; effects with one set a setup, or as many as their shape says, say here how many."""
        return self.coefficients

    def meanings(self, observations: Observations) -> dict[str, str]:
        """What each coefficient is, by the name under which it is published."""
        linear = {c.name: c.meaning for c in self.coefficients_for(observations)}
        named = linear | {s.name: s.meaning for s in self.shapes}
        return {f"{self.id}.{name}": meaning for name, meaning in named.items()}

    def shape_grid(self, observations: Observations) -> list[tuple[float, ...]]:
        """Values of the nonlinear coefficients from which a search starts; one empty tuple without any."""
        return [()]

    def equally(self, observations: Observations, shape: tuple[float, ...]) -> int:
        """How many values of the nonlinear coefficients are as probable as these; 0: those of the grid alone."""
        return 0

    @abstractmethod
    def columns(self, observations: Observations, shape: tuple[float, ...] = ()) -> Array:
        """(k, n) change of each reading per unit of each coefficient, at given nonlinear coefficients."""


def unrecorded(column: str) -> str:
    """Why an effect that needs a column is not looked for in a session without it."""
    return f"the column {column} was not recorded"


def with_gaps(column: str) -> str:
    """Why it is not looked for in one whose sensor missed too much."""
    return f"the column {column} has missing values"


class AxisEffect(Effect):
    """An effect that every axis can have: in its texts `{axis}` is the letter of one, `{AXIS}` its capital."""

    axis: str  # x, y, z, a, b or c
    name: str  # the axis, or the error of it (EYX, C0Y) that the effect changes: `{name}` in the texts

    def __init__(self, name: str) -> None:
        """That of one axis, or of one of its errors."""
        self.name, self.axis = name, name[-1].lower()
        for text in ("id", "title", "formula", "beside", "chain", "moves"):
            setattr(self, text, self._named(getattr(self, text)))
        for texts in ("needs", "covariates", "contains"):
            setattr(self, texts, tuple(map(self._named, getattr(self, texts))))

    @property
    def _names(self) -> dict[str, str]:
        return {"axis": self.axis, "AXIS": self.axis.upper(), "name": self.name}

    def _named(self, text: str) -> str:
        return text.of(**self._names) if isinstance(text, Said) else text.format(**self._names)

    def along(self, observations: Observations) -> Array:
        """(n,) the part of the linear axis's direction that each reading senses."""
        return np.asarray(observations.direction @ axis_unit(self.axis))


def stands_still(observations: Observations, axis: str) -> bool:
    """Whether all readings are at one position of an axis."""
    return bool(np.ptp(observations.readings.column(axis)) < SAME_POSITION)


def axis_unit(axis: str) -> Array:
    """(3,) direction in which a linear axis moves the functional point."""
    return np.asarray(np.eye(3)["xyz".index(axis)])


def table_axis(observations: Observations) -> str:
    """Letter of the rotary axis that carries targets or workpiece."""
    return observations.session.description.machine.table_axis


def axis_direction(axis: str) -> Array:
    """(3,) direction of the rotary axis A (X), B (Y) or C (Z)."""
    return np.asarray(np.eye(3)["ABC".index(axis.upper())])
