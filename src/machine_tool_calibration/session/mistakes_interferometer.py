"""Tracking interferometers and step diagonals against their nominal geometry."""

from __future__ import annotations

import re
from collections.abc import Iterator

import numpy as np

from machine_tool_calibration.arrays import Array, IntArray
from machine_tool_calibration.session import nominal
from machine_tool_calibration.session.description import StepDiagonal, TrackingInterferometer
from machine_tool_calibration.session.mistakes import (
    Comparison,
    Mistake,
    exchanged,
    exchanged_axes,
    extent,
    groups,
    per_setup,
    same,
    scaled,
    spread,
)
from machine_tool_calibration.session.session import Readings

__all__ = ["compare_beam", "compare_diagonal", "compare_order", "compare_tracking"]

_ORDER = re.compile(r"[_.-]([xyz]{3})$", re.IGNORECASE)


def compare_beam(description: TrackingInterferometer, readings: Readings) -> Comparison:
    """Commanded beam against the direction from the station to the target; misfits are angles, rad."""
    ids = [setup.id for setup in description.setups]
    stations = np.array([setup.position for setup in description.setups])
    upright = 0.0 if description.dimension == 2 else 1.0
    azimuth = readings.columns["azimuth"]
    elevation = upright * readings.columns.get("elevation", np.zeros(len(readings)))

    def judge(
        order: IntArray,
        unit: float = 1.0,
        sense: float = 1.0,
        about: tuple[float, float] = (1.0, 0.0),
        axes: tuple[int, int, int] = (0, 1, 2),
    ) -> Array:
        line = (readings.position()[:, axes] - stations[order][readings.setup]) * (1.0, 1.0, upright)
        beam = nominal.direction(about[0] * azimuth * unit + about[1], elevation * unit)
        cosine = np.sum(beam * line, axis=1) / np.linalg.norm(line, axis=1)
        return per_setup(readings.setup, np.arccos(np.clip(sense * cosine, -1, 1)), len(ids))

    itself = same(len(ids))
    now = judge(itself)

    def mistakes() -> Iterator[Mistake]:
        yield Mistake("azimuth and elevation look like degrees; angles are in radians", judge(itself, np.pi / 180), 1.0)
        yield Mistake("azimuth and elevation point from the target to the station", judge(itself, 1.0, -1.0), 1.0)
        what = "azimuth looks as if it was counted clockwise; it is counter-clockwise from +X, seen from +Z"
        yield Mistake(what, judge(itself, about=(-1.0, 0.0)), 1.0)
        yield Mistake("azimuth looks as if it was off by half a turn", judge(itself, about=(1.0, np.pi)), 1.0)
        for what, axes in exchanged_axes(description.dimension):
            yield Mistake(what, judge(itself, axes=axes), 1.0)
        yield from exchanged("setup", ids, now, 1.0, judge)

    return Comparison(now, 1.0, mistakes())


def compare_tracking(description: TrackingInterferometer, readings: Readings) -> Comparison:
    """Displacements against the change of distance between station and target, m."""
    ids = [setup.id for setup in description.setups]
    stations = np.array([setup.position for setup in description.setups])[:, : description.dimension]
    points = readings.position()[:, : description.dimension]
    measured, setup = readings.displacement, readings.setup

    def judge(difference: Array) -> Array:
        return spread(difference, setup, setup, len(ids))

    def path(
        order: IntArray,
        station_unit: float = 1.0,
        point_unit: float = 1.0,
        axes: tuple[int, int, int] = (0, 1, 2),
    ) -> Array:
        line = point_unit * points[:, axes[: description.dimension]] - station_unit * stations[order][setup]
        return np.asarray(np.linalg.norm(line, axis=1))

    itself = same(len(ids))
    predicted = path(itself)
    now, scale = judge(measured - predicted), extent(predicted, setup)

    def mistakes() -> Iterator[Mistake]:
        yield from scaled(measured, predicted, scale, judge)
        for what, units in (("the stations' positions look", (1e-3, 1.0)), ("x, y and z look", (1.0, 1e-3))):
            other = path(itself, *units)
            message = f"{what} like millimetres; lengths are in metres"
            yield Mistake(message, judge(measured - other), extent(other, setup))
        for what, axes in exchanged_axes(description.dimension):
            yield Mistake(what, judge(measured - path(itself, axes=axes)), scale)
        yield from exchanged("setup", ids, now, scale, lambda order: judge(measured - path(order)))

    return Comparison(now, scale, mistakes())


