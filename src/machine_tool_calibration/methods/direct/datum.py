# SPDX-License-Identifier: Apache-2.0
"""What an instrument that reads deviations leaves open, and only as much datum as the readings need."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from machine_tool_calibration.arrays import Array, IntArray, groups, means_of
from machine_tool_calibration.estimation.solve import LEAST_EIGENVALUE
from machine_tool_calibration.model.model import Kind, NotDetermined, Parameter
from machine_tool_calibration.model.observations import Observations
from machine_tool_calibration.words import enumeration, say

# Share of a condition along what is still open below which it fixes nothing of it.
_FIXED_SHARE = 1e-5


def silent_directions(columns: Array) -> tuple[Array, Array]:
    """(m, q) directions of scaled unknowns that no reading (m, n) notices, and (m,) scales: unknown / scaled one."""
    norms = np.sqrt(np.einsum("mn,mn->m", columns, columns))
    typical = float(norms.max(initial=0.0)) or 1.0
    scale = 1.0 / np.where(norms > 1e-13 * typical, norms, typical)
    matrix = (columns @ columns.T) * np.outer(scale, scale)
    values, vectors = np.linalg.eigh((matrix + matrix.T) / 2)
    return np.asarray(vectors[:, values <= LEAST_EIGENVALUE * len(norms)]), scale


def needed_rows(open_directions: Array, rows: Sequence[Array]) -> tuple[list[int], Array]:
    """Which conditions each fix a direction that readings and conditions before leave open, and (m, c) these.

    Such a condition can always be met without any reading fitting worse. `open_directions` (m, q) is a basis of
    them, `rows` the weights (m,) of the candidates in the order of preference, in the same scaling of the unknowns.
    """
    basis = open_directions
    needed, fixed = [], []
    for index, row in enumerate(rows):
        if not basis.shape[1]:
            break
        seen = row @ basis
        size = float(np.linalg.norm(seen))
        if size <= _FIXED_SHARE * max(float(np.linalg.norm(row)), 1e-300):
            continue
        needed.append(index)
        # What is still open is orthogonal to what the condition sees.
        full = np.linalg.svd((seen / size)[:, None], full_matrices=True)[0]
        fixed.append(basis @ full[:, 0])
        basis = basis @ full[:, 1:]
    return needed, np.array(fixed).reshape(len(needed), len(open_directions)).T


_SHIFTS = ("shift_x", "shift_y", "shift_z")
# Singular value over the largest from which a turn is told; and no part lies this far askew, rad.
_TURN_IS_TOLD, _MOST_TURN = 1e-5, 0.1
_TURNS = ("turn_a", "turn_b", "turn_c")


@dataclass(frozen=True)
class SetupDatum:
    """Unknowns of every setup."""

    kind: str  # none, offset or rigid
    columns: Array  # (p, n) change of each reading per unit of the p unknowns of its setup
    parameters: tuple[Parameter, ...]  # setups times p, setup after setup
    left_out: tuple[NotDetermined, ...]  # unknowns that no reading depends on
    curvature: Array  # (n,) what a finite turn adds to the linear one, m
    words: str  # the datum in words

    def of_each(self, observed: Observations) -> Array:
        """(setups times p, n) the columns of every setup's unknowns."""
        of_setup = np.equal.outer(np.arange(len(observed.session.setup_ids)), observed.readings.setup)
        return np.asarray((of_setup[:, None] * self.columns).reshape(-1, len(observed)))


def setup_datum(kind: str, observed: Observations) -> SetupDatum:
    """Unknowns of the setups: none, an offset, or shift and turn about the middle of the setup's points."""
    ids, setup, n = observed.session.setup_ids, observed.readings.setup, len(observed)
    position, direction = observed.position, observed.direction
    if kind == "none":
        return SetupDatum(kind, np.zeros((0, n)), (), (), np.zeros(n), say("datum.absolute"))
    if kind == "offset":
        names = tuple(Parameter(f"{name}.offset", "m", kind=Kind.OFFSET, owner=name) for name in ids)
        return SetupDatum(kind, np.ones((1, n)), names, (), np.zeros(n), say("datum.offset"))
    arm = position - np.stack([means_of(groups(setup), place) for place in position.T], axis=1)
    columns = np.concatenate([direction.T, np.cross(arm, direction).T])
    # A turn moves what is at an arm's length; points in a plane leave three of the six without effect.
    used = np.abs(columns).max(axis=1, initial=0.0) > 1e-9
    columns[np.abs(columns) < 1e-12] = 0.0
    told = list(zip(_SHIFTS + _TURNS, used, strict=True))
    parameters = tuple(
        Parameter(f"{name}.{label}", "m" if label in _SHIFTS else "rad", kind=Kind.MOUNTING, owner=name)
        for name in ids
        for label, good in told
        if good
    )
    why = say("undetermined.no_reading_of_setups")
    left = tuple(NotDetermined(label, why) for label, good in told if not good)
    curvature = _curvature(columns, setup, len(ids), arm, direction, observed.readings.displacement)
    return SetupDatum(kind, columns[used], parameters, left, curvature, say("datum.shift_and_turn"))


def _curvature(columns: Array, setup: IntArray, count: int, arm: Array, direction: Array, reading: Array) -> Array:
    """What the best turn adds to its first order, g . (R - 1 - turn x) arm: a milliradian shortens 1 m by 0.5 um."""
    out = np.zeros(len(setup))
    for index in range(count):
        mine = setup == index
        if mine.sum() < 6:
            continue
        own = columns[:, mine].T
        size = np.linalg.norm(own, axis=0)
        size = np.where(size > 0.0, size, 1.0)
        for _ in range(3):
            # A turn about where all directions meet is told by rounding alone.
            motion = np.linalg.lstsq(own / size, reading[mine] - out[mine], rcond=_TURN_IS_TOLD)[0] / size
            if np.linalg.norm(motion[3:]) > _MOST_TURN:
                out[mine] = 0.0
                break
            out[mine] = np.einsum("nj,nj->n", direction[mine], _second_order(motion[3:], arm[mine]))
    return out


def _second_order(turn: Array, arm: Array) -> Array:
    """(n, 3) exact rotation of the arms by a rotation vector, less its first order."""
    angle = float(np.linalg.norm(turn))
    if angle < 1e-9:
        return np.zeros_like(arm)
    unit = turn / angle
    once = np.cross(unit, arm)
    # sin(a) - a and 1 - cos(a), without cancellation
    sine = -(angle**3) / 6 * (1 - angle**2 / 20) if angle < 0.1 else np.sin(angle) - angle
    return np.asarray(sine * once + 2 * np.sin(angle / 2) ** 2 * np.cross(unit, once))


def unconnected(observed: Observations, place: IntArray) -> Iterator[str]:
    """Groups of places between which no setup tells the difference, axis by axis, in words.

    The setups have an offset each; `place` (n,) is that of each reading.
    """
    direction, setup = np.abs(observed.direction), groups(observed.readings.setup)
    for j, axis in enumerate("xyz"):
        mine = direction.argmax(axis=1) == j
        if not mine.any():
            continue
        at = groups(place[mine])
        count, size = 1 + int(at.max()), 2 + int(at.max()) + int(setup.max())
        read = coo_array((np.ones(len(at)), (at, count + setup[mine])), shape=(size, size))
        sizes = np.bincount(connected_components(read, directed=False)[1][:count])
        sizes = np.sort(sizes[sizes > 0])[::-1]
        if len(sizes) > 1:
            shown = enumeration([str(one) for one in sizes.tolist()])
            yield say("datum.unconnected", axis=axis, groups=len(sizes), sizes=shown)
