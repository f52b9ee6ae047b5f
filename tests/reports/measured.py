# SPDX-License-Identifier: Apache-2.0
"""Simulated measurements of every verdict, and what follows from the diagnosis of each: found once in a process."""

from functools import cache

from machine_tool_calibration.budget.complete import Conclusions, conclude
from machine_tool_calibration.diagnosis.diagnose import Diagnosis
from machine_tool_calibration.simulation import PRESETS, Chips, FlawSpec, SimulationSpec

from ..diagnosed import diagnosed


def _tracked(seed: int, effect: str, amplitude: float) -> SimulationSpec:
    return SimulationSpec(plan=PRESETS["tracking_2d"], seed=seed, effects=(FlawSpec(id=effect, amplitude=amplitude),))


SPECS = {
    "adequate": SimulationSpec(plan=PRESETS["tracking_2d"], seed=101),
    "missing_effect": _tracked(77, "backlash_y", 1.5e-6),
    "unexplained": _tracked(6, "unlisted_cubic_path", 6e-6),
    "look-alike": _tracked(5, "pointer_radial_error", 4e-6),
    "outliers": SimulationSpec(plan=PRESETS["probing_cross"], seed=9, chips=Chips(fraction=0.02)),
    "too noisy": SimulationSpec(plan=PRESETS["tracking_2d"], seed=102, noise_factor=1.6),
    "too little to tell": _tracked(19, "station_drift", 1.5e-6),
}


@cache
def concluded(name: str) -> tuple[Diagnosis, Conclusions]:
    """The diagnosis of a measurement, and what follows from it."""
    found = diagnosed(SPECS[name])
    return found, conclude(found, progress=lambda what, share: None)
