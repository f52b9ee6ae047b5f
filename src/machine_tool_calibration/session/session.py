# SPDX-License-Identifier: Apache-2.0
"""A measurement in memory: its description and its readings."""

from __future__ import annotations

import itertools
import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path, PurePath
from typing import TYPE_CHECKING, Self

import numpy as np

from machine_tool_calibration.arrays import (
    Array,
    BoolArray,
    IntArray,
    first_true,
    groups,
    in_order_of_appearance,
    unsigned,
)
from machine_tool_calibration.errors import SessionError
from machine_tool_calibration.session.read_off import commanded

if TYPE_CHECKING:
    from machine_tool_calibration.session.description import Description, Place

ENVIRONMENT_COLUMNS = (
    *("temperature_air", "temperature_x", "temperature_y", "temperature_z", "temperature_table", "temperature_work"),
    *("air_pressure", "relative_humidity"),
)
"""Columns of the environment: degrees Celsius, Pa, 0 … 1."""


@dataclass(frozen=True)
class Readings:
    """The captured readings, in the order of time; a missing displacement is NaN."""

    setup: IntArray  # (n,) index of the setup in the description
    repeat: IntArray  # (n,) repetition of that setup, from 0
    displacement: Array  # (n,) the reading, m
    # every other numeric column by name, each (n,): time, x, y, z, c, dir_x, azimuth, temperature_air and covariates
    # of the user's own. NaN where missing
    columns: Mapping[str, Array]
    labels: Mapping[str, np.ndarray]  # text columns by name, each (n,): target, point
    row: IntArray  # (n,) number of the reading in the recording, from 0; survives a selection
    # by axis (n,) how far positions that were read off are from the places that they are taken for, m or rad
    off_place: Mapping[str, Array] = field(default_factory=dict)

    def __len__(self) -> int:
        return len(self.displacement)

    @cached_property
    def repeat_of_setup(self) -> IntArray:
        """(n,) number shared by the readings of one repeat of one setup."""
        return groups(self.setup, self.repeat)

    @property
    def state(self) -> IntArray:
        """(n,) number shared by readings that are the same in all but the displacement, in what is missing too."""
        return groups(self.setup, self.repeat, *self.columns.values(), *self.labels.values())

    def alike(self, *, setup: bool = True, approach: bool = True, signed: bool = True) -> IntArray:
        """(n,) number shared by readings that repeat each other: same setup, place, target and direction of approach.

        Deviations of one place along x and along y do not repeat each other.

        Args:
            setup: whether those of two setups differ.
            approach: whether those differ that come from two sides.
            signed: whether those differ that sense opposite directions.
        """
        setups = self.setup if setup else np.zeros_like(self.setup)
        names = (*"xyzabc", *(f"dir_{axis}" for axis in "xyzabc" if approach))
        keys = [np.round(self.columns[name] * 1e9) for name in names if name in self.columns]
        senses = np.array([self.columns[name] for name in ("gx", "gy", "gz") if name in self.columns])
        if len(senses):
            keys += list(np.round((senses if signed else unsigned(senses.T).T) * 1e6))
        return groups(setups, *keys, *self.labels.values())

    def column(self, name: str) -> Array:
        """The column of that name; a SessionError if the session does not have it."""
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
            off_place={axis: off[keep] for axis, off in self.off_place.items()},
        )

    @property
    def recorded_columns(self) -> dict[str, Array]:
        """The columns with positions as they were read off."""
        return {**self.columns, **{axis: self.columns[axis] + off for axis, off in self.off_place.items()}}

    def at_places(self, direction: Array) -> Self:
        """What would be read at the places, along (n, 3) directions, where the axes stood beside them."""
        if not self.off_place:
            return self
        off = np.column_stack([self.off_place.get(axis, np.zeros(len(self))) for axis in "xyz"])
        return replace(self, displacement=self.displacement - np.sum(direction * off, axis=1), off_place={})

    def position(self) -> Array:
        """(n, 3) commanded x, y, z, m; an axis that the method does not move is 0."""
        zero = np.zeros(len(self))
        return np.column_stack([self.columns.get(axis, zero) for axis in "xyz"])


