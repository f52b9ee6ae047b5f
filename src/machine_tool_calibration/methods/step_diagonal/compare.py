# SPDX-License-Identifier: Apache-2.0
"""Position errors by every formulation, side by side (Ibaraki and Hata 2010, Table 1 and Figs. 7-9)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.errors import ModelError
from machine_tool_calibration.methods.step_diagonal.build import build
from machine_tool_calibration.methods.step_diagonal.formulations import (
    Increments,
    conventional,
    increments,
    new,
)
from machine_tool_calibration.methods.step_diagonal.geometry import step_diagonal_of
from machine_tool_calibration.methods.step_diagonal.profiles import Profiles, eq17
from machine_tool_calibration.model.fit import fit_models
from machine_tool_calibration.model.model import Kind
from machine_tool_calibration.session.session import Session

__all__ = ["FORMULATIONS", "FormulationComparison", "compare_formulations", "identify_by_formulation"]

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
    step_diagonal_of(session)
    if name in _MODELS:
        model = build(session, _MODELS[name])
        return model.profiles(fit_models([model]).fits[0], name)
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
    return Profiles(name, blocks, known, covariance, np.zeros((len(value), 0)))


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
