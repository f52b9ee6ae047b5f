# SPDX-License-Identifier: Apache-2.0
"""The formulations of Ibaraki and Hata 2010, conventional and new, and position errors by all (Table 1, Figs. 7-9).

Formulas take R, (..., D, d, N): displacements of the single moves for the diagonals ppp, npp, pnp,
the axis of the move and the block counted along the increasing axis, m; and give increments of the position errors,
(..., d, d, N): axis of the motion, component, block, m. Leading dimensions are passed through.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from machine_tool_calibration.arrays import Array, IntArray
from machine_tool_calibration.errors import ModelError
from machine_tool_calibration.methods.step_diagonal.build import build
from machine_tool_calibration.methods.step_diagonal.geometry import Run, halts_of, runs_of
from machine_tool_calibration.methods.step_diagonal.profiles import Profiles, eq17
from machine_tool_calibration.model.fit import fit_models
from machine_tool_calibration.model.model import Kind
from machine_tool_calibration.session.description import StepDiagonal
from machine_tool_calibration.session.session import Session

__all__ = [
    "FORMULATIONS",
    "FormulationComparison",
    "Increments",
    "compare_formulations",
    "conventional",
    "identify_by_formulation",
    "increments",
    "new",
]


_AT_BLOCK = 1e-2


@dataclass(frozen=True)
class Increments:
    """Displacements of single moves as linear functions of the readings.

    Attributes:
        axes: the machine axes of the diagonals, such as (0, 1, 2).
        step: (d,) length of a move along each of them, m.
        diagonal: (D, d, N) R_x,ppp(k) …: diagonals ppp, npp, pnp, axis of the move, block. Blocks
            are counted along the increasing axis, so that the paper's R_x,npp(N - k + 1) is at k.
        linear: (d, N) displacement of each axis's own run less the step: de_x(x(k)) ….
        weights: (D d N + d N, n) how `diagonal` and `linear` follow from the readings.
        first: (d,) first block position of each axis, m.
        lacking: runs and blocks without a reading; what depends on them is NaN.
    """

    axes: tuple[int, ...]
    step: Array
    diagonal: Array
    linear: Array
    weights: Array
    first: Array
    lacking: tuple[str, ...]


def increments(session: Session) -> Increments:
    """The moves of those of a session's diagonals and linear runs that the paper's formulas use.

    These know neither a fourth diagonal nor linear runs off the edges that meet in the first block positions.

    Raises:
        ModelError: the diagonals are not those of the paper.
    """
    description = session.description.as_a(StepDiagonal)
    runs = runs_of(description)
    blocks = description.blocks
    diagonals = [run for run in runs if run.diagonal]
    axes = (0, 1, 2)
    if not diagonals or any((run.sign == 0).any() for run in diagonals):
        raise ModelError("the paper's formulations need diagonals that move all three axes")
    wanted = [np.ones(len(axes))]
    for reverse in range(len(axes) - 1):
        wanted.append(np.where(np.arange(len(axes)) == reverse, -1.0, 1.0))
    names = ["".join("p" if s > 0 else "n" for s in signs) for signs in wanted]
    finite = np.isfinite(session.readings.displacement)
    rows: list[Array] = []
    lacking: list[str] = []
    n = len(session.readings)
    for name, signs in zip(names, wanted, strict=True):
        members = [k for k, run in enumerate(runs) if run.diagonal and (run.sign[list(axes)] == signs).all()]
        rows.append(_averaged(session, runs, members, axes, finite, blocks, name, lacking))
    starts = np.array([np.minimum(run.start, run.start + run.motion) for run in diagonals])
    corner = starts.min(axis=0)
    linear: list[Array] = []
    for axis in axes:
        members = _nearest_to(corner, axis, runs)
        linear.append(_averaged(session, runs, members, (axis,), finite, blocks, "XYZ"[axis], lacking))
    weights = np.concatenate([*rows, *linear]).reshape(-1, n)
    values = weights @ np.where(finite, session.readings.displacement, 0.0)
    count = len(names) * len(axes) * blocks
    step = np.asarray(description.step)[list(axes)]
    return Increments(
        axes,
        step,
        values[:count].reshape(len(names), len(axes), blocks),
        values[count:].reshape(len(axes), blocks) - step[:, None],
        weights,
        corner[list(axes)],
        tuple(lacking),
    )


def _nearest_to(corner: Array, axis: int, runs: Sequence[Run]) -> list[int]:
    """Linear runs along an axis, those that lie nearest to the edge through a corner."""
    off = {
        k: round(float(np.linalg.norm(np.delete(run.start - corner, axis))), 9)
        for k, run in enumerate(runs)
        if not run.diagonal and run.sign[axis]
    }
    return [k for k, distance in off.items() if distance == min(off.values())]


def _averaged(
    session: Session,
    runs: Sequence[Run],
    members: Sequence[int],
    axes: tuple[int, ...],
    finite: Array,
    blocks: int,
    name: str,
    lacking: list[str],
) -> Array:
    """(axes, N, n) weights of the readings in each move, averaged over setups and repeats; NaN where none was read."""
    readings, description = session.readings, session.description.as_a(StepDiagonal)
    total = np.zeros((len(axes), blocks, len(readings)))
    count = np.zeros((len(axes), blocks))
    for k in members:
        path = halts_of(description.setups[k], description)
        for repeat in np.unique(readings.repeat[readings.setup == k]):
            mine = np.flatnonzero((readings.setup == k) & (readings.repeat == repeat) & finite)
            place = _matched(path, session, mine)
            for j in range(1, len(path)):
                if place[j] < 0 or place[j - 1] < 0:
                    continue
                axis = "xyz".index(runs[k].order[(j - 1) % len(runs[k].order)])
                made = (j - 1) // len(runs[k].order)
                block = made if runs[k].sign[axis] > 0 else blocks - 1 - made
                total[axes.index(axis), block, place[j]] += 1.0
                total[axes.index(axis), block, place[j - 1]] -= 1.0
                count[axes.index(axis), block] += 1.0
    if not members or not count.any():
        lacking.append(f"no run {name}")
    elif not count.all():
        axis_, block_ = np.argwhere(count == 0)[0]
        lacking.append(f"run {name}: no reading on both sides of move {'xyz'[axes[axis_]]} of block {block_ + 1}")
    with np.errstate(invalid="ignore"):
        return np.where(count[..., None] > 0, total / np.where(count > 0, count, 1.0)[..., None], np.nan)


def _matched(path: Array, session: Session, mine: IntArray) -> IntArray:
    """(m,) reading at each position of the path; -1 where there is none."""
    place = np.full(len(path), -1, dtype=np.int64)
    if not len(mine):
        return place
    position = session.readings.position()[mine]
    distance = np.abs(path[:, None] - position[None]).max(axis=2)
    nearest = distance.argmin(axis=1)
    step = np.linalg.norm(np.diff(path, axis=0), axis=1).min()
    near = distance[np.arange(len(path)), nearest] < _AT_BLOCK * step
    place[near] = mine[nearest[near]]
    return place


_X, _Y, _Z = 0, 1, 2


def conventional(R: Array, step: Array) -> Array:
    """Wang's formulation, Eq. (2) with the nominal directions of Eq. (3).

    It takes the mirror to be at right angles to the beam: a tilt of 1 mrad makes it wrong by tens of micrometres.

    Args:
        R: (..., d, d, N), m.
        step: (d,) a_x, a_y, a_z, m.
    """
    count = len(step)
    signs = np.where(np.eye(count, count, -1) > 0, -1.0, 1.0)
    beams = signs * step / np.linalg.norm(step)
    out = np.empty(R.shape)
    for axis in range(count):
        # A move of -a along the axis reads minus the beam's share of it.
        matrix = signs[:, axis, None] * beams
        out[..., axis, :, :] = np.linalg.solve(matrix, R[..., :, axis, :])
        out[..., axis, axis, :] -= step[axis]
    return out


def new(R: Array, linear: Array, step: Array) -> Array:
    """The formulation that is immune to the mirrors' tilts, Eqs. (6)-(19), in the coordinate system of Eq. (17).

    A tilt adds a constant to each move of an axis; the constants of one diagonal sum up to zero. So the normal errors
    are those of the conventional formulation but for lambda / (2 l), l the beam's direction cosine.

    Args:
        R: (..., d, d, N), m.
        linear: (..., d, N) increments of the positioning errors de_x(x), de_y(y), de_z(z) from linear runs, m.
        step: (d,) a_x, a_y, a_z, m.
    """
    twice = 2.0 * step / np.linalg.norm(step)
    out = conventional(R, step)
    # Eqs. (16) and (18): l[..., axis, component], of which the mean is that of what differs from the linear runs.
    surplus = out.copy()
    for axis in range(len(step)):
        surplus[..., axis, axis, :] -= linear[..., axis, :]
    told = twice[:, None] * surplus.mean(axis=-1, keepdims=True)
    constant = np.zeros(told.shape)
    # Under Eq. (17) the means of de_y(x), de_z(x) and de_y(z) vanish.
    constant[..., _X, 1:, :] = told[..., _X, 1:, :]
    constant[..., _Z, _Y, :] = told[..., _Z, _Y, :]
    # Eq. (19)
    own = told[..., _X, _X, :] + told[..., _Y, _Y, :] + told[..., _Z, _Z, :]
    constant[..., _Z, _X, :] = -told[..., _X, _Z, :] - own
    constant[..., _Y, _X, :] = -constant[..., _X, _Y, :] - constant[..., _X, _Z, :] - constant[..., _Z, _X, :]
    constant[..., _Y, _Z, :] = -constant[..., _X, _Y, :] - constant[..., _Z, _Y, :] - constant[..., _Y, _X, :]
    out -= constant / twice[:, None]
    for axis in range(len(step)):
        out[..., axis, axis, :] = linear[..., axis, :]
    return out


FORMULATIONS = ("conventional", "new", "least_squares", "small_angles")
"""`least_squares` and `small_angles` are the weighted least-squares estimator over all readings, without and with small
angular errors (the model `translations`, and the default of `mtcal identify`); the others are the paper's."""

