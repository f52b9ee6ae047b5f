# SPDX-License-Identifier: Apache-2.0
"""Position errors of every place by itself: what is read of a machine of whose axes nothing is taken for granted."""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from machine_tool_calibration.arrays import Array, BoolArray, IntArray, rigid_motions
from machine_tool_calibration.errors import ModelError
from machine_tool_calibration.machine.chain import Chain
from machine_tool_calibration.model.model import Constraint, Kind, Parameter
from machine_tool_calibration.model.observations import Observations
from machine_tool_calibration.model.rigid_body import MachineTable
from machine_tool_calibration.session.session import distinct_places

# Unknowns that are solved within seconds; a plate of 40 x 40 places has as many.
_MOST = 3200


@dataclass(frozen=True)
class PointErrors(MachineTable):
    """The position errors along one machine axis of all places that were read, each an unknown of its own.

    Its name is ex, ey or ez, and its nodes (k, 3) are the places, m.
    """

    is_rotation = is_straightness = False

    @cached_property
    def parameters(self) -> tuple[Parameter, ...]:
        """The unknowns, `ex(0.1, 0.2, 0)`."""
        names = (f"{self.name}({', '.join(f'{v:.6g}' for v in place + 0.0)})" for place in np.round(self.nodes, 9))
        return tuple(Parameter(name, "m", kind=Kind.POINTS, owner=self.name) for name in names)

    def field(self, position: Array) -> Array:
        """(n, 3) the axis's direction."""
        return np.repeat(np.eye(3)[["xyz".index(self.name[1])]], len(position), axis=0)

    def weights(self, position: Array) -> Array:
        """(k, n) 1 where a position is the place."""
        _, place = distinct_places(np.concatenate([self.nodes, position]))
        return np.equal.outer(place[: len(self.nodes)], place[len(self.nodes) :]).astype(np.float64)


def point_errors(chain: Chain, position: Array, sensed: BoolArray) -> tuple[PointErrors, ...]:
    """The errors of the places of readings (n, 3) along those axes that are `sensed` (3,); ModelError if too many."""
    places = position[distinct_places(position)[0]]
    axes = [axis for axis, seen in zip("xyz", sensed, strict=True) if seen]
    if len(places) * len(axes) > _MOST:
        most, n = _MOST // len(axes), len(places)
        raise ModelError(f"the model 'free' takes {most} places at most, and {n} were read: use rigid_body")
    return tuple(PointErrors(chain, f"e{axis}", places) for axis in axes)


def point_datum(points: tuple[PointErrors, ...], observed: Observations, setup: IntArray) -> Iterator[Constraint]:
    """No common shift or turn of all places, then none of those of a setup: what setups may leave open of them."""
    if not points:
        return
    places = points[0].nodes
    motions = rigid_motions(places - places.mean(axis=0))
    every = np.ones(len(places), dtype=bool)
    read = [np.asarray(points[0].weights(observed.position[setup == s]).any(axis=1)) for s in np.unique(setup)]
    for mine in (every, *read):
        for motion in np.where(mine[:, None, None], motions, 0.0).transpose(2, 0, 1):
            found = {
                parameter.name: float(moved)
                for one in points
                for parameter, moved in zip(one.parameters, motion[:, "xyz".index(one.name[1])], strict=True)
                if abs(moved) > 1e-12
            }
            if found:
                yield Constraint(found)
