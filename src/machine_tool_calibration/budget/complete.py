# SPDX-License-Identifier: Apache-2.0
"""A result with the uncertainty of its budget, so that whatever is told of it states the same."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any, TypeVar

import numpy as np

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.budget.propagate import Budget
from machine_tool_calibration.budget.published import DIAGONAL_FIGURES, FIGURES, POSITION_ERROR, Quantity
from machine_tool_calibration.methods.iso230_2 import of_diagonals
from machine_tool_calibration.model.result import Identified

__all__ = ["completed"]

Either = TypeVar("Either", bound=Identified)


def completed(result: Either, budget: Budget) -> Either:
    """The same with half the expanded uncertainty for 95.45 % in place of every standard uncertainty.

    Args:
        result: of an identification.
        budget: of its fit.
    """
    # What instrument and temperature add to the square of what the readings show.
    square = np.maximum((budget.expanded / 2.0) ** 2 - budget.numbers.u**2, 0.0)
    more = {name: square[q.members] for name, q in budget.numbers.by_name.items()}
    content = _content(result.error_map.content, more, budget.numbers.by_name)
    own = more.get(POSITION_ERROR)
    found = result.error_map
    if own is not None and own.size == found.uncertainty.size:
        u = _grown(found.uncertainty, own)
        ratio = u / np.where(found.uncertainty > 0.0, found.uncertainty, 1.0)
        spread = None if found.covariance is None else found.covariance * ratio[:, :, None] * ratio[:, None, :]
        found = replace(found, uncertainty=u, covariance=spread)
        if f"{POSITION_ERROR}_u" in content:
            content[f"{POSITION_ERROR}_u"] = u
    single = {name: float(square[0]) for name, square in more.items() if len(square) == 1}
    return replace(result, error_map=replace(found, content=content), variance_added=single)


def _grown(u: Any, square: Array) -> Array:
    """Standard uncertainties with a variance added; NaN is not determined."""
    own = np.asarray(u, dtype=np.float64)
    return np.sqrt(own**2 + square.reshape(own.shape))


def _content(
    content: Mapping[str, Any], more: Mapping[str, Array], known: Mapping[str, Quantity], name: str = ""
) -> dict[str, Any]:
    """What a map holds with its `name_u` grown, by the names of `published.everything`."""
    out = dict(content)
    for key, value in content.items():
        if isinstance(value, Mapping):
            out[key] = _content(value, more, known, key)
        shown, u = name if key == "value" else key, content.get(f"{key}_u")
        square = more.get(shown)
        if u is not None and square is not None and np.size(u) == square.size:
            grown = _grown(u, square)
            out[f"{key}_u"] = float(grown) if np.ndim(u) == 0 else grown
    if "iso230_2" in content:
        out["iso230_2"] = [_run(run, more, dict(zip(FIGURES, FIGURES, strict=True))) for run in content["iso230_2"]]
    if "iso230_6" in content:
        out["iso230_6"] = of_diagonals([_run(run, more, DIAGONAL_FIGURES) for run in content["iso230_6"]["runs"]])
    if "iso230_7" in content:
        out["iso230_7"] = [_range(one, more) for one in content["iso230_7"]]
    return out


def _run(run: Mapping[str, Any], more: Mapping[str, Array], figures: Mapping[str, str]) -> dict[str, Any]:
    """A run by ISO 230-2 or along a diagonal, whose figures have expanded uncertainties; by their published names."""
    out = {key: value for key, value in run.items() if key != "note"}  # that the instrument's comes on top
    for name, figure in figures.items():
        names = (f"{name}_{run['axis']}.{run['setup']}", f"{name}_{run['axis']}")
        square = next((more[name] for name in names if name in more), None)
        if square is not None and run.get(f"{figure}_U") is not None:
            out[f"{figure}_U"] = float(2.0 * _grown(run[f"{figure}_U"] / 2.0, square[0]))
    return out


def _range(one: Mapping[str, Any], more: Mapping[str, Array]) -> dict[str, Any]:
    """An error motion value by ISO 230-7."""
    square = more.get(f"{one['motion']}_range")
    return dict(one) if square is None else {**one, "U": float(2.0 * _grown(one["U"] / 2.0, square[0]))}
