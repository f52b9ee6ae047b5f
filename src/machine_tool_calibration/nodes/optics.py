# SPDX-License-Identifier: Apache-2.0
"""What a simulated interferometer looks at in each method: a retroreflector on the tool or on the table, or a mirror.

A target is where the light turns round; its path is computed from the true geometry at that moment.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.errors import CalibrationError
from machine_tool_calibration.nodes.site import Beam, Moment, Site
from machine_tool_calibration.procedure.steps import diagonal_positions, sensing_direction
from machine_tool_calibration.session.catalogue import method_spec
from machine_tool_calibration.session.description import (
    Description,
    Direct,
    RotaryAxis,
    StepDiagonal,
    TrackingInterferometer,
)
from machine_tool_calibration.session.method import load
from machine_tool_calibration.simulation.sensors import mirror_path, tilted

_LASER = 0.3  # m from the laser to a flat mirror at the start of its run


@dataclass(frozen=True)
class Pose:
    """Where a body is at a time: (3,) place, m, and (3, 3) rotation."""

    stamp: int
    place: Array
    rotation: Array


@dataclass(frozen=True)
class Look:
    """What effects need to know of a reading: (3,) direction, azimuth and incidence in rad."""

    direction: Array
    azimuth: float
    incidence: float


class Optics(ABC):
    """How the instrument sees its target: by default a fixed beam, wide enough, on what the tool carries.

    Attributes:
        body: whose true pose counts: `functional_point` or `table`.
        aims: whether a pointer directs the beam; otherwise it is fixed for each setup, and no beam is told.
    """

    body = "functional_point"
    aims = False

    def target(self, pose: Pose, beam: Beam, moment: Moment) -> Array:
        """(3,) where the target is, m, machine frame."""
        return pose.place

    @abstractmethod
    def paths(self, targets: Array, pose: Pose, beam: Beam, moment: Moment) -> Array:
        """(n,) geometric paths to targets (n, 3), m; `pose` is the newest."""

    def beside(self, target: Array, beam: Beam) -> float:
        """How far the target is off the beam, m; 0 where the beam follows it or is wide enough."""
        return 0.0

    @abstractmethod
    def look(self, target: Array, pose: Pose, beam: Beam, moment: Moment) -> Look:
        """The direction of a reading."""


class OnTool(Optics):
    """A retroreflector on the spindle, a pointer at a station: open loop, or with a beam that follows."""

    aims = True

    def __init__(self, site: Site, tracking: bool) -> None:
        self._site, self.tracking = site, tracking
        self._middle = [0.5 * sum(site.travel.get(axis, (0.0, 0.0))) for axis in "xyz"]

    def paths(self, targets: Array, pose: Pose, beam: Beam, moment: Moment) -> Array:
        """See `Optics`; held on its direction the beam senses the projection (cosine error)."""
        line = targets - beam.origin
        return np.asarray(np.linalg.norm(line, axis=1) if self.tracking else line @ beam.direction)

    def beside(self, target: Array, beam: Beam) -> float:
        """See `Optics`."""
        return 0.0 if self.tracking else float(beam.off(target))

    def look(self, target: Array, pose: Pose, beam: Beam, moment: Moment) -> Look:
        """See `Optics`."""
        line = target - beam.origin
        direction = line / np.linalg.norm(line) if self.tracking else beam.direction
        azimuth = float(np.arctan2(direction[1], direction[0]))
        azimuth -= 0.0 if self.tracking else self._site.pointer.zero_offset
        facing = np.arctan2(self._middle[1] - beam.origin[1], self._middle[0] - beam.origin[0])
        return Look(direction, azimuth, float(np.angle(np.exp(1j * (azimuth - facing)))))


class OnTable(Optics):
    """Retroreflectors on a rotary table, a tracker at a station; the one nearest to the beam is followed."""

    body, aims = "table", True

    def __init__(self, site: Site, description: RotaryAxis) -> None:
        self._site = site
        self._targets = np.array([site.target(target, k) for k, target in enumerate(description.targets)])
        self._axis = site.table_axis

    def target(self, pose: Pose, beam: Beam, moment: Moment) -> Array:
        """See `Optics`."""
        disturbance = self._site.live.disturbance(self._site.scene(moment))
        places = disturbance.grown(self._targets, self._axis) @ pose.rotation.T + pose.place
        is_ahead = (places - beam.origin) @ beam.direction > 0
        return np.asarray(places[np.argmin(np.where(is_ahead, beam.off(places), np.inf))])

    def paths(self, targets: Array, pose: Pose, beam: Beam, moment: Moment) -> Array:
        """See `Optics`."""
        return np.asarray(np.linalg.norm(targets - beam.origin, axis=1))

    def beside(self, target: Array, beam: Beam) -> float:
        """See `Optics`: a tracker finds its target near where it is sent."""
        return float(beam.off(target))

    def look(self, target: Array, pose: Pose, beam: Beam, moment: Moment) -> Look:
        """See `Optics`; the retroreflectors turn with the table."""
        line = target - beam.origin
        i, j = (("ABC".index(self._axis) + k) % 3 for k in (1, 2))
        turned = float(np.arctan2(pose.rotation[j, i], pose.rotation[i, i]))
        incidence = float(np.arctan2(line[j], line[i])) - turned
        return Look(line / np.linalg.norm(line), float(np.arctan2(line[1], line[0])), incidence)


class FlatMirror(Optics):
    """A flat mirror on the spindle; the laser is aligned on the actual diagonal motion of its setup."""

    def __init__(self, site: Site, description: StepDiagonal) -> None:
        self._site, self._description = site, description
        self._made: dict[int, tuple[Array, Array, Array]] = {}

    def _setup(self, moment: Moment) -> tuple[Array, Array, Array]:
        """Source and direction of the beam, and the mirror's normal in the spindle's frame."""
        if moment.setup not in self._made:
            run = diagonal_positions(self._description, moment.setup)
            ends = np.array([[run[k][axis] for axis in "xyz"] for k in (0, -1)])
            first, last = self._site.machine.functional_point(ends)
            beam = (last - first) / np.linalg.norm(last - first)
            disturbance = self._site.live.disturbance(self._site.scene(moment))
            off = self._site.mirror_tilt(moment.setup) + disturbance.mirror
            normal = tilted(beam[None], np.atleast_2d(off))[0]
            fixed = self._site.machine.tool_rotation(ends[:1])[0].T @ normal
            self._made[moment.setup] = first - _LASER * beam, beam, fixed
        return self._made[moment.setup]

    def paths(self, targets: Array, pose: Pose, beam: Beam, moment: Moment) -> Array:
        """See `Optics`."""
        source, direction, fixed = self._setup(moment)
        return mirror_path(source, direction, targets, pose.rotation @ fixed)

    def look(self, target: Array, pose: Pose, beam: Beam, moment: Moment) -> Look:
        """See `Optics`."""
        return Look(self._setup(moment)[1], 0.0, 0.0)


class Along(Optics):
    """A linear interferometer, aligned with the axis that moves."""

    def __init__(self, site: Site, description: Direct) -> None:
        self._direction = sensing_direction(description)

    def paths(self, targets: Array, pose: Pose, beam: Beam, moment: Moment) -> Array:
        """See `Optics`."""
        return targets @ self._direction

    def look(self, target: Array, pose: Pose, beam: Beam, moment: Moment) -> Look:
        """See `Optics`."""
        return Look(self._direction, 0.0, 0.0)


def make_optics(site: Site, description: Description) -> Optics:
    """The optics of a session's method.

    Raises:
        CalibrationError: the method has no interferometer.
    """
    maker = method_spec(description.method).optics
    if maker is None:
        raise CalibrationError(f"no interferometer measures a {description.method} session")
    optics: Optics = load(maker)(site, description)
    return optics


def on_tool(site: Site, description: TrackingInterferometer) -> OnTool:
    """The optics of a tracking interferometer."""
    return OnTool(site, description.pointing == "tracking")
