# SPDX-License-Identifier: Apache-2.0
"""The flat mirror of a step diagonal off the beam: reading = t1 (u1 . d) + t2 (u2 . d), Ibaraki and Hata 2010."""

import numpy as np

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.effects.effect import Coefficient, Effect
from machine_tool_calibration.model.observations import Observations
from machine_tool_calibration.words import say


class MirrorMisalignment(Effect):
    """A tilted mirror normal n reads n.d/(n.l): two tilts a setup (Ibaraki and Hata 2010, Section 3.1)."""

    id = "mirror_misalignment"
    title = say("effect.mirror")
    formula = say("formula.mirror")
    source = "Ibaraki and Hata 2010, Eq. (4)"
    kind = "reading"
    methods = ("step_diagonal",)
    setup_level = True

    def coefficients_for(self, observations: Observations, shape: tuple[float, ...] = ()) -> tuple[Coefficient, ...]:
        """Two tilts for each setup."""
        return tuple(
            Coefficient(f"{i}.t{k}", "rad", -0.02, 0.02, say("coefficient.mirror_tilt", setup=i, n=k))
            for i in observations.session.setup_ids
            for k in (1, 2)
        )

    def columns(self, observations: Observations, shape: tuple[float, ...] = ()) -> Array:
        """Displacement across the beam since the start of the run."""
        readings = observations.readings
        out = np.zeros((len(observations.session.setup_ids), 2, len(readings)))
        for run in np.unique(observations.run):
            mine = np.flatnonzero(observations.run == run)
            moved = observations.position[mine] - observations.position[mine[0]]
            across = np.linalg.svd(observations.direction[mine[:1]])[2][1:]
            out[readings.setup[mine[0]]][:, mine] = (moved @ across.T).T
        return out.reshape(-1, len(readings))
