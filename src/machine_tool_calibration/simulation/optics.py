# SPDX-License-Identifier: Apache-2.0
"""What a simulated interferometer looks at in each method: a retroreflector on the tool or on the table, or a mirror.

A target is where the light turns round; its path is computed from the true geometry at that moment.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.errors import CalibrationError
from machine_tool_calibration.session import description as sessions
from machine_tool_calibration.simulation import rotary_run, tracking_run
from machine_tool_calibration.simulation.flaw import Sight
from machine_tool_calibration.simulation.scene import Scene
from machine_tool_calibration.simulation.sensors import mirror_path, tilted
from machine_tool_calibration.simulation.site import Beam, Site


@dataclass(frozen=True)
class Pose:
    """Where a body is at a time: (3,) place, m, and (3, 3) rotation."""

    stamp: int
    place: Array
    rotation: Array


class Optics(ABC):
    """How the instrument sees its target: by default a fixed beam, wide enough, on what the tool carries."""

    body = "functional_point"  # whose true pose counts: this, or the `table`
    aims = False  # whether a pointer directs the beam; otherwise it is fixed for each setup, and no beam is told

    def target(self, pose: Pose, beam: Beam, moment: Scene) -> Array:
        """(3,) where the target is, m, machine frame."""
        return pose.place

    @abstractmethod
    def sight(self, targets: Array, pose: Pose, beam: Beam, moment: Scene) -> Sight:
        """What is read of targets (n, 3), m; `pose` is the newest."""

    def beside(self, target: Array, beam: Beam) -> float:
        """How far the target is off the beam, m; 0 where the beam follows it or is wide enough."""
        return 0.0


class OnTool(Optics):
    """A retroreflector on the spindle, a pointer at a station: open loop, or with a beam that follows."""

    aims = True

    def __init__(self, site: Site, description: sessions.TrackingInterferometer | None = None) -> None:
        self._zero_offset = site.spec.pointer.zero_offset
        self._dimension = 2 if description is None else description.dimension
        self._follows = description is not None and description.pointing == "tracking"

    def sight(self, targets: Array, pose: Pose, beam: Beam, moment: Scene) -> Sight:
        """See `Optics`; held on its direction the beam senses the projection (cosine error)."""
        if self._follows:
            line = targets - beam.origin
            return tracking_run.sighted(targets, beam.origin, np.arctan2(line[:, 1], line[:, 0]), self._dimension)
        held = np.broadcast_to(beam.direction, targets.shape)
        commanded = np.arctan2(held[:, 1], held[:, 0]) - self._zero_offset
        return tracking_run.sighted(targets, beam.origin, commanded, self._dimension, held)

    def beside(self, target: Array, beam: Beam) -> float:
        """See `Optics`."""
        return 0.0 if self._follows else float(beam.off(target))


class _OnTable(Optics):
    """Retroreflectors on a rotary table, a tracker at a station; the one nearest to the beam is followed."""

    body, aims = "table", True

    def __init__(self, site: Site, description: sessions.RotaryAxis) -> None:
        self._site = site
        self._targets = np.array([site.target(target, k) for k, target in enumerate(description.targets)])

    def target(self, pose: Pose, beam: Beam, moment: Scene) -> Array:
        grown = self._site.disturbance(moment).grown(self._targets, self._site.table_axis)
        places = grown @ pose.rotation.T + pose.place
        is_ahead = (places - beam.origin) @ beam.direction > 0
        return np.asarray(places[np.argmin(np.where(is_ahead, beam.off(places), np.inf))])

    def sight(self, targets: Array, pose: Pose, beam: Beam, moment: Scene) -> Sight:
        axis = self._site.table_axis
        i, j = (("ABC".index(axis) + k) % 3 for k in (1, 2))
        turned = np.full(len(targets), np.arctan2(pose.rotation[j, i], pose.rotation[i, i]))
        return rotary_run.sighted(targets, beam.origin, axis, turned)

    def beside(self, target: Array, beam: Beam) -> float:
        """See `Optics`: a tracker finds its target near where it is sent."""
        return float(beam.off(target))


class _FlatMirror(Optics):
    """A flat mirror on the spindle; the laser is aligned on the actual diagonal motion of its setup."""

    def __init__(self, site: Site, description: sessions.StepDiagonal) -> None:
        self._site, self._description = site, description
        self._made: dict[int, tuple[Array, Array, Array]] = {}

    def _setup(self, moment: Scene) -> tuple[Array, Array, Array]:
        """Source and direction of the beam, and the mirror's normal in the spindle's frame."""
        setup, machine = int(moment.setup[0]), self._site.machine
        if setup not in self._made:
            run = self._description.positions(setup)
            ends = np.array([[run[k][axis] for axis in "xyz"] for k in (0, -1)])
            first, last = machine.functional_point(ends)
            beam = (last - first) / np.linalg.norm(last - first)
            off = self._site.mirror_tilt(setup) + self._site.disturbance(moment).mirror
            normal = tilted(beam[None], np.atleast_2d(off))[0]
            self._made[setup] = first, beam, machine.tool_rotation(ends[:1])[0].T @ normal
        return self._made[setup]

    def sight(self, targets: Array, pose: Pose, beam: Beam, moment: Scene) -> Sight:
        """See `Optics`; the path counts from where the run starts."""
        start, direction, fixed = self._setup(moment)
        path = mirror_path(start, direction, targets, pose.rotation @ fixed)
        return Sight(path, np.broadcast_to(direction, targets.shape))


class _Along(Optics):
    """A linear interferometer, aligned with the axis that moves."""

    def __init__(self, site: Site, description: sessions.Direct) -> None:
        self._direction = np.array(description.sense)

    def sight(self, targets: Array, pose: Pose, beam: Beam, moment: Scene) -> Sight:
        return Sight(targets @ self._direction, np.broadcast_to(self._direction, targets.shape))


class _Bar(Optics):
    """A ball bar between the tool and a cup on the table, which stands a little beside its place."""

    def __init__(self, site: Site, description: sessions.BallBar) -> None:
        self._centres = [np.array(setup.centre) + site.cup_offset(k) for k, setup in enumerate(description.setups)]

    def sight(self, targets: Array, pose: Pose, beam: Beam, moment: Scene) -> Sight:
        arm = targets - self._centres[int(moment.setup[0])]
        length = np.linalg.norm(arm, axis=1)
        return Sight(length, arm / length[:, None])


_OPTICS: Mapping[type[sessions.Description], Callable[[Site, Any], Optics]] = {
    sessions.TrackingInterferometer: OnTool,
    sessions.RotaryAxis: _OnTable,
    sessions.StepDiagonal: _FlatMirror,
    sessions.Direct: _Along,
    sessions.BallBar: _Bar,
}


def make_optics(site: Site, description: sessions.Description) -> Optics:
    """The optics of a session's method; a CalibrationError if that has no interferometer."""
    for kind, made in _OPTICS.items():
        if isinstance(description, kind):
            return made(site, description)
    raise CalibrationError(f"no interferometer measures a {description.method} session")
