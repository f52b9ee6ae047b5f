"""Columns by name to readings, whatever they came from."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import PurePath

import numpy as np

from machine_tool_calibration.arrays import Array, IntArray
from machine_tool_calibration.errors import SessionError
from machine_tool_calibration.session.description import Description
from machine_tool_calibration.session.place import Place
from machine_tool_calibration.session.session import Readings

__all__ = ["assemble"]


def assemble(
    description: Description, numbers: Mapping[str, Array], labels: Mapping[str, np.ndarray], place: Place
) -> Readings:
    """The readings from their columns.

    Args:
        description: gives the setups, targets and points that the labels name.
        numbers: numeric columns, each (n,), `displacement` among them.
        labels: text columns, each (n,), `setup` among them.
        place: how messages name a row.

    Raises:
        SessionError: an unknown setup, target or point, or a repeat that is no whole number; with its row.
    """
    columns, texts = dict(numbers), dict(labels)
    setup = _places(texts.pop("setup"), "setup", [entry.id for entry in description.setups], place)
    for column, key in (("target", "targets"), ("point", "workpiece")):
        entries = getattr(description, key, None)
        if entries is not None and column in texts:
            _places(texts[column], column, [entry.id for entry in entries], place)
    count = len(setup)
    repeat = columns.pop("repeat", np.zeros(count))
    bad = np.flatnonzero(~((repeat >= 0) & (repeat == np.floor(repeat)) & (repeat < 1e9)))
    if len(bad):
        raise SessionError(f"{place.row(bad[0])}: repeat is {repeat[bad[0]]:g}, not 0, 1, 2 …")
    return Readings(
        setup=setup,
        repeat=repeat.astype(np.int64),
        displacement=columns.pop("displacement"),
        columns=columns,
        labels=texts,
        row=np.arange(count, dtype=np.int64),
    )


def _places(labels: np.ndarray, column: str, ids: Sequence[str], place: Place) -> IntArray:
    """Place of each label in the description's list."""
    table = {name: index for index, name in enumerate(ids)}
    unique, inverse = np.unique(labels, return_inverse=True)
    index = np.array([table.get(str(name), -1) for name in unique], dtype=np.int64)[inverse]
    bad = np.flatnonzero(index < 0)
    if len(bad):
        name = str(labels[bad[0]])
        what = f"unknown {column} {name!r}" if name else f"{column} is empty"
        raise SessionError(f"{place.row(bad[0])}: {what}; {PurePath(place.description).name} has {_listed(ids)}")
    return index


def _listed(ids: Sequence[str]) -> str:
    if len(ids) > 8 and all(name.isdigit() for name in ids):
        return f"{ids[0]} to {ids[-1]}"
    return ", ".join(ids[:8]) + (f" … ({len(ids)} in all)" if len(ids) > 8 else "")