def joined(parts: Sequence[Readings]) -> Readings:
    """Readings one after the other, with the columns and labels that all of them have."""
    columns = [name for name in parts[0].columns if all(name in part.columns for part in parts)]
    labels = [name for name in parts[0].labels if all(name in part.labels for part in parts)]
    return Readings(
        setup=np.concatenate([part.setup for part in parts]),
        repeat=np.concatenate([part.repeat for part in parts]),
        displacement=np.concatenate([part.displacement for part in parts]),
        columns={name: np.concatenate([part.columns[name] for part in parts]) for name in columns},
        labels={name: np.concatenate([part.labels[name] for part in parts]) for name in labels},
        row=np.concatenate([part.row for part in parts]),
        off_place={
            axis: np.concatenate([part.off_place.get(axis, np.zeros(len(part))) for part in parts])
            for axis in dict.fromkeys(axis for part in parts for axis in part.off_place)
        },
    )


@dataclass(frozen=True)
class Session:
    """A whole measurement: what was set up, and what was read."""

    description: Description  # the content of `session.yaml`
    readings: Readings  # the content of `observations.csv`
    source: str = "session"  # where it came from, for messages
    # rows of readings that are known to be sound: none of them is set aside, however far it stands out
    sound: frozenset[int] = frozenset()
    earlier: tuple[int, ...] = ()  # readings of each run that a recording holds before it
    no_readings: tuple[str, ...] = ()  # where messages among them stand that are none, and why
    lost: int = 0  # readings that a recording lacks, by the numbers of those before its last one
    # the measurement before any reading was left out; None where none was
    recorded: Session | None = field(default=None, repr=False, compare=False)

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
        return self.description.reads if own is None else str(own)

    @property
    def rotation_sign(self) -> int:
        """+1 where C positive turns the workpiece counter-clockwise seen from +Z, -1 clockwise."""
        own = getattr(self.description, "rotation_sign", None)
        sign = own if own is not None else self.description.machine.rotation_sign
        return self.description.turns if sign is None else int(sign)

    @property
    def mounted_again(self) -> bool:
        """Whether a setup was measured, left, and measured again."""
        setup = self.readings.setup
        return int(np.count_nonzero(np.diff(setup))) >= len(np.unique(setup)) > 0

    def with_readings(self, readings: Readings) -> Session:
        """The same measurement with other readings."""
        return replace(self, readings=readings, recorded=None)

    @property
    def trusted(self) -> Session:
        """The same measurement, whose sizes, units and places are taken as they are."""
        return replace(self, description=self.description.model_copy(update={"trust_units": True}))

    def without(self, gone: BoolArray, *, as_lost: bool = False) -> Session:
        """The same measurement with readings (n,) left out, or as missing ones; `as_recorded` still has them."""
        readings = self.readings
        left = replace(readings, displacement=np.where(gone, np.nan, readings.displacement)) if as_lost else None
        return replace(self, readings=left or readings.select(~gone), recorded=self.as_recorded)

    @property
    def as_recorded(self) -> Session:
        """The measurement with all its readings."""
        return self.recorded or self

    def keeping(self, rows: Iterable[int]) -> Session:
        """The same measurement, with rows that are known to be sound; a SessionError if it has no such row."""
        rows = frozenset(rows)
        for row in sorted(rows.difference(self.readings.row.tolist())):
            raise SessionError(
                f"{self.source}: there is no row {row} to keep; rows are 0 to {self.readings.row.max(initial=0)}"
            )
        return replace(self, sound=self.sound | rows)


def measurement_name(path: str | os.PathLike[str]) -> str:
    """Name of a measurement: that of its folder, or of its recording without `.mcap`."""
    real = Path(os.path.realpath(path))  # not Path.resolve, which raises a RuntimeError for a link to itself
    return real.stem if real.suffix == ".mcap" else real.name


def distinct_labels(names: Sequence[str]) -> list[str]:
    """The names, numbered where they repeat."""
    return [f"{name}#{k + 1}" if names.count(name) > 1 else name for k, name in enumerate(names)]


ENOUGH_TO_DIFFER = 8
"""Readings of which as many hardly ever come out the same, however coarse the instrument's steps are."""