_MODELS = {"least_squares": "translations", "small_angles": "small_angles"}


def identify_by_formulation(session: Session, name: str) -> Profiles:
    """Position errors of the axes by one formulation, in the coordinate system of Eq. (17), with their covariance.

    The covariance is that of the readings' declared uncertainty; it knows nothing of a tilted mirror.

    Args:
        session: of the method `step_diagonal`.
        name: one of `FORMULATIONS`.

    Raises:
        ModelError: no such formulation, or runs or readings that it needs are missing.
    """
    if name in _MODELS:
        model = build(session, _MODELS[name])
        return model.profiles(fit_models([model]).fits[0])
    if name not in FORMULATIONS:
        raise ModelError(f"no formulation {name!r}; known are {', '.join(FORMULATIONS)}")
    moves = increments(session)
    lacking = [
        what for what in moves.lacking if name != "conventional" or what[-1:] not in "XYZ" or "no run" not in what
    ]
    needed = moves.weights if name != "conventional" else moves.weights[: moves.diagonal.size]
    if not np.isfinite(needed).all():
        raise ModelError(f"the formulation {name} needs every move of its runs: {'; '.join(lacking)}")
    return _propagated(name, moves, session.sigma)


def _propagated(name: str, moves: Increments, sigma: float) -> Profiles:
    """Profiles by one of the paper's formulas, which are linear in the displacements, with their covariance."""
    count = moves.diagonal.size
    blocks = _blocks(moves)
    linear = np.nan_to_num(moves.linear)

    def errors(R: Array, positioning: Array) -> Array:
        change = conventional(R, moves.step) if name == "conventional" else new(R, positioning, moves.step)
        return eq17(blocks, _profiles(change, moves))

    size = count + moves.linear.size
    units = np.eye(size)
    R = units[:, :count].reshape(-1, *moves.diagonal.shape) + moves.diagonal
    positioning = units[:, count:].reshape(-1, *moves.linear.shape) + linear
    value = errors(moves.diagonal, linear)
    slope = errors(R, positioning) - value
    weights = np.nan_to_num(moves.weights)
    on_readings = slope.T @ weights
    sensed = np.zeros((len(value) // 3, 3))
    sensed[:, list(moves.axes)] = 1.0
    covariance = sigma**2 * on_readings @ on_readings.T
    places = np.concatenate([np.full(3 * len(b), len(b) > 1) for b in blocks])
    known = np.where((sensed.ravel() > 0) & places, value, np.nan)
    return Profiles(blocks, known, covariance, np.zeros((len(value), 0)))


def _blocks(moves: Increments) -> tuple[Array, Array, Array]:
    out = [np.zeros(1), np.zeros(1), np.zeros(1)]
    for place, axis in enumerate(moves.axes):
        out[axis] = moves.first[place] + moves.step[place] * np.arange(moves.diagonal.shape[-1] + 1)
    return out[0], out[1], out[2]


def _profiles(change: Array, moves: Increments) -> Array:
    """(..., M) sums of increments (..., d, d, N), zero at the first block position."""
    lead = change.shape[:-3]
    out = []
    for axis in range(3):
        if axis not in moves.axes:
            out.append(np.zeros((*lead, 3)))
            continue
        part = np.zeros((*lead, change.shape[-1] + 1, 3))
        for column, component in enumerate(moves.axes):
            part[..., 1:, component] = np.cumsum(change[..., moves.axes.index(axis), column, :], axis=-1)
        out.append(part.reshape(*lead, -1))
    return np.concatenate(out, axis=-1)


@dataclass(frozen=True)
class FormulationComparison:
    """Formulations side by side.

    Attributes:
        profiles: by name.
        refused: by name, why a formulation cannot be used here.
        tilts: of the mirror in each diagonal against its beam as the readings show it, rad; the conventional
            formulation takes them to be zero.
    """

    profiles: Mapping[str, Profiles]
    refused: Mapping[str, str]
    tilts: Mapping[str, float]


def compare_formulations(session: Session) -> FormulationComparison:
    """Every formulation that the session allows.

    Raises:
        ModelError: it allows none.
    """
    profiles: dict[str, Profiles] = {}
    refused: dict[str, str] = {}
    for name in FORMULATIONS:
        try:
            profiles[name] = identify_by_formulation(session, name)
        except ModelError as error:
            refused[name] = str(error)
    if not profiles:
        raise ModelError(f"{session.source}: no formulation can be used: {next(iter(refused.values()))}")
    return FormulationComparison(profiles, refused, _tilts(session) if "least_squares" in profiles else {})


def _tilts(session: Session) -> dict[str, float]:
    fit = fit_models([build(session, _MODELS["least_squares"])]).fits[0]
    squares: dict[str, float] = {}
    for parameter, value, known in zip(fit.model.parameters, fit.theta, fit.determined, strict=True):
        if parameter.kind is Kind.TILT and known:
            squares[parameter.owner] = squares.get(parameter.owner, 0.0) + float(value) ** 2
    return {name: square**0.5 for name, square in squares.items()}
