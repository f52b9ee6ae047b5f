# SPDX-License-Identifier: Apache-2.0
"""Datum of the probing self-calibration: the paper's eleven conditions, Eqs. (16)(17), where the touches fix them."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from machine_tool_calibration.arrays import Array, BoolArray, IntArray
from machine_tool_calibration.errors import ModelError
from machine_tool_calibration.machine.error_motions import interpolation
from machine_tool_calibration.methods.probing.geometry import point_means
from machine_tool_calibration.model.model import weight_row
from machine_tool_calibration.model.rigid_body import MachineTable
from machine_tool_calibration.session.description import KnownLength
from machine_tool_calibration.words import say

# As the solver's: the smallest singular value of the scaled columns that still counts.
_LEAST_SINGULAR_VALUE = float(np.sqrt(1e-11))
# Share in an undetermined direction below which an unknown does not take part in it.
SHARE = 1e-6


@dataclass(frozen=True)
class NullSpace:
    """The null space of the touches, and the covariance outside of it.

    The unknowns are the K shared ones, each in the unit that changes the readings by 1 m (rms), and then the
    workpiece's N points, m.
    """

    names: tuple[str, ...]  # of the shared unknowns
    unit: Array  # (K,) of each shared unknown
    basis: Array  # (K + N, q) orthonormal directions
    # (K + N, K) what each unknown does when the shared ones change: a point follows the mean of its touches
    response: Array
    # (K, r) half @ half.T is the covariance of the shared unknowns, for touches of unit uncertainty, in the datum of
    # least norm
    half: Array
    own: Array  # (K + N,) variance that each unknown has besides: of a point, one over the number of its touches

    @cached_property
    def _index(self) -> dict[str, int]:
        return {name: k for k, name in enumerate(self.names)}

    def weights(self, weights: Mapping[str, float]) -> Array:
        """(K,) a weighted sum of shared unknowns, in their units; of unit length unless it is empty."""
        row = weight_row(self._index, weights, len(self.names)) * self.unit
        return row / (float(np.linalg.norm(row)) or 1.0)

    def free(self, rows: Array) -> Array:
        """(K + N, r) orthonormal directions that remain under the conditions (c, K)."""
        return np.asarray(self.basis @ _kernel(rows @ self.basis[: len(self.names)]))

    def determined(self, rows: Array) -> BoolArray:
        """(K + N,) which unknowns are determined under the conditions (c, K)."""
        return np.asarray(np.linalg.norm(self.free(rows), axis=1) < SHARE)

    def fixes(self, rows: Array, row: Array) -> bool:
        """Whether the conditions (c, K) determine a further sum of shared unknowns (K,)."""
        return bool(np.linalg.norm(row @ self.free(rows)[: len(row)]) < SHARE)

    def uncertainty(self, rows: Array) -> Array:
        """(K + N,) standard uncertainty under the conditions (c, K) for touches of unit uncertainty.

        It means something only for what they determine.
        """
        shared = self.basis[: len(self.names)]
        moved = self.half - shared @ (np.linalg.pinv(rows @ shared, rcond=SHARE) @ (rows @ self.half))
        return np.asarray(np.sqrt(self.own + np.sum((self.response @ moved) ** 2, axis=1)))


def _kernel(rows: Array) -> Array:
    """(q, r) orthonormal directions in which the rows (c, q) vanish."""
    if not len(rows):
        return np.eye(rows.shape[1])
    _, s, vt = np.linalg.svd(rows, full_matrices=True)
    return np.asarray(vt[int((s > SHARE).sum()) :].T)


def null_space(names: Sequence[str], dense: Array, point: IntArray, n_points: int) -> NullSpace:
    """The changes of K shared unknowns (columns (K, n)) and N points (touched: (n,)) that no touch notices."""
    k = len(dense)
    size = np.sqrt(np.mean(dense**2, axis=1))
    typical = float(size.max(initial=0.0)) or 1.0
    unit = 1.0 / np.where(size > 1e-12 * typical, size, typical)
    columns = dense * unit[:, None]
    mean, count = point_means(columns, point, np.ones(len(point)), n_points)
    # The point's own unknown takes up the mean of its touches: what is left are the differences between C angles.
    rest = np.linalg.qr((columns - mean[point].T).T, mode="r")
    _, values, vectors = np.linalg.svd(rest, full_matrices=True)
    rank = int((values > _LEAST_SINGULAR_VALUE * values.max(initial=1e-300)).sum())
    response = np.concatenate([np.eye(k), -mean])
    untouched = np.flatnonzero(count == 0)
    alone = np.zeros((k + n_points, len(untouched)))
    alone[k + untouched, np.arange(len(untouched))] = 1.0
    basis = np.linalg.qr(np.concatenate([response @ vectors[rank:].T, alone], axis=1))[0]
    own = np.concatenate([np.zeros(k), 1.0 / np.maximum(count, 1)])
    return NullSpace(tuple(names), unit, basis, response, vectors[:rank].T / values[:rank], own)


_SWEEPS = 4
# A direction is counted from the outermost place at which what it fixes is at most so much less certain than at the
# best place: a node that is hardly reached would pass its uncertainty on to everything.
_WORSE = 3.0


@dataclass(frozen=True)
class Place:
    """Where a condition may be put: the weighted sum of unknowns that gets a value."""

    weights: Mapping[str, float]  # by the unknown's name
    value: float  # of the sum, m or rad
    words: str  # for the datum's description, such as `EYX(0.11) = 0`
    is_measured: bool = False  # whether the value is a measurement, so that it is not to be moved for convenience


@dataclass(frozen=True)
class Condition:
    """One condition of the datum."""

    places: tuple[Place, ...]  # where it may be put, in the order of preference
    is_far: bool = False  # whether it belongs far from the axis's zero, as those for a direction or the length


def choose_places(null: NullSpace, conditions: Sequence[Condition]) -> list[Place | None]:
    """Where each condition is put: as in the paper, unless another place leaves fewer unknowns undetermined.

    A condition that fixes nothing but the unknown on which it sits says nothing of the machine and is left out (None):
    with a disc on the table ECC has no effect at all, and zero at the first index would be no knowledge.
    """
    search = _Search(null, conditions)
    choice = search.steadier(search.best())
    return [None if search.is_idle(choice, i) else c.places[choice[i]] for i, c in enumerate(conditions)]


class _Search:
    """Places of the conditions by their numbers."""

    def __init__(self, null: NullSpace, conditions: Sequence[Condition]) -> None:
        self.null = null
        self.conditions = conditions
        self.rows = [[null.weights(place.weights) for place in condition.places] for condition in conditions]

    def stack(self, choice: Sequence[int], without: int = -1) -> Array:
        """(c, K) the chosen rows."""
        picked = [rows[k] for i, (rows, k) in enumerate(zip(self.rows, choice, strict=True)) if i != without]
        return np.array(picked).reshape(-1, len(self.null.names))

    def score(self, choice: Sequence[int]) -> tuple[int, float]:
        """Number of unknowns that are determined; and how little the others are tied: where two must move for more."""
        free = self.null.free(self.stack(choice))
        share = np.linalg.norm(free, axis=1)
        return int((share < SHARE).sum()), round(-float(share.sum()), 6)

    def best(self) -> list[int]:
        """The choice that determines most unknowns; the paper's if none is better."""
        paper = [0] * len(self.rows)
        return paper if self.score(paper)[0] == len(self.null.basis) else self._climb(paper)

    def _climb(self, choice: list[int]) -> list[int]:
        """Move one condition at a time while that helps; from random starts this never found better on real plans."""
        best = self.score(choice)
        for _ in range(_SWEEPS):
            before = best
            for index in range(len(self.rows)):
                others = (k for k in range(len(self.rows[index])) if k != choice[index])
                for trial in [[*choice[:index], k, *choice[index + 1 :]] for k in others]:
                    if (value := self.score(trial)) > best:
                        best, choice = value, trial
            if best == before:
                break
        return choice

    def steadier(self, choice: list[int]) -> list[int]:
        """Move directions and a length that was not measured off nodes that are hardly reached."""
        score = self.score(choice)[0]
        for index, condition in enumerate(self.conditions):
            if not condition.is_far or condition.places[choice[index]].is_measured:
                continue
            fixed = self._fixed_by(choice, index)
            if not fixed.any():
                continue
            places = [k for k, place in enumerate(condition.places) if not place.is_measured]
            trials = [[*choice[:index], k, *choice[index + 1 :]] for k in places]
            trials = [trial for trial in trials if self.score(trial)[0] == score]
            spread = [float(np.median(self.null.uncertainty(self.stack(trial))[fixed])) for trial in trials]
            choice = next(t for t, s in zip(trials, spread, strict=True) if s <= _WORSE * min(spread))
        return choice

    def _fixed_by(self, choice: list[int], index: int) -> BoolArray:
        """(K + N,) which unknowns one condition determines."""
        return self.null.determined(self.stack(choice)) & ~self.null.determined(self.stack(choice, without=index))

    def is_idle(self, choice: list[int], index: int) -> bool:
        """Whether a condition determines nothing but the unknowns on which it sits."""
        fixed = np.flatnonzero(self._fixed_by(choice, index))
        sits = np.flatnonzero(self.rows[index][choice[index]])
        return set(fixed.tolist()) <= set(sits.tolist())