def refuse_repeated(sessions: Sequence[Session], labels: Sequence[str]) -> None:
    """Refuse (SessionError) a measurement that is given twice: its readings would count as independent ones."""
    named = zip(labels, (session.readings for session in sessions), strict=True)
    for (one, first), (other, second) in itertools.combinations(named, 2):
        both = first.columns.keys() & second.columns.keys()
        pairs = [(first.displacement, second.displacement), *((first.columns[n], second.columns[n]) for n in both)]
        if len(first) >= ENOUGH_TO_DIFFER and all(np.array_equal(a, b, equal_nan=True) for a, b in pairs):
            raise SessionError(f"{one} and {other} are the same readings; give each measurement once")


def distinct_places(position: Array) -> tuple[IntArray, IntArray]:
    """(k,) first reading at each of the k places of (n, d) positions, in order, and (n,) the place of each reading.

    Positions that are equal to the nanometre (angles to the nanoradian) are one place; d is at most 3.
    """
    keys = np.round(position * 1e9).astype(np.int64)
    place = in_order_of_appearance(groups(*keys.T))
    return np.unique(place, return_index=True)[1], place


# Times that begin later, s, count from an epoch: no session lasts twelve days before; and later than any has.
_SINCE_AN_EPOCH, _NO_TIME = 1e6, 1e12


def assemble(
    description: Description, numbers: Mapping[str, Array], labels: Mapping[str, np.ndarray], place: Place
) -> Readings:
    """The readings from their numeric columns and labels, each (n,), with `displacement` and `setup` among them.

    A SessionError names the row of an unknown setup, target or point, or of a repeat that is no whole number.
    """
    columns, texts = dict(numbers), dict(labels)
    setup = _known_places(texts.pop("setup"), "setup", [entry.id for entry in description.setups], place)
    for column, key in (("target", "targets"), ("point", "workpiece")):
        entries = getattr(description, key, None)
        if entries is not None and column in texts:
            _known_places(texts[column], column, [entry.id for entry in entries], place)
    count = len(setup)
    repeat = columns.pop("repeat", np.zeros(count))
    bad = first_true(~((repeat >= 0) & (repeat == np.floor(repeat)) & (repeat < 1e9)))
    if bad is not None:
        raise SessionError(f"{place.row(bad)}: repeat is {repeat[bad]:g}, not 0, 1, 2 …")
    time = columns.get("time", np.zeros(0))
    first = float(time[np.isfinite(time)].min(initial=np.inf))
    if _SINCE_AN_EPOCH < first < _NO_TIME:  # beside it what changes within a session would be lost in rounding
        columns["time"] = time - first
    read_off = {axis: columns[axis] for axis in "xyzabc" if axis in columns}
    columns |= commanded(read_off)
    off = {axis: np.nan_to_num(position - columns[axis]) for axis, position in read_off.items()}
    return Readings(
        setup=setup,
        repeat=repeat.astype(np.int64),
        displacement=columns.pop("displacement"),
        columns=columns,
        labels=texts,
        row=np.arange(count, dtype=np.int64),
        off_place={axis: beside for axis, beside in off.items() if beside.any()},
    )


def places_among(labels: np.ndarray, ids: Sequence[str]) -> IntArray:
    """(n,) place of each label in a list of ids; -1 where it is none of them."""
    table = {name: index for index, name in enumerate(ids)}
    unique, inverse = np.unique(labels, return_inverse=True)
    return np.array([table.get(str(name), -1) for name in unique], dtype=np.int64)[inverse]


def _known_places(labels: np.ndarray, column: str, ids: Sequence[str], place: Place) -> IntArray:
    index = places_among(labels, ids)
    if (bad := first_true(index < 0)) is not None:
        name = str(labels[bad])
        what = f"unknown {column} {name!r}" if name else f"{column} is empty"
        raise SessionError(f"{place.row(bad)}: {what}; {PurePath(place.description).name} has {_listed(ids)}")
    return index


def _listed(ids: Sequence[str]) -> str:
    if len(ids) > 8 and all(name.isdigit() for name in ids):
        return f"{ids[0]} to {ids[-1]}"
    return ", ".join(ids[:8]) + (f" … ({len(ids)} in all)" if len(ids) > 8 else "")
