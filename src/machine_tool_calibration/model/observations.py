# SPDX-License-Identifier: Apache-2.0
"""The readings as every term sees them, whatever the instrument."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from machine_tool_calibration.arrays import Array, BoolArray, IntArray, groups, in_order_of_appearance
from machine_tool_calibration.estimation.sensor_noise import without_noise
from machine_tool_calibration.model.rounding import by_rounding
from machine_tool_calibration.session.session import Readings, Session, joined

ACROSS = 0.1
"""Cosine between the directions of two readings of a place below which the one says nothing of the other."""

# Share of an axis's travel that readings cover at least where functions are scaled on the travel. With half of it, the
# tables of a tracking interferometer beside a polynomial were ten times as uncertain as with all of it; with this
# share, 1 %.
_COVERED_SHARE = 0.8
SAME_DIRECTION = 1e-6
"""Range of a direction's component below which it is the same for all readings, and its size if it is not sensed."""
SAME_POSITION = 1e-6
"""Positions of an axis that differ by less are one: it has not moved, m."""


@dataclass(frozen=True)
class Observations:
    """Readings with the direction in which each senses the functional point."""

    session: Session  # where they come from
    readings: Readings  # those that take part; none is missing
    position: Array  # (n, 3) nominal functional point, machine frame, m
    direction: Array  # (n, 3) g: an error e of the functional point's position changes the reading by g.e
    # (n, 3) the same for a displacement of the workpiece or rotary table: the outward normal for a probe, the direction
    # to a target on the table; 0 where the table does not matter
    table_direction: Array
    path: Array  # (n,) nominal optical path from the instrument to the functional point, m; 0 for a probe
    run: IntArray  # (n,) index of the run: readings that count from the same datum reading
    # (n, 3) r: a rotation E of the tool against the workpiece changes the reading by r.E beside the displacement that
    # it gives the functional point (a flat mirror turns); None where it does not
    rotation_direction: Array | None = None
    # by axis (x, y, z) the lowest and highest position that the sessions of a joint fit have read, m; None where this
    # session is fitted by itself
    covered: Mapping[str, tuple[float, float]] | None = None
    # (k, n) what curves between the nodes of the tables of a joint fit do to the readings, of a size of about 1; None
    # where all were taken at nodes
    curves: Array | None = None
    # rotations (EAX … ECZ) with the lever arm that the chain gives: which the sessions of a joint fit sense, and which
    # the session's model names, whether they move the tool point or not
    rigid: frozenset[str] = frozenset()

    def __len__(self) -> int:
        return len(self.readings)

    @cached_property
    def declared_sigma(self) -> Array:
        """(n,) declared standard uncertainty of each reading, m."""
        session, readings = self.session, self.readings
        declared = session.description.standard_uncertainty
        own = [declared.setups.get(name, declared) for name in session.setup_ids]
        constant, slope = np.array([u.displacement for u in own]), np.array([u.per_length for u in own])
        return np.asarray(constant[readings.setup] + slope[readings.setup] * np.abs(self.path))

    @property
    def timed(self) -> bool:
        """Whether the readings' times were recorded."""
        time = self.readings.columns.get("time")
        return time is not None and bool(np.isfinite(time).all()) and float(np.ptp(time)) > 0.0

    @property
    def clock(self) -> Array:
        """(n,) time of each reading, s; where none was recorded its number, as if they came at equal intervals."""
        return self.readings.columns["time"] if self.timed else self.readings.row.astype(float)

    def temperature(self, name: str) -> Array:
        """(n,) temperature of a part of the structure by the column of this name, degrees, without its sensor's noise.

        A SessionError if it was not recorded.
        """
        if name not in self._temperatures:
            value = self.readings.column(name)
            self._temperatures[name] = without_noise(self.clock, value) if self.timed else value
        return self._temperatures[name]

    @cached_property
    def _temperatures(self) -> dict[str, Array]:
        return {}

    @cached_property
    def neighbours(self) -> tuple[IntArray, IntArray]:
        """(k,) readings that came right before another of their setup, and (k,) these."""
        # An x and a y that are read by turns come from an instrument each.
        directions = groups(*np.round(self.direction.T * 1e6))
        by_turns = directions.max(initial=0) < len(self.direction.T)
        setup = groups(self.readings.setup, directions) if by_turns else self.readings.setup
        order = np.lexsort((self.readings.row, self.clock, setup))
        same = np.diff(setup[order]) == 0
        return order[:-1][same], order[1:][same]

    @property
    def place(self) -> IntArray:
        """(n,) number shared by readings that repeat each other (`Readings.alike`)."""
        return self.readings.alike()

    @cached_property
    def rounding(self) -> Array:
        """(n,) standard uncertainty of each reading by its last digit, m; 0 where it has none."""
        readings = self.readings
        spot = readings.alike(approach=False)
        return by_rounding(readings.displacement, self.path, readings.setup, spot, self.place)

    @property
    def moved(self) -> BoolArray:
        """(3,) along which of x, y and z more than one position was read."""
        return np.asarray(np.ptp(self.position, axis=0) > SAME_POSITION)

    @property
    def read_along(self) -> Array:
        """(d, n) components of the sensed direction along each axis along which something was read."""
        return np.asarray(self.direction.T[np.abs(self.direction).max(axis=0, initial=0.0) > SAME_DIRECTION])

    @property
    def moves(self) -> bool:
        """Whether more than one position was read."""
        return bool(self.moved.any())

    def span(self, axis: str) -> tuple[float, float]:
        """Lowest and highest position of a linear axis on which functions of its position are scaled, m.

        The machine's declared travel, so that a function's coefficients mean the same in every session. Where it is
        not declared, a reading lies outside of it, or the readings reach over less than most of it (polynomials over
        a part of their range are nearly one), what the sessions that are fitted together have read.
        """
        here = self.readings.column(axis)
        low, high = (self.covered or {}).get(axis, (float(here.min()), float(here.max())))
        first, last = self.session.description.machine.travel.get(axis, (low, high))
        covered = first <= low and high <= last and high - low >= _COVERED_SHARE * (last - first)
        return (first, last) if covered else (low, high)

    def sense(self, field: Array) -> Array:
        """(k, n) change of the readings by a displacement (k, n, 3) of the functional point per unit of k unknowns."""
        return np.asarray(np.einsum("knj,nj->kn", field, self.direction))


