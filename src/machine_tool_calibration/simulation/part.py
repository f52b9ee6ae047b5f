# SPDX-License-Identifier: Apache-2.0
"""A part on the table of the simulated workshop, touched point by point."""

from dataclasses import replace

import numpy as np

from machine_tool_calibration.instruments.touch import NominalTouch, Part
from machine_tool_calibration.simulation.probing_run import touched
from machine_tool_calibration.simulation.site import Site

_FORM_STREAM = 41


class SimulatedPart:
    """True place of the sphere, true surface on the true table, with a scatter (`form`, m)."""

    def __init__(self, site: Site, part: Part, form: float) -> None:
        self._site, self._machine = site, replace(site.machine, rotation_sign=part.sign)
        self.part = part
        noise = site.spec.noise
        self.noise = part.description.standard_uncertainty.displacement if noise is None else noise
        points = part.description.workpiece
        self._form = form * np.random.default_rng([site.spec.seed, _FORM_STREAM]).normal(size=len(points))
        self._place = np.array([[*point.position, 0.0] for point in points])
        self._normal = np.array([[*point.normal, 0.0] for point in points])
        self._normal /= np.linalg.norm(self._normal, axis=1)[:, None]

    def trigger(self, touch: NominalTouch, c: float, z: float, time: float, setup: int) -> float:
        """Displacement at which the probe triggers, along the outward normal from the nominal surface, m.

        Of a touch as planned, at a commanded angle c, rad, and height z, m, `time` after the origin of the site's time,
        s.
        """
        normal, own = np.array([[*touch.normal, 0.0]]), [touch.point]
        direction = {axis: -1.0 if way > 0 else 1.0 for axis, way in zip("XY", touch.normal, strict=True)}
        scene = self._site.scene(time, [*touch.centre, z], direction, angle=c, setup=setup)
        disturbance = self._site.disturbance(scene)
        # The workpiece turns in the plane: heights are the probe's own.
        actual = disturbance.functional_point(self._machine, scene.position) * [1.0, 1.0, 0.0]
        surface = self._place[own], self._normal[own], self._form[own]
        errors = (self._machine, disturbance)
        return float(touched(*errors, *surface, scene.angle, actual, normal, self.part.radius)[0])
