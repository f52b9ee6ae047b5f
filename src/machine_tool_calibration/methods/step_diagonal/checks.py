# SPDX-License-Identifier: Apache-2.0
"""Readings of a step diagonal against its runs as they are stated."""

from __future__ import annotations

import itertools
import re
from collections.abc import Iterable, Iterator

import numpy as np

from machine_tool_calibration.arrays import Array, groups
from machine_tool_calibration.errors import SessionError, suspected
from machine_tool_calibration.session.checks.mistakes import SENSES, UNITS, exchanged_axes, scaled
from machine_tool_calibration.session.checks.nominal_geometry import (
    badly_exchanged,
    judged_by_worst,
    off_prediction,
    relative_misfit,
    typical_extent,
)
from machine_tool_calibration.session.checks.units import LARGEST_MACHINE, LARGEST_TRAVEL, MILLIMETRES
from machine_tool_calibration.session.description import DiagonalSetup, Place, StepDiagonal
from machine_tool_calibration.session.judgements import Checks, Held, Judgement
from machine_tool_calibration.session.session import Session
from machine_tool_calibration.words import say

__all__ = ["DiagonalChecks"]

# A place may be outside its run by this share of the step (runs of unequal steps stay within), and off the halts by
# this one where most others are on them.
_OUTSIDE, _ON_HALT = 0.5, 0.02
# Blocks beyond which no halts are compared: nobody made as many.
_MOST_BLOCKS = 10_000
# Factor between the steps, or the way, that are stated and those of the places.
_STEPS = 1.5
# A displacement may be off its place by a part of the path, by what a mirror's tilt makes of the way across the beam,
# rad, and by this, m.
_SCALE, _TILT, _ERROR = 2e-3, 0.03, 1e-3
_ORDER = re.compile(r"[_.-]([xyz]{3})$", re.IGNORECASE)


class DiagonalChecks(Checks):
    """Of a step diagonal."""

    needed = 2

    @suspected()
    def magnitudes(self, session: Session, place: Place) -> None:
        """Refuse starts and steps of runs that no machine has."""
        description = session.description.as_a(StepDiagonal)
        if description.trust_units:
            return
        for index, run in enumerate(description.setups):
            reach = max(map(abs, run.start))
            if reach > LARGEST_MACHINE:
                raise SessionError(f"{place.description}: setups[{index}].start is {reach:g} m; {MILLIMETRES}")
        if max(description.step) * description.blocks > LARGEST_TRAVEL:
            raise SessionError(
                f"{place.description}: step: {description.blocks} blocks of {max(description.step):g} m; {MILLIMETRES}"
            )

    def nominal(self, session: Session, place: Place) -> Iterator[Judgement]:
        """Judgements of a step diagonal."""
        mistakes = itertools.chain(scaled(session, *UNITS, *SENSES), exchanged_axes(session, 3))
        yield judged_by_worst(
            _off_diagonal, itertools.chain(mistakes, badly_exchanged(session, _off_diagonal, "setup"))
        )
        yield judged_by_worst(_off_halts, badly_exchanged(session, _off_halts, "setup"))

    def held(self, session: Session) -> Iterator[Held]:
        """Places against the runs as they are stated, and displacements against the places."""
        description, readings = session.description.as_a(StepDiagonal), session.readings
        path, across, outside = _along_run(session)
        step = np.array(description.step)
        off, bad = np.linalg.norm(outside, axis=1), (outside / step).max(axis=1) > _OUTSIDE
        for index in np.unique(readings.setup):
            mine = np.flatnonzero(readings.setup == index)
            if description.blocks > _MOST_BLOCKS:
                continue
            halts = _halts(description, index)
            missed = np.abs(readings.position()[mine][:, None] - halts).max(axis=2).min(axis=1)
            if np.mean(missed > _ON_HALT * step.min()) < 0.5:
                bad[mine] |= missed > _ON_HALT * step.min()
                off[mine] = np.maximum(off[mine], missed)

        yield Held(
            "the place",
            "the run that start, direction, step and blocks state",
            np.where(bad, off, 0.0),
            np.zeros(len(off)),
            share=0.0,
            hint=lambda setup: _run_of_places(session, setup),
        )
        length = float(np.linalg.norm(step * description.blocks))
        yield Held(
            "displacement",
            "the way along the beam to where it was read",
            off_prediction(session, path, groups(readings.setup, readings.repeat)),
            _ERROR + _SCALE * length + _TILT * across,
        )

    def suspicious(self, session: Session) -> Iterator[str]:
        """Runs that step and blocks make longer, or of other steps, than their places."""
        description, places = session.description.as_a(StepDiagonal), session.readings.position()
        moves = np.array([run.direction for run in description.setups])[session.readings.setup] != 0.0
        for axis, step, moved, place in zip("xyz", description.step, moves.T, places.T, strict=True):
            halts = np.unique(np.round(place[moved], 9))
            if len(halts) < 3:
                continue
            between = float(np.median(np.diff(halts)))
            if not 1 / _STEPS < between / step < _STEPS or description.blocks * step > _STEPS * np.ptp(halts):
                yield say(
                    "suspicion.steps",
                    blocks=description.blocks,
                    step=f"{1e3 * step:.4g}",
                    axis=axis,
                    count=len(halts),
                    low=f"{1e3 * halts[0]:.6g}",
                    high=f"{1e3 * halts[-1]:.6g}",
                    between=f"{1e3 * between:.4g}",
                )
                return


