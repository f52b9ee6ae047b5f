# SPDX-License-Identifier: Apache-2.0
"""A rotary table with targets, seen from stations: what was read where (Zhang et al. 2015, Eq. (7))."""

from dataclasses import dataclass

import numpy as np

from machine_tool_calibration.arrays import Array, IntArray
from machine_tool_calibration.session.description import RotaryAxis
from machine_tool_calibration.session.session import Readings, Session, places_among

COMPONENTS = "XYZABC"
# Commanded angles closer than this are one position of the axis: 2 arc seconds, more than an encoder's noise.
_SAME_ANGLE = 1e-5


@dataclass(frozen=True)
class TableReadings:
    """Displacements of a table's targets, and where they belong."""

    axis: str  # letter of the rotary axis, A, B or C
    readings: Readings  # those with a displacement
    nodes: Array  # (K,) distinct commanded angles in the session, rad, also those at which every reading is missing
    node: IntArray  # (n,) which of them each reading was taken at
    rotation: Array  # (n, 3, 3) nominal rotation of the table against c = 0
    node_rotation: Array  # (K, 3, 3) the same at the nodes
    target: IntArray  # (n,) index of the target
    run: IntArray  # (n,) index of the run: readings of one setup, repeat and target count from the same zero
    run_key: IntArray  # (runs, 3) setup, repeat and target of each run
    first: IntArray  # (runs,) index of each run's first reading

    @property
    def direction(self) -> Array:
        """(3,) unit vector of the axis."""
        return np.asarray(np.eye(3)["ABC".index(self.axis)])

    @property
    def motions(self) -> tuple[str, ...]:
        """Names of the six error motions: EXC EYC EZC EAC EBC ECC."""
        return tuple(f"E{component}{self.axis}" for component in COMPONENTS)

    def turned(self, target: Array) -> Array:
        """(n, 3) where each reading's target stands without error; target (T, 3) at c = 0, m."""
        return np.asarray(np.einsum("nij,nj->ni", self.rotation, target[self.target]))


def axis_rotation(axis: str, angle: Array) -> Array:
    """(n, 3, 3) right-handed rotations about the axis A (X), B (Y) or C (Z) by angles (n,), rad."""
    i = ("ABC".index(axis) + 1) % 3
    j = (i + 1) % 3
    out = np.tile(np.eye(3), (len(angle), 1, 1))
    cos, sin = np.cos(angle), np.sin(angle)
    out[:, i, i], out[:, j, j] = cos, cos
    out[:, i, j], out[:, j, i] = -sin, sin
    return out


def merged_nodes(angle: Array) -> tuple[Array, IntArray]:
    """(K,) increasing positions of an axis, nearly equal ones being their middle one, and (n,) each reading's."""
    order = np.argsort(angle, kind="stable")
    ordered = angle[order]
    place = np.cumsum(np.r_[0, np.diff(ordered) > _SAME_ANGLE])
    node = np.empty(len(angle), dtype=np.int64)
    node[order] = place
    # the median member keeps a commanded value as it was written
    first = np.flatnonzero(np.r_[True, np.diff(place) > 0])
    last = np.r_[first[1:], len(angle)]
    return ordered[(first + last - 1) // 2] + 0.0, node  # no negative zero


def stated_places(session: Session) -> tuple[Array, Array]:
    """(S, 3) stations and (T, 3) targets, the latter in the table's frame at zero, as they are stated, m."""
    description = session.description.as_a(RotaryAxis)
    return np.array([s.position for s in description.setups]), np.array([t.position for t in description.targets])


def table_readings(session: Session) -> TableReadings:
    """Sort the readings of a rotary axis's session."""
    description = session.description.as_a(RotaryAxis)
    column = description.machine.table_axis.lower()
    axis = column.upper()
    good = np.isfinite(session.readings.displacement)
    every = session.readings.column(column)
    known = np.isfinite(every)
    readings = session.readings.select(good & known)
    nodes, index = merged_nodes(every[known])
    target = places_among(readings.labels["target"], [target.id for target in description.targets])
    key = np.column_stack([readings.setup, readings.repeat, target])
    _, first, run = np.unique(key, axis=0, return_index=True, return_inverse=True)
    sign = session.rotation_sign
    return TableReadings(
        axis=axis,
        readings=readings,
        nodes=nodes,
        node=index[good[known]],
        rotation=axis_rotation(axis, sign * readings.columns[column]),
        node_rotation=axis_rotation(axis, sign * nodes),
        target=target,
        run=run.reshape(-1).astype(np.int64),
        run_key=key[first],
        first=first.astype(np.int64),
    )
