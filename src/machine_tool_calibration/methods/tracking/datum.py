# SPDX-License-Identifier: Apache-2.0
"""Readings between stations and targets as a part of a least-squares problem, and what they cannot fix.

That is a shift and a turn of the whole network. Unknown are every target's position, every station's rotation centre
and its dead path (Ibaraki et al. 2014, Eqs. (2)-(4)). Directions are calculated chunk by chunk, so that memory holds
little more than the readings.
"""

from collections.abc import Sequence

import numpy as np

from machine_tool_calibration.arrays import Array, BoolArray, IntArray, rigid_motions
from machine_tool_calibration.estimation.elimination import Rows
from machine_tool_calibration.estimation.problem import Group, Part
from machine_tool_calibration.words import say

MAP_DATUM = say("datum.map")

# Length of nothing, m: what is divided by it is no number of its own.
_NO_LENGTH = 1e-150


class NetworkMotion:
    """Common motions of targets and stations: shifts along and turns about the axes, about the targets' centre."""

    def __init__(self, targets: Array) -> None:
        """Take centre and size from the targets (n, d)."""
        self._centre = targets.mean(axis=0)
        self._size = float(np.abs(targets - self._centre).max()) or 1.0
        self._motions = [0, 1, 5] if targets.shape[1] == 2 else list(range(6))
        self.count = len(self._motions)

    def at(self, position: Array) -> Array:
        """(d, t, n) displacement of places (d, n) by a unit of each motion; a turn moves the farthest target by 1."""
        d, arm = len(position), (position - self._centre[:, None]) / self._size
        moved = rigid_motions(np.pad(arm, ((0, 3 - d), (0, 0))).T)
        return np.ascontiguousarray(moved[:, :d, self._motions].transpose(1, 2, 0))

    def of_stations(self, stations: Array) -> Array:
        """(S (d + 1), t) change of the stations' unknowns: rotation centre (S, d) and dead path."""
        moved = self.at(stations.T).transpose(2, 0, 1)
        return np.pad(moved, ((0, 0), (0, 1), (0, 0))).reshape(-1, self.count)


def carried_stations(point: IntArray, station: IntArray, n_points: int, n_stations: int, dimension: int) -> BoolArray:
    """(S,) stations that the network carries, so that the datum may rest on them; all that were read if none.

    A target (`point`, of N) read from more than d stations (`station`, of S) says something of these; a station
    read on more than d such targets is held by them. What hangs on fewer could take up a condition of the datum
    without any reading changing.
    """
    seen = np.zeros((n_points, n_stations), dtype=bool)
    seen[point, station] = True
    carried: BoolArray = np.asarray(seen.any(axis=0))
    read = carried
    while carried.any():
        strong = seen[:, carried].sum(axis=1) > dimension
        still = carried & (seen[strong].sum(axis=0) > dimension)
        if (still == carried).all():
            return carried
        carried = still
    return read


class OwnSight:
    """How well a station's own readings place it, all targets being known.

    A station in the plane of all targets, for instance, may move out of it without any reading changing. Such a motion
    must not count in the datum, where it would make up for any turn of the network; and only the declared position says
    where it is.
    """

    def __init__(self, direction: Array, station: IntArray, n_stations: int) -> None:
        """Look along the unit vectors (n, d) from the station (n,) of each reading to its target."""
        size = direction.shape[1] + 1
        self._values = np.zeros((n_stations, size))
        self._vectors = np.tile(np.eye(size), (n_stations, 1, 1))
        for k in range(n_stations):
            own = direction[station == k]
            if not len(own):
                continue
            columns = np.column_stack([own, np.ones(len(own))])
            self._values[k], self._vectors[k] = np.linalg.eigh(columns.T @ columns)

    def projectors(self, sigma: float, limit: Array) -> Array:
        """(S, d + 1, d + 1) on the motions that readings of that uncertainty place better than the limits (S,)."""
        kept = self._vectors * self._placed(sigma, limit)[:, None]
        return np.asarray(kept @ kept.transpose(0, 2, 1))

    def unsensed(self, sigma: float, limit: Array) -> list[tuple[int, Array]]:
        """The other motions of stations that were read: station and unit vector of rotation centre and dead path."""
        placed, read = self._placed(sigma, limit), np.asarray(self._values.any(axis=1))
        return [(int(k), self._vectors[k, :, j]) for k, j in np.argwhere(~placed & read[:, None])]

    def _placed(self, sigma: float, limit: Array) -> BoolArray:
        return self._values * limit[:, None] ** 2 > sigma**2


