# SPDX-License-Identifier: Apache-2.0
"""Functions of the readings beside a model's unknowns: what does not reproduce, and what only widens the uncertainty.

The latter are what every model lacks a little (`model.imperfection`), and the difference between an effect in the model
and one that the readings do not distinguish from it. If that one is true, the readings differ by so much from what the
model says, and the model's unknowns are off by what they take of it.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from machine_tool_calibration.arrays import Array, BoolArray, IntArray
from machine_tool_calibration.estimation.problem import Problem
from machine_tool_calibration.estimation.variance_components import WidenedPart
from machine_tool_calibration.model.imperfection import IMPERFECT, imperfection
from machine_tool_calibration.model.model import MethodModel
from machine_tool_calibration.model.observations import Observations
from machine_tool_calibration.model.reproducibility import Family, with_drift

ALTERNATIVE = "alternative"
"""Name of the family of differences between effects in the model and others."""

BESIDE = ""
"""What stands for the effect in the model where another one may be there beside all of them."""


@dataclass(frozen=True)
class Alternatives:
    """What the readings would be if effects in the model were others that the readings do not distinguish from them."""

    effects: tuple[tuple[str, str], ...]  # the k effects in the model, or `BESIDE`, each with another in its place
    differences: tuple[Array, ...]  # per session, (k, n) what changes in the readings, m, if that one is true instead
    probability: Array  # (k,) that it is; of those in the place of one effect one is true at most

    def of(self, effect: str) -> dict[str, float]:
        """What an effect may be instead, with the probability of each."""
        pairs = zip(self.effects, self.probability.tolist(), strict=True)
        return {other: share for (own, other), share in pairs if own == effect}


@dataclass(frozen=True)
class Widened:
    """A problem with the coefficients of such functions as further unknowns, the last ones."""

    problem: Problem
    family: IntArray  # (u,) family of each coefficient
    names: tuple[str, ...]  # of the families
    offsets: BoolArray  # (u,) which functions are offsets of their group
    functions: tuple[Array, ...]  # per session, (k, n) columns of its coefficients, m
    shared: int  # of the coefficients the last ones, which all sessions have in common

    def of(self, *names: str) -> BoolArray:
        """(u,) the coefficients of some families."""
        return np.array([self.names[k] in names for k in self.family], dtype=bool)


def with_functions(
    problem: Problem, models: Sequence[MethodModel], imperfect: bool, alternatives: Alternatives | None
) -> Widened:
    """A problem with the functions of its sessions, those `imperfect` and `alternatives` where these are wanted."""
    observed = [model.observations for model in models]
    # Rows of a plate that differ are the part's, as far as the map is concerned.
    families = [with_drift(one) + (_imperfect(one) if imperfect else ()) for one in observed]
    named = dict.fromkeys(family.name for own in families for family in own)
    names = sorted(named, key=lambda name: name == IMPERFECT)  # that one last, as it is no size to be found
    parts, place, first = [], [np.zeros(0, dtype=np.int64)], problem.size
    for part, own in zip(problem.parts, families, strict=True):
        if own:
            part = WidenedPart(part, [(family.group, family.shapes) for family in own], first)
            first += part.count
            place += [np.full(f.count * len(f.shapes), names.index(f.name), dtype=np.int64) for f in own]
        parts.append(part)
    functions = [
        np.concatenate([np.zeros((0, len(model.sigma))), *(f.columns() * model.sigma for f in own)])
        for own, model in zip(families, models, strict=True)
    ]
    shared = 0 if alternatives is None else len(alternatives.probability)
    if alternatives is not None:
        for k, (model, differences) in enumerate(zip(models, alternatives.differences, strict=True)):
            group = np.zeros(len(model.sigma), dtype=np.int64)
            parts[k] = WidenedPart(parts[k], [(group, differences / model.sigma)], first)
            functions[k] = np.concatenate([functions[k], differences])
        place.append(np.full(shared, len(names), dtype=np.int64))
        names.append(ALTERNATIVE)
    offsets = [np.zeros(0, dtype=bool), *(f.offsets for own in families for f in own), np.zeros(shared, dtype=bool)]
    u = sum(map(len, place))
    wide = Problem(
        parts,
        problem.size + u,
        np.pad(problem.constraints, ((0, 0), (0, u))),
        problem.constraint_values,
        problem.priors and replace(problem.priors, columns=np.pad(problem.priors.columns, ((0, 0), (0, u)))),
    )
    return Widened(wide, np.concatenate(place), tuple(names), np.concatenate(offsets), tuple(functions), shared)


def _imperfect(observations: Observations) -> tuple[Family, ...]:
    shapes = imperfection(observations)
    return (Family(IMPERFECT, np.zeros(len(observations), dtype=np.int64), shapes),) if len(shapes) else ()
