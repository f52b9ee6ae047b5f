# SPDX-License-Identifier: Apache-2.0
"""Diagnoses of simulated sessions that several tests read: each is made once in a process."""

from functools import cache

from machine_tool_calibration.diagnosis.diagnose import Diagnosis, diagnose
from machine_tool_calibration.simulation import SimulationSpec, simulate


def diagnosed(spec: SimulationSpec) -> Diagnosis:
    """What a diagnosis says of a simulated session."""
    return _diagnosed(spec.model_dump_json())


@cache
def _diagnosed(spec: str) -> Diagnosis:
    return diagnose(simulate(SimulationSpec.model_validate_json(spec)).session)
