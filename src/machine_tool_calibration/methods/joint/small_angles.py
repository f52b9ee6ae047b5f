# SPDX-License-Identifier: Apache-2.0
"""Angular errors that a step diagonal takes for small random functions, as the machine's: shared by all sessions.

A step diagonal by itself has them as unknowns of its own (`step_diagonal.small_angles`). They are the machine's: by
their lever arms they also move the functional point in the other sessions' readings and everywhere in the map. So in a
fit of several sessions they are tables like all others, with what is expected of them beside the readings: each a
smooth random function of its axis's position that is zero next to the axis's zero, all of one size and shape. What is
possible for these is drawn from the readings of all sessions, and what is published is the mean over it.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.methods.step_diagonal.model import StepDiagonalModel
from machine_tool_calibration.methods.step_diagonal.small_angles import (
    LARGEST,
    NONE,
    SMALLEST,
    AngularPosterior,
    SmallAngles,
    angular_priors,
    mean_shape,
)
from machine_tool_calibration.model.fit import JointFit, fit_models
from machine_tool_calibration.model.model import MethodModel, NotDetermined
from machine_tool_calibration.model.rigid_body import MachineTable
from machine_tool_calibration.words import say

# Share of the variance expected of an angle, over all its nodes, that must go before the readings determine it.
_VARIANCE_REMOVED = 0.5
# Probability of angular errors above which differences between sessions may have been taken for them.
_LIKELY = 0.5


@dataclass(frozen=True)
class PublishedAngles:
    """Angular errors of all sessions as they are published: the mean over all their sizes and shapes."""

    size: float  # root mean square of the angular errors over all that is possible, rad
    probability: float  # that they are not zero
    not_determined: tuple[NotDetermined, ...]  # those of which the readings say little more than the size

    def hiding(self, statement: str) -> str:
        """An agreement of sessions, with what it does not mean where angular errors explain as much.

        A rotation of the mirror looks like straightness to a step diagonal in every order of its moves (ECX
        like EYX).
        """
        if self.probability < _LIKELY:
            return statement
        return say("agreement.hidden", what=statement, size=f"{1e6 * self.size:.2g}")


def angles_of(model: MethodModel) -> tuple[MachineTable, ...]:
    """Tables of the angular errors that a model takes for small random functions."""
    spread = model.spread if isinstance(model, StepDiagonalModel) else None
    return () if spread is None else spread.tables


def in_words(angles: Sequence[MachineTable]) -> str:
    """What is assumed of these angular errors."""
    names = ", ".join(table.name for table in angles)
    return say("datum.random", names=names, p=f"{NONE:g}", low=f"{1e6 * SMALLEST:g}", high=f"{1e6 * LARGEST:g}")


def without_spread(model: MethodModel) -> MethodModel:
    """The model without angular errors of its own."""
    if not isinstance(model, StepDiagonalModel) or model.spread is None:
        return model
    return replace(model.without({name for names in model.spread.names for name in names}), spread=None)


def expected(models: Sequence[MethodModel], angles: Sequence[MachineTable]) -> tuple[MethodModel, ...]:
    """The models, knowing that these angular errors are smooth and at most of the largest size that is considered."""
    return _with_priors(models, angles, {t.name: LARGEST**2 * mean_shape(t.nodes, _zero(t)) for t in angles})


def with_estimated_angles(
    models: Sequence[MethodModel], labels: Sequence[str], angles: Sequence[MachineTable]
) -> tuple[MethodModel, ...]:
    """The models with the size and shape of the angular errors that all readings together determine."""
    if not angles:
        return tuple(models)
    found = _posterior(fit_models(models, labels, random_of(angles)))
    return _with_priors(models, angles, {t.name: c for t, c in zip(angles, found.priors, strict=True)})


def random_of(angles: Sequence[MachineTable]) -> SmallAngles | None:
    """These angular errors as unknowns that are random functions; None without any."""
    if not angles:
        return None
    return SmallAngles(
        tuple(label for table in angles for label in table.labels),
        tuple((table.nodes, _zero(table)) for table in angles),
    )


def published_angles(fit: JointFit, angles: Sequence[MachineTable]) -> PublishedAngles | None:
    """What is published of the angular errors: the mean over all that is possible; None without any, or restated."""
    if not angles or fit.given is not None:
        return None
    found = _posterior(fit)
    place = {parameter.name: k for k, parameter in enumerate(fit.assembly.parameters)}
    variance = np.diag(fit.published.covariance)
    not_determined = []
    for table, prior in zip(angles, found.priors, strict=True):
        if variance[[place[label] for label in table.labels]].sum() > _VARIANCE_REMOVED * np.trace(prior):
            not_determined.append(NotDetermined(table.name, say("undetermined.hardly_more")))
    return PublishedAngles(found.size, found.probability, tuple(not_determined))


def _posterior(fit: JointFit) -> AngularPosterior:
    found = fit.marginal.random
    assert isinstance(found, AngularPosterior)
    return found


def _zero(table: MachineTable) -> int:
    """The node at which the datum of tables has it zero; a constant angle is squareness and slopes of others."""
    return int(np.argmin(np.abs(table.nodes)))


def _with_priors(
    models: Sequence[MethodModel], angles: Sequence[MachineTable], covariances: Mapping[str, Array]
) -> tuple[MethodModel, ...]:
    """The models with what is known of each angle, said once: by the first model that has it."""
    labels = {label for table in angles for label in table.labels}
    out, pending = [], list(angles)
    for model in models:
        own = {parameter.name for parameter in model.parameters}
        mine = [table for table in pending if set(table.labels) <= own]
        pending = [table for table in pending if table not in mine]
        kept = tuple(prior for prior in model.priors if not labels & set(prior.weights))
        found = angular_priors([table.labels for table in mine], [covariances[table.name] for table in mine])
        out.append(replace(model, priors=kept + found))
    return tuple(out)
