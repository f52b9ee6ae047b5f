# SPDX-License-Identifier: Apache-2.0
"""Plates and axes as workshops measure them: places computed point by point, with none of the estimator's columns."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from machine_tool_calibration.session.parse import describe
from machine_tool_calibration.session.session import Readings, Session

__all__ = ["axis", "plate", "session", "with_columns"]


def session(
    columns: Mapping[str, Any],
    declared: float,
    datum: str = "none",
    terms: Sequence[str] = (),
    repeat: np.ndarray | None = None,
    *names: str,
    setup: Sequence[int] | None = None,
    **said: Any,
) -> Session:
    """Direct deviations from their columns, `displacement` among them; keys of the description may be said.

    A number stands for a column of it. Where nothing says along what was read, it is along X.
    """
    description = {
        "format": "mtcal-session/1", "method": "direct", "machine": {"chain": "w-Y-X-b-Z-t"}, "datum": datum,
        "standard_uncertainty": {"displacement": declared}, "terms": list(terms),
        "setups": [{"id": name} for name in names or ("A",)],
    }  # fmt: skip
    count = len(columns["displacement"])
    along = {"gx": 0.0 if columns.keys() & {"gy", "gz"} else 1.0, "gy": 0.0, "gz": 0.0}
    every = {**along, **columns}.items()
    values = {key: np.array(np.broadcast_to(np.asarray(column, float), count)) for key, column in every}
    row = np.arange(count)
    readings = Readings(
        setup=0 * row if setup is None else np.asarray(setup, np.int64),
        repeat=0 * row if repeat is None else repeat.astype(np.int64),
        displacement=values.pop("displacement"),
        columns=values,
        labels={},
        row=row,
    )
    return Session(describe(description | said, "session.yaml"), readings, "session")


def with_columns(measured: Session, displacement: np.ndarray | None = None, **columns: np.ndarray) -> Session:
    """The same with other readings or columns."""
    old = measured.readings
    new = old.displacement if displacement is None else displacement
    return measured.with_readings(replace(old, displacement=new, columns={**old.columns, **columns}))


def _scatter(rng: np.random.Generator, shape: tuple[int, ...], size: float, tails: float | None) -> np.ndarray:
    if tails is None:
        return size * rng.normal(size=shape)
    return size * rng.standard_t(tails, size=shape) / np.sqrt(tails / (tails - 2.0))


def plate(
    seed: int,  # of everything random
    *,
    holes: int = 300,  # how many
    side: float = 0.6,  # of the plate, m
    origin: tuple[float, float] = (0.0, 0.0),  # nominal place of its corner, m
    drilled: float = 6e-6,  # scatter of the holes, m
    tails: float | None = 5.0,  # degrees of freedom of its distribution (Student's); normal without
    measured: float = 1e-6,  # scatter of the coordinate measuring machine, m
    declared: float = 1.5e-6,  # standard uncertainty that the session states, m
    scales: tuple[float, float] = (0.0, 0.0),  # of X and Y
    square: float = 0.0,  # angle by which Y leans towards -x, rad
    turn: float | None = None,  # of the plate on the measuring machine, rad; up to a milliradian if absent
    far: int = 0,  # how many readings are far off
    repeats: int = 1,  # how often every hole was measured
    rows: bool = False,  # whether the holes lie in a grid, drilled row by row
    row_scatter: float = 0.0,  # scatter that the holes of one row share, m
) -> tuple[Session, list[int]]:
    """Holes that a drill with unequal scales and axes out of square made, then measured somewhere else.

    The session, with x and y of each hole as two readings, and the rows that are far off.
    """
    rng = np.random.default_rng(seed)
    if rows:
        count = int(np.sqrt(holes))
        line = np.linspace(0.0, side, count)
        nominal = np.array([(x, y) for y in line for x in line])
        row = np.repeat(np.arange(count), count)
    else:
        nominal = np.round(rng.uniform(0.0, side, (holes, 2)), 5)
        row = np.zeros(holes, np.int64)
    nominal = nominal + np.asarray(origin)
    made = nominal.copy()
    made[:, 0] = nominal[:, 0] * (1.0 + scales[0]) - np.sin(square) * nominal[:, 1]
    made[:, 1] = nominal[:, 1] * (1.0 + scales[1])
    made += _scatter(rng, made.shape, drilled, tails) + (rng.normal(size=(row.max() + 1, 2)) * row_scatter)[row]
    angle = rng.uniform(-1e-3, 1e-3) if turn is None else turn
    c, s = np.cos(angle), np.sin(angle)
    lying = made @ np.array([[c, s], [-s, c]]) + rng.normal(size=2) * 1e-4
    seen = np.concatenate([lying + rng.normal(size=lying.shape) * measured for _ in range(repeats)])
    place = np.tile(nominal, (repeats, 1))
    deviation = (seen - place).reshape(-1)
    n = len(deviation)
    off = np.sort(rng.choice(n, far, replace=False))
    deviation[off] += rng.choice([-1.0, 1.0], far) * rng.uniform(25.0, 60.0, far) * drilled
    columns = {
        "time": np.arange(n) * 5.0,
        "x": np.repeat(place[:, 0], 2),
        "y": np.repeat(place[:, 1], 2),
        "z": np.zeros(n),
        "gx": np.tile([1.0, 0.0], n // 2),
        "gy": np.tile([0.0, 1.0], n // 2),
        "gz": np.zeros(n),
        "displacement": deviation,
    }
    repeat = np.repeat(np.arange(repeats), n // repeats)
    return session(columns, declared, "rigid", (), repeat, "plate"), off.tolist()


def axis(
    seed: int,  # of everything random
    *,
    positions: int = 11,  # target positions
    length: float = 0.5,  # m
    runs: int = 5,  # up and down
    noise: float = 5e-7,  # scatter of a single positioning, m
    declared: float = 2e-7,  # standard uncertainty that the session states, m
    scale: float = 0.0,  # of the axis
    backlash: float = 0.0,  # half the reversal error, m
    wander: float = 0.0,  # size of a positioning error without any simple shape, m
    between: float = 0.0,  # scatter between the passes, m
    datum: str = "none",  # of the session
    terms: Sequence[str] = (),  # machine errors of the session
) -> Session:
    """An axis run by ISO 230-2, up and down."""
    rng = np.random.default_rng(seed)
    target = np.linspace(0.0, length, positions)
    error = scale * target + wander * rng.normal(size=positions)
    up = np.arange(positions)
    index = np.tile(np.concatenate([up, up[::-1]]), runs)
    approach = np.tile(np.repeat([1.0, -1.0], positions), runs)
    passing = np.repeat(rng.normal(size=2 * runs) * between, positions)
    n = len(index)
    columns = {
        "time": np.arange(n) * 10.0,
        "x": target[index],
        "gx": np.ones(n),
        "gy": np.zeros(n),
        "gz": np.zeros(n),
        "dir_x": approach,
        "displacement": error[index] - backlash * approach + passing + rng.normal(size=n) * noise,
    }
    return session(columns, declared, datum, terms, np.repeat(np.arange(runs), 2 * positions), "X")
