# SPDX-License-Identifier: Apache-2.0
"""The errors of the axes along their lines from the fit of a step diagonal."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.machine.error_motions import interpolation, parse_motion
from machine_tool_calibration.methods.iso230_2 import diagonal_tests
from machine_tool_calibration.methods.step_diagonal.model import StepDiagonalModel
from machine_tool_calibration.model.fit import Fit
from machine_tool_calibration.model.model import NotDetermined
from machine_tool_calibration.model.result import ErrorMap
from machine_tool_calibration.words import say, together

__all__ = ["error_map"]


def error_map(model: StepDiagonalModel, fit: Fit) -> ErrorMap:
    """Position errors of each axis at its block positions, straightness and squareness."""
    profiles = model.profiles(fit)
    content: dict[str, Any] = {}
    for letter, nodes, error, uncertainty in zip(
        "xyz", model.blocks, profiles.error, profiles.uncertainty, strict=True
    ):
        content[letter], content[f"{letter}_u"] = error, uncertainty
        content[f"{letter}_position"] = nodes
    figures = profiles.figures()
    for kind in ("positioning", "straightness", "squareness"):
        content[kind] = _paired({f.name: (f.value, f.uncertainty) for f in figures if f.kind == kind})
    content |= _angular(model, fit)
    told = fit.joint.marginal.random
    if told is not None:
        content["angular_size"] = told.size
        content["angular_probability"] = told.probability
    if fit.joint.given is None:  # of the readings themselves: a refit changes nothing of them
        content |= diagonal_tests(model.observations)
    content["datum"] = (
        say("datum.oriented", own=model.datum, what=profiles.oriented) if profiles.oriented else model.datum
    )
    corner = np.array([nodes[0] for nodes in model.blocks])
    points = np.concatenate(
        [np.where(np.arange(3) == axis, nodes[:, None], corner) for axis, nodes in enumerate(model.blocks)]
    )
    error, uncertainty = np.concatenate(profiles.error), np.concatenate(profiles.uncertainty)
    n = len(points)
    blocks = profiles.covariance.reshape(n, 3, n, 3)[np.arange(n), :, np.arange(n), :]
    known = np.isfinite(error)
    blocks = np.where(known[:, :, None] & known[:, None, :], blocks, np.nan)
    measured = profiles.split(profiles.value)
    lost = tuple(
        NotDetermined(f"error_map.{letter}: e{component}", _why(model, values[:, j], part[:, j]))
        for letter, values, part in zip("xyz", measured, profiles.error, strict=True)
        for j, component in enumerate("xyz")
        if not np.isfinite(part[:, j]).all() and len(part) > 1
    )
    return ErrorMap(content, points, error, uncertainty, blocks, lost)


def _angular(model: StepDiagonalModel, fit: Fit) -> dict[str, Any]:
    """Free angular errors at the block positions: x_angular … (N + 1, 3) EA, EB, EC with `_u`."""
    if not model.angles:
        return {}
    place = {p.name: k for k, p in enumerate(model.parameters)}
    out: dict[str, Any] = {}
    for axis, letter in enumerate("xyz"):
        nodes = model.blocks[axis]
        value, uncertainty = np.full((len(nodes), 3), np.nan), np.full((len(nodes), 3), np.nan)
        for angle in model.angles:
            motion = parse_motion(angle.table.name)
            at = [place[label] for label in angle.table.labels]
            if motion.axis != letter.upper() or not fit.determined[at].all():
                continue
            weights = interpolation(angle.table.nodes, nodes)
            column = "ABC".index(motion.component)
            value[:, column] = weights.T @ fit.theta[at]
            uncertainty[:, column] = np.sqrt(
                np.maximum(np.einsum("kn,kl,ln->n", weights, fit.covariance[np.ix_(at, at)], weights), 0.0)
            )
        out[f"{letter}_angular"], out[f"{letter}_angular_u"] = value, uncertainty
    return out


def _why(model: StepDiagonalModel, measured: Array, determined: Array) -> str:
    """Why a column of the map has gaps: values that were measured, and values that are determined."""
    missing = int(np.count_nonzero(~np.isfinite(measured)))
    if missing == np.count_nonzero(~np.isfinite(determined)):
        return say("undetermined.not_reached", n=missing, count=len(measured))
    present = [model.runs[k] for k in np.unique(model.observations.readings.setup)]
    diagonals = {run.sign.tobytes() for run in present if run.diagonal}
    moved = [axis for axis, nodes in enumerate(model.blocks) if len(nodes) > 1]
    linear = [axis for axis in moved if not any(run.sign[axis] and not run.diagonal for run in present)]
    lacking = [say("undetermined.no_linear_run", axis="XYZ"[axis]) for axis in linear]
    if len(diagonals) < len(moved):
        lacking.insert(0, say("undetermined.diagonals", n=len(diagonals), count=len(moved)))
    return say("undetermined.runs", lacking=together(lacking or [say("undetermined.too_few")], ", "))


def _paired(values: Mapping[str, tuple[float, float]]) -> dict[str, float]:
    """Each `name` with its `name_u`."""
    return {key: v for name, (value, u) in values.items() for key, v in ((name, value), (f"{name}_u", u))}