class MultilaterationPart(Part):
    """Targets seen from stations; d dimensions; d + 1 unknowns a station: rotation centre and dead path.

    The unknowns are corrections of the nominal target, of the first estimate of the station, and of the path
    between these two at the datum reading.
    """

    def __init__(
        self,
        groups: Sequence[Group],
        path: Array,
        sigma: Array,
        target: Array,
        station: Array,
        beam: Array | None,
        dense: Array,
        block_index: IntArray,
        dense_index: IntArray,
    ) -> None:
        """Lay the readings out in slots.

        `groups` are from `group_points`, blocks are stations; `path` (n,) is the reading plus the first
        estimate of the dead path, m; `target` (d, n_points) and `station` (d, stations) are first estimates, m;
        `beam` (d, n) holds unit vectors of the commanded directions, None where the beam follows the target;
        `dense` (K, n) the columns of further unknowns.
        """
        self.groups = groups
        self.block_index = block_index
        self.dense_index = dense_index
        self.dimension, self.n_points = target.shape
        self.n_readings = len(path)
        self.linear = beam is not None
        self._target = target
        self._station = station
        weight = 1.0 / sigma
        self._weight = [np.where(group.rows >= 0, weight[group.rows], 0.0) for group in groups]
        self._path, self._dense = self._in_slots(path), self._in_slots(dense)
        self._beam = None if beam is None else self._in_slots(beam)

    def _in_slots(self, values: Array) -> list[Array]:
        """Values of the readings (…, n) by slot and point (…, S, n) of every group, times their weights."""
        out = []
        for group, weight in zip(self.groups, self._weight, strict=True):
            # A missing reading has the index -1 and the weight 0.
            out.append(np.take(values, group.rows, axis=-1, mode="wrap"))
            out[-1] *= weight
        return out

    def rows(self, group: int, chunk: slice, theta: Array, local: Array) -> Rows:
        """Linearise at the given positions."""
        d = self.dimension
        layout = self.groups[group]
        points = layout.pick(chunk)
        weight = self._weight[group][:, chunk]
        unknown = theta[self.block_index[layout.block]]
        station = self._station[:, layout.block] + unknown[:, :d].T
        where = self._target[:, points] + local[:, points]
        line = where[:, None] - station[:, :, None]
        path = self._path[group][:, chunk]
        if self._beam is None:
            length = np.einsum("dsn,dsn->sn", line, line)
            # A target that stands on another station is not read from there: its weight is 0.
            np.maximum(np.sqrt(length, out=length), _NO_LENGTH, out=length)
            columns = line
            columns *= weight / length
            residual = np.subtract(unknown[:, d, None], length, out=length)
            residual *= weight
            residual += path
        else:
            columns = self._beam[group][:, :, chunk]
            residual = unknown[:, d, None] * weight
            residual += path
            residual -= np.einsum("dsn,dsn->sn", line, columns)
        dense = self._dense[group][:, :, chunk]
        if len(self.dense_index):
            residual -= np.tensordot(theta[self.dense_index], dense, axes=1)
        block = np.empty((d + 1, *weight.shape))
        np.negative(columns, out=block[:d])
        np.negative(weight, out=block[d])
        return Rows(residual, columns, block, dense)
