"""The eleven conditions of the probing self-calibration, Eqs. (16)(17), with the places where each may be put."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.errors import ModelError
from machine_tool_calibration.machine.table import interpolation
from machine_tool_calibration.machine.tables import MachineTable
from machine_tool_calibration.methods.probing_datum import Condition, Place
from machine_tool_calibration.session.description import KnownLength

__all__ = ["LENGTH", "conditions", "known_weights"]

LENGTH = "absolute length"


def conditions(
    tables: Sequence[MachineTable], setup_ids: Sequence[str], known: Mapping[str, KnownLength]
) -> list[Condition]:
    """The conditions in the paper's order.

    Zero of every table at its axis's zero and of EXC, EYC, ECC at the first index, Eq. (16); straightness zero at the
    last node too, which makes the line through both the direction of the axis, and the measured length, Eq. (17).

    Args:
        tables: of the linear axes.
        setup_ids: the C indices.
        known: measured lengths, by the positioning error's name.

    Raises:
        ModelError: a measured length is not a positioning error of X or Y.
    """
    by_name = {table.name: table for table in tables}
    for name in known:
        if name not in ("EXX", "EYY"):
            raise ModelError(f"known: {name!r} is not the positioning error of a probing axis; EXX and EYY are")
    out = [_zero(table) for table in tables if not table.is_squareness]
    out += [
        Condition(tuple(Place({f"{name}({s})": 1.0}, 0.0, f"{name}({s}) = 0") for s in setup_ids))
        for name in ("EXC", "EYC", "ECC")
    ]
    out += [_direction(table) for table in tables if table.is_straightness]
    return [*out, _length(by_name, known)]


def known_weights(table: MachineTable, position: float) -> dict[str, float]:
    """A positioning error at a position, counted from the axis's zero, as a weighted sum of the table's unknowns."""
    weights = interpolation(table.nodes, np.array([position]))[:, 0]
    if _within(table.nodes, 0.0):
        weights = weights - interpolation(table.nodes, np.zeros(1))[:, 0]
    return _named(table, weights)


def _zero(table: MachineTable) -> Condition:
    places = []
    if _within(table.nodes, 0.0):
        weights = interpolation(table.nodes, np.zeros(1))[:, 0]
        places.append(Place(_named(table, weights), 0.0, f"{table.name}(0) = 0"))
    nearest = np.argsort(np.abs(table.nodes), kind="stable")
    places += [Place({table.labels[k]: 1.0}, 0.0, f"{table.labels[k]} = 0") for k in nearest]
    return Condition(tuple(places))


def _direction(table: MachineTable) -> Condition:
    places = tuple(Place({table.labels[k]: 1.0}, 0.0, f"{table.labels[k]} = 0") for k in _from_outside(table.nodes))
    return Condition(places, is_far=True)


def _length(by_name: Mapping[str, MachineTable], known: Mapping[str, KnownLength]) -> Condition:
    """The measured length; where no touch reaches it, the straight line from the axis's zero to it."""
    places = [
        Place(known_weights(by_name[n], e.position), e.value, f"{n}({e.position:.6g}) as measured", is_measured=True)
        for n, e in known.items()
    ]
    name = next(iter(known), "EXX")
    table, entry = by_name[name], known.get(name)
    slope = entry.value / entry.position if entry is not None and entry.position else 0.0
    for k in _from_outside(table.nodes):
        words = f"{table.labels[k]} = 0"
        if entry is not None:
            words = f"{table.labels[k]} on the line from 0 to the measured {name}({entry.position:.6g})"
        places.append(Place(known_weights(table, float(table.nodes[k])), slope * float(table.nodes[k]), words))
    return Condition(tuple(places), is_far=True)


def _from_outside(nodes: Array) -> list[int]:
    """Nodes from the outermost on the positive side inwards, then from the outermost on the negative side."""
    positive = [k for k in range(len(nodes) - 1, -1, -1) if nodes[k] > 1e-12]
    return positive + [k for k in range(len(nodes)) if nodes[k] < -1e-12]


def _within(nodes: Array, value: float) -> bool:
    return bool(nodes[0] <= value <= nodes[-1])


def _named(table: MachineTable, weights: Array) -> dict[str, float]:
    return {label: float(w) for label, w in zip(table.labels, weights, strict=True) if abs(w) > 1e-12}
