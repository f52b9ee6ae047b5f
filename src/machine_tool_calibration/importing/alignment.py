# SPDX-License-Identifier: Apache-2.0
"""Readings by which a pointer is aligned: a table with the columns of `observations.csv`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from machine_tool_calibration.arrays import Array, IntArray, groups
from machine_tool_calibration.errors import SessionError
from machine_tool_calibration.importing.text_table import FileForm, read_text_table

__all__ = ["Alignment", "read_alignment"]

# Positions and angles that are one: m and rad.
_STILL = 1e-7


@dataclass(frozen=True)
class Alignment:
    """A search for the rotation centre or the zero angle.

    Attributes:
        azimuth: (n,) commanded, rad.
        displacement: (n,) m.
        place: (n, 2) commanded x and y of the retroreflector, m.
        run: (n,) number of the run.
    """

    azimuth: Array
    displacement: Array
    place: Array
    run: IntArray

    @property
    def turns(self) -> bool:
        """Whether the beam turns, about the centre that is looked for; else Y moves."""
        return bool(np.ptp(self.azimuth) > _STILL)


def read_alignment(path: Path) -> Alignment:
    """Read a search.

    Args:
        path: a CSV file in SI units with the columns `azimuth`, `displacement`, `x`, `y`, and `repeat` where there are
            several runs; or the folder that holds it as `observations.csv`.

    Raises:
        SessionError: it cannot be read, lacks a column, is of several stations, or both or neither of beam and
            retroreflector move.
    """
    file = path / "observations.csv" if path.is_dir() else path
    table = read_text_table(file, FileForm())
    azimuth, displacement, x, y = (table.numbers(name, name) for name in ("azimuth", "displacement", "x", "y"))
    setups = np.unique(table.text("setup", "setup")) if "setup" in table.names else ()
    if len(setups) > 1:
        raise SessionError(f"{file}: {len(setups)} setups; each station has a centre of its own: one file for each")
    repeat = table.text("repeat", "repeat") if "repeat" in table.names else np.zeros(len(x), dtype=np.int64)
    good = np.isfinite(displacement)
    place = np.column_stack([x, y])
    if not good.any() or not (np.isfinite(azimuth) & np.isfinite(place).all(axis=1)).all():
        raise SessionError(f"{file}: no readings, or an azimuth, x or y that is missing")
    found = Alignment(azimuth[good], displacement[good], place[good], groups(repeat[good]))
    moves = bool(np.ptp(found.place, axis=0).max() > _STILL)
    if found.turns == moves:
        both = "the beam turns and the retroreflector moves" if moves else "neither beam nor retroreflector moves"
        raise SessionError(
            f"{file}: {both}; for the centre the beam turns and x and y stay, for the zero angle y alone moves"
        )
    if moves and np.ptp(found.place[:, 0]) > _STILL:
        raise SessionError(f"{file}: x moves; for the zero angle y alone moves")
    return found
