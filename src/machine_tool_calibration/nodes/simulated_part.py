"""The surface of the simulated workpiece, and where the simulated probe triggers on it."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.instruments.touch import NominalTouch, Part
from machine_tool_calibration.nodes.site import Site
from machine_tool_calibration.simulation.disturbance import Sight
from machine_tool_calibration.simulation.live import LiveMachine
from machine_tool_calibration.simulation.probe import probed

__all__ = ["Pretravel", "SimulatedPart"]

_FORM_STREAM = 41


@dataclass(frozen=True)
class Pretravel:
    """Way from contact to trigger that the probe's calibration has left: amplitude, m, and lobes of its variation."""

    amplitude: float = 0.0
    lobes: int = 3

    def at(self, normal: Array) -> float:
        """For a contact with an outward normal (2,), m: the sphere is so much deeper when the probe triggers."""
        return float(self.amplitude * np.cos(self.lobes * np.arctan2(normal[1], normal[0])))


class SimulatedPart:
    """Exact geometry: true place of the sphere, true surface on the true table.

    Args:
        site: the simulated world.
        part: the workpiece as the probe knows it.
        form: standard deviation of the points' form errors, m.
        pretravel: of the probe.
    """

    def __init__(self, site: Site, part: Part, form: float, pretravel: Pretravel) -> None:
        machine = replace(site.machine, rotation_sign=part.sign)
        self.live = LiveMachine(machine, site.chosen, site.environment)
        self.part, self.pretravel = part, pretravel
        points = part.description.workpiece
        rng = np.random.default_rng([site.spec.seed, _FORM_STREAM])
        self.form = form * rng.normal(size=len(points))
        self._place = np.array([[*point.position, 0.0] for point in points])
        self._normal = np.array([[*point.normal, 0.0] for point in points])
        self._normal /= np.linalg.norm(self._normal, axis=1)[:, None]

    def trigger(self, touch: NominalTouch, c: float, z: float, time: float, setup: int) -> float:
        """Displacement at which the probe triggers, along the outward normal from the nominal surface, m.

        Args:
            touch: as planned.
            c: commanded angle, rad.
            z: commanded height, m.
            time: s since the origin of the site's time.
            setup: index of the setup.
        """
        normal = np.array([*touch.normal, 0.0])
        command = np.array([*touch.centre, z])
        direction = {axis: -1.0 if normal[k] > 0 else 1.0 for k, axis in enumerate("XY")}
        scene = self.live.scene(time, command, direction, angle=c, setup=setup)
        centre = self.live.functional_point(scene)[0]
        nominal, outward = self._place[touch.point], self._normal[touch.point]
        surface = self.live.on_table(scene, nominal + self.form[touch.point] * outward)
        facing = self.live.machine.table_direction(outward, np.array([c]))
        # The workpiece turns in the plane: heights are the probe's own.
        surface[:, 2], facing[:, 2] = centre[2], 0.0
        contact = float(probed(centre[None], normal[None], surface, facing, self.part.radius)[0])
        zero = np.zeros(1)
        sight = Sight(zero, -normal[None], np.array([np.arctan2(normal[1], normal[0])]), zero, zero)
        return contact + float(self.live.added(scene, sight)[0]) - self.pretravel.at(touch.normal)