def compare_diagonal(description: StepDiagonal, readings: Readings) -> Comparison:
    """Displacements and positions against the runs' nominal lines, m."""
    ids = [setup.id for setup in description.setups]
    start = np.array([setup.start for setup in description.setups])
    direction = np.array([setup.direction for setup in description.setups])
    motion = direction * np.asarray(description.step) * description.blocks
    beam = motion / np.linalg.norm(motion, axis=1)[:, None]
    points, setup, measured = readings.position(), readings.setup, readings.displacement
    group = groups(setup, readings.repeat)

    def judge(difference: Array, order: IntArray, points: Array = points) -> Array:
        low = np.minimum(start, start + motion)[order][setup]
        high = np.maximum(start, start + motion)[order][setup]
        outside = np.linalg.norm(np.clip(low - points, 0, None) + np.clip(points - high, 0, None), axis=1)
        return spread(difference, group, setup, len(ids)) + per_setup(setup, outside, len(ids))

    def path(order: IntArray, points: Array = points) -> Array:
        which = order[setup]
        return np.asarray(np.sum(beam[which] * (points - start[which]), axis=1))

    itself = same(len(ids))
    predicted = path(itself)
    now, scale = judge(measured - predicted, itself), extent(predicted, group)

    def mistakes() -> Iterator[Mistake]:
        yield from scaled(measured, predicted, scale, lambda difference: judge(difference, itself))
        for what, axes in exchanged_axes(3):
            other = points[:, axes]
            yield Mistake(what, judge(measured - path(itself, other), itself, other), scale)
        yield from exchanged("setup", ids, now, scale, lambda order: judge(measured - path(order), order))

    return Comparison(now, scale, mistakes())


def compare_order(description: StepDiagonal, readings: Readings) -> Comparison:
    """Positions against those at which a diagonal halts if its moves are in the order that its id states, m."""
    ids = [setup.id for setup in description.setups]
    points, setup = readings.position(), readings.setup
    halts = [_halts(description, index) for index in range(len(ids))]

    def judge(order: IntArray) -> Array:
        off = np.zeros(len(points))
        for index, other in enumerate(order):
            mine = setup == index
            if halts[other] is not None and mine.any():
                off[mine] = np.linalg.norm(points[mine][:, None] - halts[other], axis=2).min(axis=1)
        # The two thirds of the halts at which one order differs from another decide, not the middle one.
        return np.array([off[setup == k].mean() if np.any(setup == k) else np.nan for k in range(len(ids))])

    itself = same(len(ids))
    now, scale = judge(itself), min(description.step)
    return Comparison(now, scale, exchanged("setup", ids, now, scale, judge))


def _halts(description: StepDiagonal, index: int) -> Array | None:
    """(3 blocks + 1, 3) positions of a diagonal whose id states the order of its moves; None for others."""
    run = description.setups[index]
    found = _ORDER.search(run.id)
    if run.kind != "diagonal" or found is None or sorted(found[1].lower()) != ["x", "y", "z"]:
        return None
    moves = np.zeros((3 * description.blocks + 1, 3))
    for place, letter in enumerate(found[1].lower()):
        axis = "xyz".index(letter)
        moves[1 + place :: 3, axis] = run.direction[axis] * description.step[axis]
    return np.asarray(np.asarray(run.start) + np.cumsum(moves, axis=0))
