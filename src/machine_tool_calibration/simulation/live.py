# SPDX-License-Identifier: Apache-2.0
"""The virtual machine and its flaws moment by moment, for simulated nodes.

::

    live = LiveMachine(machine, [choose_flaw("backlash_y", 2e-6)], environment)
    now = live.scene(12.5, [0.1, 0.2, 0.0], direction={"X": 1, "Y": -1})
    live.functional_point(now)                     # (1, 3): with backlash, heat and all error motions
    origin, direction = live.beam(now, pointer, azimuth, elevation, true_station)
    path = sensed_path(live.functional_point(now), origin, direction)
    path + live.added(now, Sight(path, direction, azimuth, incidence, path - first_path))

Everything takes many moments at once as well (a stretch of the displacement stream).
"""

from collections.abc import Iterable, Mapping

import numpy as np

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.simulation.flaw import Chosen, Disturbance, Sight, combine
from machine_tool_calibration.simulation.machine import VirtualMachine
from machine_tool_calibration.simulation.scene import Environment, Scene
from machine_tool_calibration.simulation.sensors import Pointer


class LiveMachine:
    """A machine, given without its flaws, whose errors depend on time, temperature and direction."""

    def __init__(
        self, machine: VirtualMachine, flaws: Iterable[Chosen] = (), environment: Environment | None = None
    ) -> None:
        self.machine, self.flaws, self.environment = machine, tuple(flaws), environment or Environment()
        fixed = self.disturbance(self.scene(0.0, np.zeros(3)))
        # with the flaws' extra error motions and squareness
        self.machine = machine.with_tables(fixed.tables).with_squareness(fixed.squareness)

    def scene(
        self,
        time: Array | float,
        position: Array | Iterable[float],
        direction: Mapping[str, Array | float] | None = None,
        *,
        angle: Array | float = 0.0,
        axis: str = "C",
        setup: int = 0,
        start: float = 0.0,
    ) -> Scene:
        """The conditions of one or more moments: s since the start of the session, a number or (n,).

        Positions are commanded x, y, z, (3,) or (n, 3), m; directions signs of the last move by axis letter, +1 where
        absent; `angle` is that of the rotary axis, rad, `setup` the instrument's, and `start` the time of its first
        reading, s.
        """
        at = np.atleast_2d(np.asarray(position, float))
        n = max(len(at), np.size(time))

        def each(value: Array | float) -> Array:
            return np.broadcast_to(np.asarray(value, float), n)

        return Scene(
            time=each(time),
            setup=np.full(n, setup),
            repeat=np.zeros(n, np.int64),
            position=np.broadcast_to(at, (n, 3)),
            angle=each(angle),
            direction={name: each(value) for name, value in (direction or {}).items()},
            environment=self.environment,
            axis=axis,
            ends=self.machine.travel,
            start=each(start),
        )

    def disturbance(self, scene: Scene) -> Disturbance:
        """What the flaws do at these moments."""
        return combine(tuple(flaw.disturb(scene) for flaw in self.flaws))

    def functional_point(self, scene: Scene) -> Array:
        """(n, 3) where the functional point really is in the workpiece frame, m."""
        return self.disturbance(scene).functional_point(self.machine, scene.position)

    def tool_rotation(self, scene: Scene) -> Array:
        """(n, 3, 3) rotation of the tool with respect to the workpiece."""
        return self.machine.tool_rotation(scene.position, self.disturbance(scene).errors)

    def on_table(self, scene: Scene, point: Array) -> Array:
        """(n, 3) where a point of the table (its target, the workpiece) really is in the machine frame, m."""
        return self.disturbance(scene).on_table(self.machine, point, scene.angle, scene.axis)

    def beam(
        self, scene: Scene, pointer: Pointer, azimuth: Array | float, elevation: Array | float, station: Array
    ) -> tuple[Array, Array]:
        """(n, 3) origin, m, and (n, 3) direction of the beam that is commanded to an azimuth and elevation, rad."""
        n, disturbance = len(scene), self.disturbance(scene)
        flat, up = np.broadcast_to(azimuth, n), np.broadcast_to(elevation, n)
        return pointer.beam(flat, up, station + disturbance.station, disturbance.turn)

    def added(self, scene: Scene, sight: Sight) -> Array:
        """(n,) what the flaws of air and instrument add to the path, m."""
        return self.disturbance(scene).added(sight)
