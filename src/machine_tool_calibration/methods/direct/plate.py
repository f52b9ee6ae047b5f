# SPDX-License-Identifier: Apache-2.0
"""A part or plate, step by step: where it lay, one scale, different scales and squareness, curves.

The way in which a drilled plate is looked at: each step is the one before with a few more unknowns, and is worth what
it takes away of the scatter. All numbers rest on the scatter that is left, not on the declared uncertainty: what a
drill scatters is no error of the instrument that measures the holes.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import special

from machine_tool_calibration.arrays import Array, IntArray
from machine_tool_calibration.machine.error_motions import squareness_field
from machine_tool_calibration.methods.direct.datum import SetupDatum, setup_columns
from machine_tool_calibration.model.observations import Observations
from machine_tool_calibration.words import say

__all__ = ["plate_steps"]

_STILL = 1e-6  # m
_ROUNDING = 1e-9
_PAIRS = {"C0Y": (0, 1), "B0Z": (0, 2), "A0Z": (1, 2)}
_DATUM = {"none": "as_measured", "offset": "offsets", "rigid": "where_it_lay"}


@dataclass(frozen=True)
class _Step:
    """Columns of one step; those with a name (of the unknown, of what it is, and unit) are in its result."""

    title: str
    columns: Array
    names: tuple[tuple[str, str, str], ...] = ()


def plate_steps(observations: Observations, setups: SetupDatum) -> dict[str, Any] | None:
    """The steps of a session whose places differ along at least two axes, each of them sensed.

    Readings of one place, direction and setup are averaged: what they share is the part's.

    Args:
        observations: the readings.
        setups: what each setup leaves open.

    Returns:
        `steps`: for each the model in words, unknowns, RMS residual, scatter (RMS over the degrees of freedom), F and
        p of what it adds to the one before, and its parameters with standard uncertainties from the scatter;
        `places`: number of averaged readings. None for other sessions.
    """
    moved = np.ptp(observations.position, axis=0) > _STILL
    sensed = np.abs(observations.direction).max(axis=0) > 0.5
    plane = [j for j in range(3) if moved[j] and sensed[j]]
    if len(plane) < 2:
        return None
    place, first = _places(observations)
    count = np.bincount(place)
    reading = np.bincount(place, observations.readings.displacement - setups.curvature) / count
    position, direction = observations.position[first], observations.direction[first]
    own = setup_columns(
        setups.columns[:, first], observations.readings.setup[first], len(observations.session.setup_ids)
    )
    steps = _columns(position, direction, plane, _Step(say(f"plate.{_DATUM[setups.kind]}"), own))
    if len(reading) < 2 * sum(len(step.columns) for step in steps[:-1]) + 4:
        return None
    out = []
    before: tuple[float, int] | None = None
    for k in range(len(steps)):
        step, before = _fitted(steps[: k + 1], reading, before)
        out.append(step)
    return {"steps": out, "places": len(reading)}


def _places(observations: Observations) -> tuple[IntArray, IntArray]:
    """(n,) number of each reading's place, setup and direction; and the first reading of each."""
    keys = np.concatenate(
        [
            observations.readings.setup[None].astype(float),
            np.round(observations.position.T * 1e8),
            np.round(observations.direction.T * 1e6),
        ]
    )
    _, first, place = np.unique(keys, axis=1, return_index=True, return_inverse=True)
    return place.reshape(-1), first


def _columns(position: Array, direction: Array, plane: Sequence[int], first: _Step) -> list[_Step]:
    scale = [position[:, j] * direction[:, j] for j in plane]
    square = [name for name, pair in _PAIRS.items() if set(pair) <= set(plane)]
    skew = [np.einsum("nj,nj->n", squareness_field(name, position), direction) for name in square]
    arm = (position - position.mean(axis=0)) / max(float(np.ptp(position, axis=0).max()), _STILL)
    bows = [arm[:, a] * arm[:, b] * direction[:, j] for j in plane for a in plane for b in plane if a <= b]
    letters = ["xyz"[j] for j in plane]
    return [
        first,
        _Step(say("plate.one_scale"), np.array([np.sum(scale, axis=0)]), (("scale.s", "scale", "1"),)),
        _Step(
            say("plate.scales"),
            # The first scale of all is in the model already: together they are the scales of the axes.
            np.array([*scale, *skew]),
            (
                *((f"scale_{letter}.s", f"scale_{letter}", "1") for letter in letters),
                *((f"{name}.angle", name, "rad") for name in square),
            ),
        ),
        _Step(say("plate.curves_model"), np.array(bows)),
    ]


def _fitted(
    steps: Sequence[_Step], reading: Array, before: tuple[float, int] | None
) -> tuple[dict[str, Any], tuple[float, int]]:
    """One step, and its sum of squares and rank for the next one."""
    # A step that names its own unknowns for what the one before said in fewer replaces it.
    used = [s for k, s in enumerate(steps) if not (k == 1 and len(steps) > 2)]
    columns = np.concatenate([step.columns for step in used])
    size = np.maximum(np.linalg.norm(columns, axis=1), 1e-300)
    left, values, vectors = np.linalg.svd((columns / size[:, None]).T, full_matrices=False)
    keep = values > _ROUNDING * values.max(initial=0.0)
    rank = int(keep.sum())
    theta = vectors[keep].T @ ((left[:, keep].T @ reading) / values[keep])
    residual = reading - (columns / size[:, None]).T @ theta
    squares, dof = float(residual @ residual), len(reading) - rank
    variance = squares / max(dof, 1)
    out: dict[str, Any] = {
        "model": steps[-1].title,
        "unknowns": rank,
        "rms": float(np.sqrt(squares / len(reading))),
        "scatter": float(np.sqrt(variance)),
    }
    if before is not None:
        more = before[0] - squares
        extra = rank - before[1]
        ratio = more / extra / variance if extra > 0 and variance > 0 else 0.0
        out |= {"f": ratio, "p_value": float(special.fdtrc(extra, dof, ratio)) if extra > 0 else 1.0}
    place = sum(len(step.columns) for step in used[:-1])
    covariance = (vectors[keep] / values[keep][:, None]).T @ (vectors[keep] / values[keep][:, None]) * variance
    names = list(used[-1].names)
    weights = np.zeros((len(names), len(theta)))
    weights[np.arange(len(names)), place + np.arange(len(names))] = 1.0
    if len(names) > 1:
        # What the scales of the axes differ by is known better than each of them, or is known alone.
        scales = [k for k, (*_, unit) in enumerate(names) if unit == "1"]
        for one, other in itertools.combinations(scales, 2):
            weights = np.concatenate([weights, (weights[one] - weights[other])[None]])
            names.append((f"{names[one][0]} - {names[other][0]}", f"{names[one][1]} − {names[other][1]}", "1"))
    loose = vectors[~keep]
    out["parameters"] = []
    for row, (name, what, unit) in zip(weights / size, names, strict=True):
        known = bool(np.linalg.norm(loose @ row) < _ROUNDING**0.5 * np.linalg.norm(row))
        value, u = float(row @ theta), float(np.sqrt(row @ covariance @ row))
        out["parameters"].append(
            {
                "name": name,
                "of": what,
                "value": value if known else None,
                "standard_uncertainty": u if known else None,
                "unit": unit,
                "p_value": float(2 * special.stdtr(dof, -abs(value) / u)) if known and u > 0 and dof else None,
            }
        )
    return out, (squares, rank)
