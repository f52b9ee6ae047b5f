# SPDX-License-Identifier: Apache-2.0
"""The step diagonal: its traits, and readings against the runs as they are stated."""

from collections.abc import Iterable, Iterator
from functools import partial
from itertools import chain
from typing import ClassVar

import numpy as np

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.errors import SessionError, suspected
from machine_tool_calibration.methods.step_diagonal.geometry import halts_of, run_of, runs_of
from machine_tool_calibration.session.checks.mistakes import SENSES, UNITS, exchanged_axes, scaled
from machine_tool_calibration.session.checks.nominal_geometry import (
    badly_exchanged,
    judged_by_worst,
    off_prediction,
    relative_misfit,
    typical_extent,
)
from machine_tool_calibration.session.checks.units import LARGEST_MACHINE, LARGEST_TRAVEL, MILLIMETRES
from machine_tool_calibration.session.description import Place, StepDiagonal
from machine_tool_calibration.session.judgements import Held, Judgement
from machine_tool_calibration.session.method import MethodSpec
from machine_tool_calibration.session.session import Session
from machine_tool_calibration.words import say

# A place may be outside its run by this share of the step (runs of unequal steps stay within), and off the halts by
# this one where most others are on them.
_OUTSIDE, _ON_HALT = 0.5, 0.02
# Share of a stated run's places that is read at least in one of the runs.
_READ = 0.5
# Blocks beyond which no halts are compared: nobody made as many.
_MOST_BLOCKS = 10_000
# A displacement may be off its place by a part of the path, by what a mirror's tilt makes of the way across the beam,
# rad, and by this, m.
_SCALE, _TILT, _ERROR = 2e-3, 0.03, 1e-3


class DiagonalSpec(MethodSpec):
    """A step diagonal."""

    description = StepDiagonal
    always = ("setup", "repeat", "x", "y", "z", "displacement")
    needed = 2
    remounted = "the mirror"
    model = "machine_tool_calibration.methods.step_diagonal.build"
    models: ClassVar = {
        "small_angles": "the default: position errors of the axes; angular errors are zero or small smooth random "
        "functions, of a size that the readings determine as far as they can",
        "translations": "the machine has no angular errors, or they are known to be negligible: fewer unknowns",
        "angular": "every diagonal was run in several orders of the moves: the angular errors that these determine "
        "are found",
        "angular_one_mirror": "the same, and the mirror was not touched between the orders of a diagonal",
        "aligned_mirror": "no angular errors, and mirrors exactly square to their beams, as the conventional "
        "formulation assumes: only to compare with it",
    }
    states_runs = counts_from_run = True
    steps = "machine_tool_calibration.procedure.steps:diagonal_steps"
    further_places = "machine_tool_calibration.planning.places:further_runs"
    planned = "machine_tool_calibration.planning.forecast:along_diagonals"

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
        mistakes = chain(scaled(session, *UNITS, *SENSES), exchanged_axes(session, 3))
        yield judged_by_worst(_off_diagonal, chain(mistakes, badly_exchanged(session, _off_diagonal, "setup")))
        yield judged_by_worst(_off_halts, badly_exchanged(session, _off_halts, "setup"))

    def suspicious(self, session: Session) -> Iterator[str]:
        """Runs of which, as they are stated, most places were never read; while the first is under way none is."""
        description, readings = session.description.as_a(StepDiagonal), session.readings
        if description.blocks > _MOST_BLOCKS or len(np.unique(readings.setup)) < 2:
            return
        best, most = 0.0, {"read": "0", "count": "", "setup": ""}
        for index, setup in enumerate(description.setups):
            halts = halts_of(setup, description)
            steps = (readings.position()[readings.setup == index] - setup.start) / description.step
            there = np.abs(steps - np.round(steps)).max(axis=1) < _ON_HALT
            read = len(_counted(steps[there]) & _counted((halts - setup.start) / description.step))
            if read >= best * len(halts):
                best, most = read / len(halts), {"read": f"{read}", "count": f"{len(halts)}", "setup": setup.id}
        if best < _READ:
            step = _vector(1e3 * s for s in description.step)
            yield say("suspicion.blocks", blocks=description.blocks, step=step, **most)

    def held(self, session: Session) -> Iterator[Held]:
        """Places against the runs as they are stated, and displacements against the places."""
        description, readings = session.description.as_a(StepDiagonal), session.readings
        path, across, outside = _along_run(session)
        step = np.array(description.step)
        off, bad = np.linalg.norm(outside, axis=1), (outside / step).max(axis=1) > _OUTSIDE
        for index, setup in enumerate(description.setups if description.blocks <= _MOST_BLOCKS else ()):
            mine = np.flatnonzero(readings.setup == index)
            if not len(mine):
                continue
            halts = halts_of(setup, description)
            missed = np.abs(readings.position()[mine][:, None] - halts).max(axis=2).min(axis=1)
            if np.mean(missed > _ON_HALT * step.min()) < 0.5:
                bad[mine] |= missed > _ON_HALT * step.min()
                off[mine] = np.maximum(off[mine], missed)
        against, hint = "the run that start, direction, step and blocks state", partial(_run_of_places, session)
        yield Held("the place", against, np.where(bad, off, 0.0), np.zeros(len(off)), share=0.0, hint=hint)
        along = off_prediction(session, path, readings.repeat_of_setup)
        length = float(np.linalg.norm(step * description.blocks))
        against = "the way along the beam to where it was read"
        yield Held("displacement", against, along, _ERROR + _SCALE * length + _TILT * across)


