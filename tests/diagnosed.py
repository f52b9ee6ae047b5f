# SPDX-License-Identifier: Apache-2.0
"""Diagnoses of simulated sessions that several tests read: each is made once in a process."""

from __future__ import annotations

from functools import cache

from machine_tool_calibration.diagnosis.diagnose import Diagnosis, diagnose
from machine_tool_calibration.simulation import SimulationSpec, simulate

# Simulated sets of a diagnosis: p-values are made of them, and nothing else.
SETS = 19


def diagnosed(spec: SimulationSpec, seed: int = 1) -> Diagnosis:
    """What a diagnosis says of a simulated session."""
    return _diagnosed(spec.model_dump_json(), seed)


@cache
def _diagnosed(spec: str, seed: int) -> Diagnosis:
    return diagnose(simulate(SimulationSpec.model_validate_json(spec)).session, seed=seed, sets=SETS)
