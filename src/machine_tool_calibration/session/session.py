"""A measurement in memory: its description and its readings."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from machine_tool_calibration.arrays import Array, BoolArray, IntArray
from machine_tool_calibration.errors import SessionError
from machine_tool_calibration.session.description import Description

__all__ = ["Readings", "Session"]

_INSTRUMENTS = {
    "step_diagonal": "laser_interferometer",
    "tracking_interferometer": "tracking_interferometer",
    "rotary_axis": "laser_tracker",
    "probing": "touch_probe",
}


@dataclass(frozen=True)
class Readings:
    """The captured readings, in the order of time; a missing displacement is NaN.

    Attributes:
        setup: (n,) index of the setup in the description.
        repeat: (n,) repetition of that setup, from 0.
        displacement: (n,) the reading, m.
        columns: every other numeric column by name, each (n,): time, x, y, z, c, dir_x, azimuth,
            temperature_air and covariates of the user's own. NaN where missing.
        labels: text columns by name, each (n,): target, point.
        row: (n,) number of the reading in the recording, from 0; survives a selection.
    """

    setup: IntArray
    repeat: IntArray
    displacement: Array
    columns: Mapping[str, Array]
    labels: Mapping[str, np.ndarray]
    row: IntArray

    def __len__(self) -> int:
        return len(self.displacement)

    def column(self, name: str) -> Array:
        """The column of that name.

        Raises:
            SessionError: the session does not have it.
        """
        if name not in self.columns:
            raise SessionError(f"observations.csv has no column {name!r}")
        return self.columns[name]

    def select(self, keep: BoolArray | IntArray) -> Readings:
        """The readings chosen by a mask or by indices."""
        return Readings(
            setup=self.setup[keep],
            repeat=self.repeat[keep],
            displacement=self.displacement[keep],
            columns={name: values[keep] for name, values in self.columns.items()},
            labels={name: values[keep] for name, values in self.labels.items()},
            row=self.row[keep],
        )

    def position(self) -> Array:
        """(n, 3) commanded x, y, z, m; an axis that the method does not move is 0."""
        zero = np.zeros(len(self))
        return np.column_stack([self.columns.get(axis, zero) for axis in "xyz"])


@dataclass(frozen=True)
class Session:
    """A whole measurement: what was set up, and what was read.

    Attributes:
        description: the content of `session.yaml`.
        readings: the content of `observations.csv`.
        source: where it came from, for messages.
    """

    description: Description
    readings: Readings
    source: str = "session"

    @property
    def method(self) -> str:
        """The measuring method's name."""
        return self.description.method

    @cached_property
    def setup_ids(self) -> tuple[str, ...]:
        """Ids of the setups, in the order of the description."""
        return tuple(setup.id for setup in self.description.setups)

    @property
    def sigma(self) -> float:
        """Declared standard uncertainty of one reading, m."""
        return self.description.standard_uncertainty.displacement

    @property
    def instrument(self) -> str | None:
        """What read; None for direct deviations whose session does not say it."""
        own = getattr(self.description, "instrument", None)
        return _INSTRUMENTS.get(self.method) if own is None else str(own)

    @property
    def rotation_sign(self) -> int:
        """+1 where C positive turns the workpiece counter-clockwise seen from +Z, -1 clockwise."""
        own = getattr(self.description, "rotation_sign", None)
        sign = own if own is not None else self.description.machine.rotation_sign
        if sign is None:
            return -1 if self.method == "probing" else 1
        return int(sign)

    def with_readings(self, readings: Readings) -> Session:
        """The same measurement with other readings."""
        return replace(self, readings=readings)
