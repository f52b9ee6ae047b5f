# SPDX-License-Identifier: Apache-2.0
"""The readings of one or several sessions below each other, as a diagnosis sees them."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from machine_tool_calibration.arrays import Array, IntArray
from machine_tool_calibration.estimation.reduction import Projected
from machine_tool_calibration.model.fit import JointFit, screen_joint
from machine_tool_calibration.model.model import Parameter, Term
from machine_tool_calibration.model.observations import Observations
from machine_tool_calibration.model.reproducibility import reproducibility

__all__ = ["Pool"]


@dataclass(frozen=True)
class Pool:
    """All readings of a fit.

    Attributes:
        fit: of one or several sessions.
    """

    fit: JointFit

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

    @cached_property
    def sigma(self) -> Array:
        """(n,) declared standard uncertainty, m."""
        return np.concatenate([model.sigma for model in self.fit.assembly.models])

    @cached_property
    def residuals(self) -> Array:
        """(n,) measured minus predicted, m."""
        return np.concatenate([fit.residuals for fit in self.fit.fits])

    @cached_property
    def run(self) -> IntArray:
        """(n,) runs, numbered over all sessions."""
        out, first = [], 0
        for o in self.observations:
            out.append(o.run + first)
            first += int(o.run.max(initial=-1)) + 1
        return np.concatenate(out)

    @cached_property
    def setup(self) -> IntArray:
        """(n,) setups, numbered over all sessions as in `setup_names`."""
        counts = np.cumsum([0, *(len(o.session.setup_ids) for o in self.observations)])
        return np.concatenate([o.readings.setup + first for o, first in zip(self.observations, counts, strict=False)])

    @cached_property
    def setup_names(self) -> tuple[str, ...]:
        """Ids of all sessions' setups, with the session's name where there are several."""
        return tuple(self.label(k) + name for k, o in enumerate(self.observations) for name in o.session.setup_ids)

    @cached_property
    def position(self) -> Array:
        """(n, 3) nominal functional points, m."""
        return np.concatenate([o.position for o in self.observations])

    def label(self, index: int) -> str:
        """Name of a session, to be put before what is its own; empty if there is only one."""
        labels = self.fit.assembly.labels
        return f"{labels[index]}: " if labels is not None and len(self.observations) > 1 else ""

    @cached_property
    def spread(self) -> tuple[Array, IntArray, tuple[str, ...]]:
        """(u, n) columns of what does not reproduce, the family of each, and the families' names."""
        every = [reproducibility(o) for o in self.observations]
        names = tuple(dict.fromkeys(family.name for own in every for family in own))[:3]
        columns, place = [np.zeros((0, len(self)))], [np.zeros(0, dtype=np.int64)]
        for own, piece in zip(every, self.pieces, strict=True):
            for family in own:
                if family.name in names:
                    mine = family.columns()
                    columns.append(self.only(mine * self.sigma[piece], piece))
                    place.append(np.full(len(mine), names.index(family.name), dtype=np.int64))
        return np.concatenate(columns), np.concatenate(place), names

    def only(self, columns: Array, piece: slice) -> Array:
        """(k, n) columns of one session's readings, zero elsewhere."""
        out = np.zeros((len(columns), len(self)))
        out[:, piece] = columns
        return out

    def screen(self, columns: Array) -> Projected:
        """What the fit leaves of (k, n) further columns.

        The squared norms before count within the runs: a constant of a run is its datum, and an effect counts by how it
        varies.
        """
        shared = tuple(Parameter(f"{k}", "1", shared=True) for k in range(len(columns)))
        terms: Sequence[Sequence[Term]] = [[Term("columns", shared, columns[:, piece])] for piece in self.pieces]
        return screen_joint(self.fit, terms)

    def within_runs(self, columns: Array) -> Array:
        """(k,) squared norms of columns over the declared uncertainty, without the mean of each run."""
        scaled = columns / self.sigma
        count = np.maximum(np.bincount(self.run), 1)
        out = np.empty(len(scaled))
        for k, column in enumerate(scaled):
            out[k] = np.sum((column - (np.bincount(self.run, column) / count)[self.run]) ** 2)
        return out
