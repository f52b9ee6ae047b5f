# SPDX-License-Identifier: Apache-2.0
"""The readings of one or several sessions below each other, as a diagnosis sees them."""

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from machine_tool_calibration.arrays import Array, IntArray, groups, means_of
from machine_tool_calibration.errors import ModelError
from machine_tool_calibration.estimation import priors
from machine_tool_calibration.estimation.reduction import Projected
from machine_tool_calibration.estimation.serial_correlation import Memory, memory_of
from machine_tool_calibration.model.fit import JointFit, changed, screen_columns
from machine_tool_calibration.model.imperfection import IMPERFECT, imperfection
from machine_tool_calibration.model.observations import Observations, neighbours_of
from machine_tool_calibration.model.reproducibility import Family, reproducibility
from machine_tool_calibration.residuals.averaged import own_of_places
from machine_tool_calibration.session.catalogue import spec_of

# Standard uncertainties below which the signal of a random function of the largest size does not show.
_LEAST_SIGNAL = 0.3


@dataclass(frozen=True)
class Pool:
    """All readings of a fit."""

    fit: JointFit  # of one or several sessions
    # (k, n) by what effects in the model may differ from their laws, m per standard deviation; None where they are not
    laws: Array | None = field(default=None, compare=False)

    @cached_property
    def observations(self) -> tuple[Observations, ...]:
        """Those of each session."""
        return tuple(model.observations for model in self.fit.assembly.models)

    @cached_property
    def pieces(self) -> tuple[slice, ...]:
        """Where each session's readings are."""
        ends = np.cumsum([0, *(len(o) for o in self.observations)]).tolist()
        return tuple(slice(a, b) for a, b in itertools.pairwise(ends))

    def __len__(self) -> int:
        return sum(len(o) for o in self.observations)

    @property
    def side_by_side(self) -> bool:
        """Whether many effects are expected at once: the machine itself is read."""
        return self.fit.reads_machine

    @cached_property
    def sigma(self) -> Array:
        """(n,) declared standard uncertainty, m."""
        return np.concatenate([model.sigma for model in self.fit.assembly.models])

    @cached_property
    def residuals(self) -> Array:
        """(n,) measured minus predicted, m."""
        return np.concatenate([fit.residuals for fit in self.fit.fits])

    def residuals_beside(self, change: Array) -> Array:
        """(n,) measured minus predicted, m, of the fit to the readings without a change of these, m."""
        fit, shifts = self.fit.without_random, [-change[piece] for piece in self.pieces]
        curved = change.any() and not all(part.linear for part in fit.assembly.problem.parts)
        try:  # by more than a step: what is displaced may have moved unknowns far along directions that hardly show
            fit = changed(fit, shifts, again=bool(curved))
        except ModelError:
            fit = changed(fit, shifts)
        return np.concatenate([own.residuals for own in fit.fits]) - change

    def memory(self, residuals: Array) -> Memory:
        """What residuals (n,), m, say of the noise's memory."""
        before, after = neighbours_of(self.observations)
        return memory_of(residuals / self.sigma, before, after, self.fit.without_random.solution.degrees_of_freedom)

    @cached_property
    def run(self) -> IntArray:
        """(n,) runs, numbered over all sessions."""
        counts = np.cumsum([0, *(int(o.run.max(initial=-1)) + 1 for o in self.observations)])
        return np.concatenate([o.run + first for o, first in zip(self.observations, counts, strict=False)])

    @cached_property
    def setup(self) -> IntArray:
        """(n,) setups, numbered over all sessions as in `setup_names`."""
        counts = np.cumsum([0, *(len(o.session.setup_ids) for o in self.observations)])
        return np.concatenate([o.readings.setup + first for o, first in zip(self.observations, counts, strict=False)])

    @cached_property
    def setup_names(self) -> tuple[str, ...]:
        """Ids of all sessions' setups, with the session's name where there are several."""
        return tuple(self.label(k) + name for k, o in enumerate(self.observations) for name in o.session.setup_ids)

    def label(self, index: int) -> str:
        """Name of a session, to be put before what is its own; empty if there is only one."""
        labels = self.fit.assembly.labels
        return f"{labels[index]}: " if labels is not None and len(self.observations) > 1 else ""

    @cached_property
    def spread(self) -> tuple[Array, IntArray, tuple[str, ...]]:
        """(u, n) columns of what does not reproduce, the family of each, and the families' names.

        Functions of known sizes are the last families, in units of their own: what every model lacks a little, what
        laws leave open, and unknowns of the model that are random functions.
        """
        pairs = zip(self.fit.fits, self.observations, strict=True)
        every = [(*_offsets_apart(reproducibility(o), o), *own_of_places(fit)) for fit, o in pairs]
        names = tuple(dict.fromkeys(family.name for own in every for family in own))
        columns, place = [np.zeros((0, len(self)))], [np.zeros(0, dtype=np.int64)]
        for own, piece in zip(every, self.pieces, strict=True):
            for family in own:
                mine = family.columns()
                columns.append(self.only(mine * self.sigma[piece], piece))
                place.append(np.full(len(mine), names.index(family.name), dtype=np.int64))
        for further, name, _ in self._of_known_size:
            columns.append(further)
            place.append(np.full(len(further), len(names), dtype=np.int64))
            names = (*names, name)
        return np.concatenate(columns), np.concatenate(place), names

    @cached_property
    def _of_known_size(self) -> list[tuple[Array, str, dict[float, float]]]:
        """(k, n) columns of functions of known sizes, what they are, and these with their probabilities beforehand.

        What every model lacks a little, what laws leave open, and unknowns of the model that are random functions.
        """
        pairs, random = zip(self.observations, self.pieces, strict=True), self.fit.random
        imperfect = np.concatenate([self.only(imperfection(o) * self.sigma[piece], piece) for o, piece in pairs])
        every = [(imperfect, IMPERFECT, priors.IMPERFECTION_SIZES)]
        if self.laws is not None:
            every.append((self.laws, "laws", priors.LAW_SIZES))
        if random is not None:
            shown = _shown(random.root.T @ self._columns_of(random.names), self.sigma / max(random.sizes))
            every.append((shown, "random functions", random.sizes))
        return [(columns, name, sizes) for columns, name, sizes in every if len(columns)]

    @property
    def sizes(self) -> tuple[dict[float, float], ...]:
        """Sizes of functions of which they are known, with their probabilities before any reading, by family."""
        return tuple(sizes for _, _, sizes in self._of_known_size)

    def _columns_of(self, names: Sequence[str]) -> Array:
        """(q, n) change of each reading per unit of unknowns of the model's terms."""
        assembly = self.fit.assembly
        place = {parameter.name: k for k, parameter in enumerate(assembly.parameters)}
        wanted = [place[name] for name in names]
        out = np.zeros((len(wanted), len(self)))
        for model, where, piece in zip(assembly.models, assembly.places, self.pieces, strict=True):
            _, rows, own = np.intersect1d(wanted, where[len(model.own) :], return_indices=True)
            out[rows, piece] = model.dense()[own]
        return out

    def only(self, columns: Array, piece: slice) -> Array:
        """(k, n) columns of one session's readings, zero elsewhere."""
        out = np.zeros((len(columns), len(self)))
        out[:, piece] = columns
        return out

    def screen(self, columns: Array, *, random: bool = False) -> Projected:
        """What the fit leaves of (k, n) further columns, m; `random` unknowns take their share if they are to."""
        fit = self.fit if random else self.fit.without_random
        return screen_columns(fit, [columns[:, piece] for piece in self.pieces])

    def within_runs(self, columns: Array) -> Array:
        """(k,) squared norms of columns over the declared uncertainty, without the mean of each run."""
        run, scaled = groups(self.run), columns / self.sigma
        return np.array([np.sum((column - means_of(run, column)) ** 2) for column in scaled])


def _offsets_apart(families: Sequence[Family], observations: Observations) -> Iterator[Family]:
    """Those of runs that a machine is read in, with a family of its own for offsets that no setup has.

    A part that is touched, or a zero that is taken anew, is no drift within the runs, and says nothing of one.
    """
    setups = len(np.unique(observations.readings.setup))
    for family in families:
        apart = family.name == "run" and family.count > setups and family.offsets_of_each < len(family.shapes)
        if apart and spec_of(observations.session).reads_machine:
            yield replace(family, name="run offsets", shapes=family.shapes[: family.offsets_of_each])
            family = replace(family, shapes=family.shapes[family.offsets_of_each :], offsets_of_each=0)
        yield family


def _shown(columns: Array, sigma: Array) -> Array:
    """(k, n) columns of independent coefficients of size 1 in directions of their own, without those that do not show.

    From columns (r, n) of coefficients that are independent and alike; to show is to exceed `sigma` (n,) per unit.
    """
    _, size, readings = np.linalg.svd(columns / sigma, full_matrices=False)
    kept = size > _LEAST_SIGNAL
    return np.asarray(size[kept, None] * readings[kept] * sigma)
