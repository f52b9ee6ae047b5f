# SPDX-License-Identifier: Apache-2.0
"""The package's own tables of readings as sessions again, also as a spreadsheet leaves them, or to align a pointer."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

from machine_tool_calibration.arrays import Array, IntArray, groups
from machine_tool_calibration.errors import SessionError
from machine_tool_calibration.importing.text_table import FileForm, read_text_table
from machine_tool_calibration.session.catalogue import require_columns
from machine_tool_calibration.session.collect import Collector
from machine_tool_calibration.session.description import Description, Place
from machine_tool_calibration.session.session import Session, assemble
from machine_tool_calibration.session.table import LABEL_COLUMNS, NUMERIC_COLUMNS

_OF_A_TOPIC = ("log_time", "publish_time", "stamp")
_OF_ANY_TOPIC = "frame_id"


def read_own_table(file: Path, description: Description, described: str, form: FileForm) -> Session:
    """A session from a table with the columns of `observations.csv`, or of a recording's topic `reading`; unchecked.

    CSV of a form, or Parquet where the file's name ends so; in SI units. `described` is the file that the
    description comes from. A SessionError says with file and line that it is no such table or does not belong to
    the description.
    """
    if file.suffix.lower() == ".parquet":
        numbers, labels, place = _parquet(file, described)
    else:
        numbers, labels, place = _text(file, described, form)
    if _OF_ANY_TOPIC not in labels or "setup" in labels:
        require_columns(description, [*numbers, *labels], str(file))
        return Session(description, assemble(description, numbers, labels, place), source=str(file))
    collector = Collector(description, place)
    names = [name for name in numbers if name not in _OF_A_TOPIC]
    for values in np.column_stack([numbers[name] for name in names]):
        collector.add(names, values)
    return collector.session(str(file), check=False)


_Columns = tuple[Mapping[str, Array], Mapping[str, np.ndarray], Place]


def _text(file: Path, described: str, form: FileForm) -> _Columns:
    table = read_text_table(file, form)
    numbers: dict[str, Array] = {}
    labels: dict[str, np.ndarray] = {}
    for name in table.names:
        if name not in (*LABEL_COLUMNS, _OF_ANY_TOPIC):
            try:
                numbers[name] = table.numbers(name, "a column of readings")
                continue
            except SessionError:
                if name in NUMERIC_COLUMNS:
                    raise
        labels[name] = table.text(name, "a column of readings")
    return numbers, labels, Place(described, str(file), lambda row: f"{file} row {row} (line {table.lines[row]})")


def _parquet(file: Path, described: str) -> _Columns:
    try:
        frame = pd.read_parquet(file)
    except ImportError:
        raise SessionError(f"{file}: Parquet needs the package pyarrow (pip install pyarrow)") from None
    except (OSError, ValueError) as error:
        raise SessionError(f"{file}: cannot be read as Parquet: {str(error).splitlines()[0]}") from None
    numbers, labels = {}, {}
    for name, values in frame.items():
        if values.dtype.kind in "fiub" and name not in LABEL_COLUMNS:
            numbers[str(name)] = values.to_numpy(dtype=np.float64)
        else:
            labels[str(name)] = np.asarray(values.astype(object).where(values.notna(), "").astype(str), dtype=np.str_)
    return numbers, labels, Place(described, str(file))


_NO_MOTION = 1e-7  # positions and angles that are one: m and rad


@dataclass(frozen=True)
class Alignment:
    """A search for the rotation centre or the zero angle."""

    azimuth: Array  # (n,) commanded, rad
    displacement: Array  # (n,) m
    place: Array  # (n, 2) commanded x and y of the retroreflector, m
    run: IntArray  # (n,) number of the run

    @property
    def turns(self) -> bool:
        """Whether the beam turns, about the centre that is looked for; else Y moves."""
        return bool(np.ptp(self.azimuth) > _NO_MOTION)


def read_alignment(path: Path) -> Alignment:
    """Read a search: a CSV file in SI units, or the folder that holds it as `observations.csv`.

    Its columns are `azimuth`, `displacement`, `x`, `y`, and `repeat` where there are several runs. A SessionError
    says that it cannot be read, lacks a column, is of several stations, or both or neither of beam and
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
    moves = bool(np.ptp(found.place, axis=0).max() > _NO_MOTION)
    if found.turns == moves:
        both = "the beam turns and the retroreflector moves" if moves else "neither beam nor retroreflector moves"
        hint = "for the centre the beam turns and x and y stay, for the zero angle y alone moves"
        raise SessionError(f"{file}: {both}; {hint}")
    if moves and np.ptp(found.place[:, 0]) > _NO_MOTION:
        raise SessionError(f"{file}: x moves; for the zero angle y alone moves")
    return found