def _off_diagonal(session: Session) -> Array:
    """Displacements and positions against the runs' nominal lines."""
    path, _, outside = _along_run(session)
    group = groups(session.readings.setup, session.readings.repeat)
    return np.asarray(
        relative_misfit(session, path, group) + np.linalg.norm(outside, axis=1) / typical_extent(path, group)
    )


def _along_run(session: Session) -> tuple[Array, Array, Array]:
    """Of each place: (n,) its path along the beam, (n,) its distance across, (n, 3) how far off the run, m."""
    description, setup = session.description.as_a(StepDiagonal), session.readings.setup
    start = np.array([run.start for run in description.setups])
    motion = np.array([run.direction for run in description.setups]) * description.step * description.blocks
    beam = motion / np.maximum(np.linalg.norm(motion, axis=1), 1e-300)[:, None]
    place = session.readings.position() - start[setup]
    path = np.sum(beam[setup] * place, axis=1)
    low, high = np.minimum(0.0, motion)[setup], np.maximum(0.0, motion)[setup]
    outside = np.clip(low - place, 0, None) + np.clip(place - high, 0, None)
    return path, np.linalg.norm(place - path[:, None] * beam[setup], axis=1), outside


def _run_of_places(session: Session, setup: int) -> str:
    """Where the places of a setup run, if it is elsewhere than stated."""
    description, readings = session.description.as_a(StepDiagonal), session.readings
    run, mine = description.setups[setup], readings.setup == setup
    places = readings.position()[mine & (readings.repeat == readings.repeat[mine][0])]
    moved = places[-1] - places[0]
    signs = np.where(np.abs(moved) > _OUTSIDE * np.array(description.step), np.sign(moved), 0.0)
    stated = np.array(run.direction) * description.step * description.blocks
    if (np.abs(places[0] + moved - run.start - stated) + np.abs(places[0] - run.start)).max() < 1e-6:
        return ""
    return (
        f"its places run from {_vector(places[0])} to {_vector(places[-1])} m, direction {_vector(signs)}, and stated "
        f"are {_vector(run.start)} to {_vector(run.start + stated)} m, direction {_vector(run.direction)}"
    )


def _vector(values: Iterable[float]) -> str:
    return f"[{', '.join(f'{round(v, 9) + 0.0:.6g}' for v in values)}]"


def _off_halts(session: Session) -> Array:
    """Positions against those at which a diagonal halts if its moves are in the order that its id states.

    In shares of the step; each reading has the mean of its setup: the two thirds of the halts at which one order
    differs from another decide, not the middle one.
    """
    description, readings = session.description.as_a(StepDiagonal), session.readings
    off, points = np.zeros(len(readings)), readings.position()
    for index in np.unique(readings.setup):
        mine = readings.setup == index
        if _stated_order(description.setups[index]):
            off[mine] = np.linalg.norm(points[mine][:, None] - _halts(description, index), axis=2).min(axis=1).mean()
    return off / min(description.step)


def _stated_order(run: DiagonalSetup) -> str:
    """The order of a diagonal's moves that its id states; empty for others."""
    found = _ORDER.search(run.id)
    known = run.kind == "diagonal" and found is not None and sorted(found[1].lower()) == ["x", "y", "z"]
    return found[1].lower() if known and found is not None else ""


def _halts(description: StepDiagonal, index: int) -> Array:
    """(k, 3) positions at which a run halts; its moves are in the order xyz where its id states none."""
    run = description.setups[index]
    order = _stated_order(run) or "".join(axis for axis, sign in zip("xyz", run.direction, strict=True) if sign)
    moves = np.zeros((len(order) * description.blocks + 1, 3))
    for place, letter in enumerate(order):
        axis = "xyz".index(letter)
        moves[1 + place :: len(order), axis] = run.direction[axis] * description.step[axis]
    return np.asarray(np.asarray(run.start) + np.cumsum(moves, axis=0))