SPEC = DiagonalSpec()


def _off_diagonal(session: Session) -> Array:
    path, _, outside = _along_run(session)
    group = session.readings.repeat_of_setup
    return np.asarray(
        relative_misfit(session, path, group) + np.linalg.norm(outside, axis=1) / typical_extent(path, group)
    )


def _along_run(session: Session) -> tuple[Array, Array, Array]:
    """Of each place: (n,) its path along the beam, (n,) its distance across, (n, 3) how far off the run, m."""
    runs, setup = runs_of(session.description.as_a(StepDiagonal)), session.readings.setup
    beam, motion = np.array([run.beam for run in runs])[setup], np.array([run.motion for run in runs])[setup]
    place = session.readings.position() - np.array([run.start for run in runs])[setup]
    path = np.sum(beam * place, axis=1)
    low, high = np.minimum(0.0, motion), np.maximum(0.0, motion)
    outside = np.clip(low - place, 0, None) + np.clip(place - high, 0, None)
    return path, np.linalg.norm(place - path[:, None] * beam, axis=1), outside


def _run_of_places(session: Session, setup: int) -> str:
    """Where the places of a setup run, if it is elsewhere than stated."""
    description, readings = session.description.as_a(StepDiagonal), session.readings
    run, mine = run_of(description.setups[setup], description), readings.setup == setup
    places = readings.position()[mine & (readings.repeat == readings.repeat[mine][0])]
    moved = places[-1] - places[0]
    signs = np.where(np.abs(moved) > _OUTSIDE * np.array(description.step), np.sign(moved), 0.0)
    if (np.abs(places[0] + moved - run.start - run.motion) + np.abs(places[0] - run.start)).max() < 1e-6:
        return ""
    return (
        f"its places run from {_vector(places[0])} to {_vector(places[-1])} m, direction {_vector(signs)}, and stated "
        f"are {_vector(run.start)} to {_vector(run.start + run.motion)} m, direction {_vector(run.sign)}"
    )


def _counted(steps: Array) -> set[tuple[float, ...]]:
    """Places in whole steps."""
    return set(map(tuple, np.round(steps).tolist()))


def _vector(values: Iterable[float]) -> str:
    return f"[{', '.join(f'{round(v, 9) + 0.0:.6g}' for v in values)}]"


def _off_halts(session: Session) -> Array:
    """(n,) positions off the halts that a diagonal has by the order of moves in its id, in shares of the step.

    Each reading has the mean of its setup: the two thirds of the halts at which one order differs from another
    decide.
    """
    description, readings = session.description.as_a(StepDiagonal), session.readings
    off, points = np.zeros(len(readings)), readings.position()
    for index, setup in enumerate(description.setups):
        mine = readings.setup == index
        if setup.name_and_order[0] != setup.id and mine.any():
            halts = halts_of(setup, description)
            off[mine] = np.linalg.norm(points[mine][:, None] - halts, axis=2).min(axis=1).mean()
    return off / min(description.step)
