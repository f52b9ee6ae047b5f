"""What an instrument that reads deviations leaves open: nothing, an offset per setup, or where the part lay."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from machine_tool_calibration.arrays import Array, IntArray
from machine_tool_calibration.model.model import NotDetermined
from machine_tool_calibration.model.terms import Parameter

__all__ = ["SetupDatum", "setup_datum"]

_SHIFTS = ("shift_x", "shift_y", "shift_z")
_TURNS = ("turn_a", "turn_b", "turn_c")


@dataclass(frozen=True)
class SetupDatum:
    """Unknowns of every setup.

    Attributes:
        kind: none, offset or rigid.
        columns: (p, n) change of each reading per unit of the p unknowns of its setup.
        parameters: setups times p, setup after setup.
        left_out: unknowns that no reading depends on.
        curvature: (n,) what a finite turn adds to the linear one, m.
        words: the datum in words.
    """

    kind: str
    columns: Array
    parameters: tuple[Parameter, ...]
    left_out: tuple[NotDetermined, ...]
    curvature: Array
    words: str


def setup_datum(
    kind: str, ids: tuple[str, ...], setup: IntArray, position: Array, direction: Array, reading: Array
) -> SetupDatum:
    """The unknowns of the setups.

    Args:
        kind: none, offset (one unknown per setup) or rigid (shift and turn about the middle of the setup's points).
        ids: names of the setups.
        setup: (n,) index of each reading's setup.
        position: (n, 3) m.
        direction: (n, 3) unit vectors.
        reading: (n,) deviations, m.
    """
    n = len(setup)
    if kind == "none":
        return SetupDatum(kind, np.zeros((0, n)), (), (), np.zeros(n), "deviations are absolute")
    if kind == "offset":
        names = tuple(Parameter(f"{name}.offset", "m") for name in ids)
        return SetupDatum(kind, np.ones((1, n)), names, (), np.zeros(n), "each setup has an unknown offset")
    count = np.maximum(np.bincount(setup, minlength=len(ids)), 1)
    total = np.stack([np.bincount(setup, position[:, j], minlength=len(ids)) for j in range(3)], axis=1)
    arm = position - (total / count[:, None])[setup]
    columns = np.concatenate([direction.T, np.cross(arm, direction).T])
    # A turn moves what is at an arm's length; points in a plane leave three of the six without effect.
    used = np.abs(columns).max(axis=1, initial=0.0) > 1e-9
    columns[np.abs(columns) < 1e-12] = 0.0
    labels = [label for label, good in zip(_SHIFTS + _TURNS, used, strict=True) if good]
    parameters = tuple(
        Parameter(f"{name}.{label}", "m" if label in _SHIFTS else "rad") for name in ids for label in labels
    )
    idle = [label for label, good in zip(_SHIFTS + _TURNS, used, strict=True) if not good]
    left = tuple(NotDetermined(label, "no reading of any setup depends on it") for label in idle)
    return SetupDatum(
        kind,
        columns[used],
        parameters,
        left,
        _curvature(columns, setup, len(ids), arm, direction, reading),
        "each setup has an unknown shift, and an unknown turn about the middle of its points",
    )


def _curvature(columns: Array, setup: IntArray, count: int, arm: Array, direction: Array, reading: Array) -> Array:
    """What the best turn adds to its first order, g . (R - 1 - turn x) arm: a milliradian shortens 1 m by 0.5 um."""
    out = np.zeros(len(setup))
    for index in range(count):
        mine = setup == index
        if mine.sum() < 6:
            continue
        for _ in range(3):
            motion = np.linalg.lstsq(columns[:, mine].T, reading[mine] - out[mine], rcond=1e-9)[0]
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
