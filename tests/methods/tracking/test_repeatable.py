# SPDX-License-Identifier: Apache-2.0
"""The same bits in every process, whatever number of threads linear algebra would like to use."""

from __future__ import annotations

import hashlib
import os
import subprocess
import sys

SCRIPT = """
import hashlib, sys
from machine_tool_calibration.methods.identify import identify
from machine_tool_calibration.simulation import SimulationSpec, TrackingPlan, simulate
out = hashlib.sha256()
for model in ("free", "rigid_body"):
    session = simulate(SimulationSpec(plan=TrackingPlan(dimension=3), seed=1)).session
    result = identify(session, model=model)
    out.update(result.error_map.error.tobytes() + result.fit.solution.covariance.tobytes())
print(out.hexdigest())
"""


def test_processes_and_threads(capsys):
    """This process has one thread for linear algebra; another has two, and calculates twice."""
    exec(SCRIPT, {})
    here = capsys.readouterr().out.split()
    environment = os.environ | {"OPENBLAS_NUM_THREADS": "2", "OMP_NUM_THREADS": "2"}
    twice = [sys.executable, "-c", f"for _ in range(2): exec({SCRIPT!r})"]
    done = subprocess.run(twice, env=environment, capture_output=True, text=True, timeout=900, check=True)
    assert done.stdout.split() == 2 * here
    assert len(here) == 1 and len(here[0]) == hashlib.sha256().digest_size * 2