def azimuth(direction: Array) -> Array:
    """(n,) of directions (n, 3) in the machine frame, rad."""
    return np.asarray(np.arctan2(direction[:, 1], direction[:, 0]))


def neighbours_of(observed: Sequence[Observations]) -> IntArray:
    """(2, k) the `neighbours` of sessions whose readings are below each other."""
    first = np.cumsum([0, *map(len, observed)])
    return np.concatenate([np.array(o.neighbours) + at for o, at in zip(observed, first, strict=False)], axis=1)


def together(observed: Sequence[Observations]) -> Observations:
    """Readings of several sessions of a machine as if of one: what they determine, and how far they reach.

    The description is the first session's; columns and labels that a session lacks are left out, as is the turning of
    a mirror.
    """
    names = ("position", "direction", "table_direction", "path", "run")
    arrays: dict[str, Any] = {name: np.concatenate([getattr(o, name) for o in observed]) for name in names}
    arrays |= {"rotation_direction": None, "curves": None}
    return replace(observed[0], readings=joined([o.readings for o in observed]), **arrays)


def first_states(position: Array, fields: Array) -> tuple[IntArray, IntArray]:
    """The states of the readings: what differs in position (n, 3), or there in displacements (k, n, 3).

    The first reading of each, and the number (n,) of the state of every reading among these.
    """
    key = np.concatenate([np.round(position * 1e9), fields.transpose(1, 0, 2).reshape(len(position), -1)], axis=1)
    state = in_order_of_appearance(np.unique(key, axis=0, return_inverse=True)[1].reshape(-1))
    return np.unique(state, return_index=True)[1], state
