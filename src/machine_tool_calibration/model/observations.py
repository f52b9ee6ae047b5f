"""The readings as every term sees them, whatever the instrument."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from machine_tool_calibration.arrays import Array, IntArray
from machine_tool_calibration.session.session import Readings, Session

__all__ = ["Observations"]


@dataclass(frozen=True)
class Observations:
    """Readings with the direction in which each senses the functional point.

    Attributes:
        session: where they come from.
        readings: those that take part; none is missing.
        position: (n, 3) nominal functional point, machine frame, m.
        direction: (n, 3) g: an error e of the functional point's position changes the reading by g.e.
        table_direction: (n, 3) the same for a displacement of the workpiece or rotary table: the outward normal for a
            probe, the direction to a target on the table; 0 where the table does not matter.
        path: (n,) nominal optical path from the instrument to the functional point, m; 0 for a probe.
        run: (n,) index of the run: readings that count from the same datum reading.
        rotation_direction: (n, 3) r: a rotation E of the tool against the workpiece changes the reading by r.E beside
            the displacement that it gives the functional point (a flat mirror turns); None where it does not.
    """

    session: Session
    readings: Readings
    position: Array
    direction: Array
    table_direction: Array
    path: Array
    run: IntArray
    rotation_direction: Array | None = None

    def __len__(self) -> int:
        return len(self.readings)

    def sense(self, field: Array) -> Array:
        """Columns of a position error.

        Args:
            field: (k, n, 3) displacement of the functional point per unit of each of k unknowns.

        Returns:
            (k, n) change of the readings.
        """
        return np.asarray(np.einsum("knj,nj->kn", field, self.direction))