LENGTH = say("datum.absolute_length")


def conditions(
    tables: Sequence[MachineTable], setup_ids: Sequence[str], known: Mapping[str, KnownLength]
) -> list[Condition]:
    """The conditions in the paper's order; a ModelError if a measured length is no positioning error of X or Y.

    Zero of every table at its axis's zero and of EXC, EYC, ECC at the first index, Eq. (16); straightness zero at
    the last node too, which makes the line through both the direction of the axis, and the measured length, Eq.
    (17).
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
    straight = [table for table in tables if table.is_straightness]
    out += [Condition(_at_nodes(table, _from_outside(table.nodes)), is_far=True) for table in straight]
    return [*out, _length(by_name, known)]


def known_weights(table: MachineTable, position: float) -> dict[str, float]:
    """A positioning error at a position, counted from the axis's zero, as a weighted sum of the table's unknowns."""
    weights = interpolation(table.nodes, np.array([position]))[:, 0]
    if table.nodes[0] <= 0.0 <= table.nodes[-1]:
        weights = weights - interpolation(table.nodes, np.zeros(1))[:, 0]
    return _named(table, weights)


def _zero(table: MachineTable) -> Condition:
    places = []
    if table.nodes[0] <= 0.0 <= table.nodes[-1]:
        weights = interpolation(table.nodes, np.zeros(1))[:, 0]
        places.append(Place(_named(table, weights), 0.0, f"{table.name}(0) = 0"))
    nearest = np.argsort(np.abs(table.nodes), kind="stable").tolist()
    return Condition((*places, *_at_nodes(table, nearest)))


def _at_nodes(table: MachineTable, nodes: Sequence[int]) -> tuple[Place, ...]:
    """Zero at each of some nodes."""
    return tuple(Place({table.labels[k]: 1.0}, 0.0, f"{table.labels[k]} = 0") for k in nodes)


def _length(by_name: Mapping[str, MachineTable], known: Mapping[str, KnownLength]) -> Condition:
    """The measured length; where no touch reaches it, the straight line from the axis's zero to it."""
    places = []
    for name, entry in known.items():
        told = say("datum.as_measured", name=f"{name}({entry.position:.6g})")
        places.append(Place(known_weights(by_name[name], entry.position), entry.value, told, is_measured=True))
    name = next(iter(known), "EXX")
    table, stated = by_name[name], known.get(name)
    slope = stated.value / stated.position if stated is not None and stated.position else 0.0
    for k in _from_outside(table.nodes):
        words = f"{table.labels[k]} = 0"
        if stated is not None:
            words = say("datum.on_line", name=table.labels[k], measured=f"{name}({stated.position:.6g})")
        places.append(Place(known_weights(table, float(table.nodes[k])), slope * float(table.nodes[k]), words))
    return Condition(tuple(places), is_far=True)


def _from_outside(nodes: Array) -> list[int]:
    """Nodes from the outermost on the positive side inwards, then from the outermost on the negative side."""
    positive = [k for k in range(len(nodes) - 1, -1, -1) if nodes[k] > 1e-12]
    return positive + [k for k in range(len(nodes)) if nodes[k] < -1e-12]


def _named(table: MachineTable, weights: Array) -> dict[str, float]:
    return {label: float(w) for label, w in zip(table.labels, weights, strict=True) if abs(w) > 1e-12}
