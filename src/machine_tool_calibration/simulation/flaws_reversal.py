"""Flaws that depend on where an axis came from: lost motion along its travel, steps aside and tilts on reversal."""

from __future__ import annotations

import numpy as np

from machine_tool_calibration.simulation.disturbance import Disturbance
from machine_tool_calibration.simulation.flaw import Flaw, Parameters
from machine_tool_calibration.simulation.flaws_position import LINEAR
from machine_tool_calibration.simulation.motions import COMPONENTS
from machine_tool_calibration.simulation.scene import Scene

__all__ = ["REVERSAL_FLAWS"]


def _lost_motion(axis: str) -> Flaw:
    """A screw that is worn most at one place: the nut has most play there, and half of it half a travel away."""

    def disturb(size: float, parameters: Parameters, scene: Scene) -> Disturbance:
        low, high = scene.ends.get(axis, (0.0, 1.0))
        away = (scene.along(axis) - low) / (high - low) - parameters["where"]
        play = size * np.cos(0.5 * np.pi * away) ** 2
        return Disturbance(axis={axis: -play * scene.toward(axis)})

    return Flaw(
        f"lost_motion_{axis.lower()}",
        f"position of {axis}: half the play against dir_{axis.lower()}, size at the share `where` of the travel, "
        "half of it half a travel away",
        "m",
        2e-6,
        disturb,
        {"where": 0.2},
        methods=LINEAR,
    )


def _reversal(name: str) -> Flaw:
    """The carriage lies against the other side of its guideway when it comes back: shifted or turned as a body."""
    axis, component = name[-1], COMPONENTS.index(name[:2])

    def disturb(size: float, _: Parameters, scene: Scene) -> Disturbance:
        errors = np.zeros((len(scene), 6))
        errors[:, component] = -size * scene.toward(axis)
        return Disturbance(errors={axis: errors})

    angular = name[1] in "ABC"
    return Flaw(
        f"reversal_{name}",
        f"error motion {name}: -size * dir_{axis.lower()} (half width)",
        "rad" if angular else "m",
        8e-6 if angular else 1.5e-6,
        disturb,
        methods=LINEAR,
    )


REVERSAL_FLAWS: tuple[Flaw, ...] = (
    *(_lost_motion(axis) for axis in "XYZ"),
    *(_reversal(component + axis) for axis in "XYZ" for component in COMPONENTS if component[1] != axis),
)
