# SPDX-License-Identifier: Apache-2.0
"""What effects do to a measurement, in terms of geometry; they add up."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields
from typing import Any

import numpy as np

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.simulation.motions import Table, rotate

__all__ = ["Disturbance", "Sight", "combine"]


@dataclass(frozen=True)
class Sight:
    """What the instrument looks at in each reading; what a method lacks is zero.

    Attributes:
        path: (n,) length from the instrument (rotation centre, or the mirror at the start of a run) to the
            target, m.
        direction: (n, 3) unit vector along which a displacement is sensed.
        azimuth: (n,) azimuth of that direction (of the commanded beam, for a pointer), rad.
        incidence: (n,) direction from which the beam meets the retroreflector, in the frame that carries
            it: an azimuth in the plane or on a table, an angle to the spindle's axis in space, rad.
        change: (n,) path minus that of the run's first reading, m.
    """

    path: Array
    direction: Array
    azimuth: Array
    incidence: Array
    change: Array


@dataclass(frozen=True)
class Disturbance:
    """Deviations from the ideal, each (n,) unless said otherwise; absent means none.

    Attributes:
        axis: carriage or table ahead of its command along its own motion, by axis letter, m or rad.
        point: (n, 3) shift of the functional point, m.
        station: (n, 3) shift of the station's rotation centre, m.
        turn: turn of the beam's azimuth, rad.
        optical: relative excess of the optical over the geometric path.
        dead: excess of the optical path outside the measured one, m.
        mirror: (n, 2) further tilt of the flat mirror's normal off the beam, towards its left and upwards, rad.
        growth: relative growth of the workpiece about the table's centre.
        table_radial: relative growth of the table's targets away from the axis.
        table_axial: relative growth along the axis.
        reading: added to the reading as a function of what the instrument looks at.
        tables: further error motions of the machine.
        errors: further error motions of an axis at each reading, whatever its position, by axis letter: (n, 6) EX, EY,
            EZ (m) and EA, EB, EC (rad).
        table_shift: (n, 3) shift of the rotary table's axis, m.
        table_tilt: (n, 3) small rotation of it about the machine's zero, rad.
        squareness: further squareness, rad.
    """

    axis: Mapping[str, Array] = field(default_factory=dict)
    point: Array | None = None
    station: Array | None = None
    turn: Array | None = None
    optical: Array | None = None
    dead: Array | None = None
    mirror: Array | None = None
    growth: Array | None = None
    table_radial: Array | None = None
    table_axial: Array | None = None
    reading: tuple[Callable[[Sight], Array], ...] = ()
    tables: tuple[tuple[str, Table], ...] = ()
    squareness: Mapping[str, float] = field(default_factory=dict)
    errors: Mapping[str, Array] = field(default_factory=dict)
    table_shift: Array | None = None
    table_tilt: Array | None = None

    def grown(self, points: Array, axis: str) -> Array:
        """Where points (n, 3) of the table are in its own frame when it, or the part on it, has grown, m."""
        axial = np.eye(3)["ABC".index(axis)]
        place = points
        for growth, part in (
            (self.growth, np.ones(3)), (self.table_radial, 1.0 - axial), (self.table_axial, axial),
        ):
            if growth is not None:
                place = place + growth[:, None] * points * part
        return place

    def with_table(self, place: Array) -> Array:
        """Where points (n, 3) that the table carries are when its axis has moved, m."""
        turned = place if self.table_tilt is None else rotate(place, self.table_tilt)
        return turned if self.table_shift is None else turned + self.table_shift

    def added(self, sight: Sight) -> Array:
        """(n,) the sum of what is added to the reading, m: excess of the optical path and the rest."""
        total = np.zeros(len(sight.path))
        if self.optical is not None:
            total = total + self.optical * sight.path
        if self.dead is not None:
            total = total + self.dead
        for function in self.reading:
            total = total + function(sight)
        return total


def combine(parts: tuple[Disturbance, ...]) -> Disturbance:
    """The sum of several disturbances."""
    total: dict[str, Any] = {}
    for part in parts:
        for entry in fields(part):
            value, old = getattr(part, entry.name), total.get(entry.name)
            if value is None:
                continue
            if old is None:
                total[entry.name] = value
            elif isinstance(value, Mapping):
                merged = dict(old)
                for key, item in value.items():
                    merged[key] = merged[key] + item if key in merged else item
                total[entry.name] = merged
            else:
                total[entry.name] = old + value
    return Disturbance(**total)
