# SPDX-License-Identifier: Apache-2.0
"""Sequential multilateration of a rotary axis (Zhang et al. 2015): Table 1, and the experiment of Figs. 6 and 7."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from machine_tool_calibration.arrays import Array, rigid_motions
from machine_tool_calibration.methods.identify import identify
from machine_tool_calibration.simulation import MachineSpec, RotaryPlan, SimulationSpec, simulate
from papers.record import Printed, Study

__all__ = ["Repeated", "study"]

_PAPER = (
    "Zhang, Ren, Liu, Wu, Chen: A modified sequential multilateration scheme and its application in geometric error "
    "measurement of rotary axis. Procedia CIRP 27 (2015)"
)
# Table 1: uncertainties of x, y and z after one measurement and after ten, m.
_ONE = (1.17e-6, 1.23e-6, 1.09e-6)
_TEN = (0.29e-6, 0.32e-6, 0.32e-6)
_LENGTH, _RETURN, _SIDE = 2.69e-7, 1e-6, 1.0
_SESSIONS = 8
# Section 4.2: the experiment was repeated.
_TIMES = 5


@dataclass(frozen=True)
class Repeated:
    """Error motions of one axis from several measurements.

    Attributes:
        content: `error_map` of the first.
        each: (k, n) radial error motion along X from each, m.
        true: (n,) what the simulated axis does, m, without what the choice of the axis average line takes up.
    """

    content: Mapping[str, Any]
    each: Array
    true: Array


def study(progress: Callable[[str, float], None]) -> Study:
    """Simulate the points of Table 1, measured from four stations one after another, once and ten times."""
    printed: list[Printed] = []
    for number, (repeats, figures, within) in enumerate(((1, _ONE, 0.15e-6), (10, _TEN, 0.06e-6))):
        ours = _deviation(repeats, partial(_share, progress, f"repeats: {repeats}", number))
        times = "one measurement" if repeats == 1 else "mean of ten"
        why = "" if repeats == 1 else "the paper's fall by 3.4 to 4.0, the mean of ten independent ones by 3.2"
        printed += [
            Printed(f"standard uncertainty of {axis}, {times}", "Table 1", figure, float(own), "m", within, why)
            for axis, figure, own in zip("xyz", figures, ours, strict=True)
        ]
    return Study(
        id="rotary_axis",
        paper=_PAPER,
        assumptions=(
            "The arrangement of Fig. 4 is not printed: stations stand at a corner of a cube of 1 m and at the ends of "
            "its three edges, 64 points in the middle half of it.",
            "Positioning errors within 0 to 3 µm are taken as normal with a standard deviation of 1 µm for each "
            "coordinate and each visit.",
            "Places are compared without a common shift and rotation, which no distance tells.",
        ),
        printed=tuple(printed),
        pictures={"figs_6_and_7": _experiment()},
    )


def _experiment() -> Repeated:
    """Section 4.2's targets and angles, all targets at every angle, one way, on a simulated axis."""
    found, true = [], np.zeros(0)
    for seed in range(_TIMES):
        plan = RotaryPlan(both_ways=False, at_every_angle=True)
        simulated = simulate(SimulationSpec(plan=plan, seed=seed, machine=MachineSpec(seed=1)))
        found.append(identify(simulated.session).error_map.content)
        true = simulated.truth.machine.motion("EXC", plan.turns())
    angle = RotaryPlan(both_ways=False).turns()
    # A shift of the line, and one that turns with the axis, are not the axis's error but where its line is.
    free = np.column_stack([np.ones_like(angle), np.cos(angle), np.sin(angle)])
    each = np.array([content["EXC"] for content in found])
    true = true - free @ np.linalg.lstsq(free, true - each.mean(axis=0), rcond=None)[0]
    return Repeated(found[0], each, true)


def _share(progress: Callable[[str, float], None], what: str, number: int, share: float) -> None:
    progress(what, (number + share) / 2)


def _deviation(repeats: int, progress: Callable[[float], None]) -> Array:
    """(3,) standard deviation of the coordinates that are found, m."""
    stations = ((0.0, 0.0, 0.0), (_SIDE, 0.0, 0.0), (0.0, _SIDE, 0.0), (0.0, 0.0, _SIDE))
    line = tuple(np.linspace(0.25, 0.75, 4) * _SIDE)
    plan = {
        "method": "tracking_interferometer",
        "dimension": 3,
        "pointing": "tracking",
        "stations": stations,
        **dict.fromkeys("xyz", line),
        "repeats": repeats,
        "noise": _LENGTH,
    }
    squares = []
    for seed in range(_SESSIONS):
        progress(seed / _SESSIONS)
        spec = SimulationSpec.model_validate({"seed": seed, "plan": plan, "repeatability": _RETURN})
        simulated = simulate(spec)
        found = identify(simulated.session).error_map
        error = found.error - simulated.truth.machine.position_error(found.points)
        motion = rigid_motions(found.points - found.points.mean(axis=0)).reshape(-1, 6)
        error -= (motion @ np.linalg.lstsq(motion, error.ravel(), rcond=None)[0]).reshape(-1, 3)
        squares.append(error**2)
    return np.asarray(np.sqrt(np.mean(squares, axis=(0, 1))))
