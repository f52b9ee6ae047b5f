# SPDX-License-Identifier: Apache-2.0
"""The readings of a tracking interferometer as a part of a least-squares problem.

Unknown are every target's position, every station's rotation centre and its dead path (Ibaraki et al. 2014,
Eqs. (2)-(4)). Directions are calculated chunk by chunk, so that memory holds little more than the readings.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from machine_tool_calibration.arrays import Array, IntArray
from machine_tool_calibration.estimation.elimination import Rows
from machine_tool_calibration.estimation.problem import Group, Part

__all__ = ["MultilaterationPart"]


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

        Args:
            groups: from `group_points`, blocks are stations.
            path: (n,) reading plus first estimate of the station's dead path, m.
            sigma: (n,) standard uncertainty of a reading, m.
            target: (d, n_points) nominal positions, m.
            station: (d, stations) first estimates of the rotation centres, m.
            beam: (d, n) unit vectors of the commanded directions; None where the beam follows the target.
            dense: (K, n) columns of further unknowns.
            block_index: (stations, d + 1) place in the shared vector.
            dense_index: (K,) place in the shared vector.
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
            np.sqrt(length, out=length)
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
