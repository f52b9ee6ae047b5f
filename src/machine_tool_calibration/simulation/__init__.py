# SPDX-License-Identifier: Apache-2.0
"""The virtual machine tool and the simulator of its measurements.

Readings come from exact geometry: real rotations, true distances, flat mirrors, a sphere on a surface.
Nothing here uses the estimator's model, so that agreement between the two means something.

A whole session, with the truth behind it::

    from machine_tool_calibration.simulation import FlawSpec, SimulationSpec, TrackingPlan, simulate

    spec = SimulationSpec(plan=TrackingPlan(dimension=3), seed=5,
                          effects=[FlawSpec(id="backlash_y", size=2e-6)])
    simulated = simulate(spec)
    simulated.session                    # as if it had been read from a folder
    simulated.truth.document()           # for judging only: effect, true errors, true stations

Another machine, other noise, spread between setups, gross errors, lost readings: fields of `SimulationSpec`.
An effect is given by its `size` (coefficient of its formula) or its `amplitude` (largest change of a reading);
`FLAWS` holds every effect that can be put in. `measured_again(simulated, seed)` gives the same measurement with
other noise, for Monte Carlo.

A machine of one's own::

    machine = build_machine(read_machine("config/machines/five_axis_vertical.yaml"))
    machine.functional_point([[0.1, 0.2, 0.0]])  # (n, 3) where the functional point really is, m

Workshop, interferometer and part of the simulated nodes, one reading at a time, with flaws, time and temperature:
`site.py` and `interferometer.py`. Other plans: `DiagonalPlan`, `RotaryPlan`, `ProbingPlan`, `DirectPlan`; `PRESETS`
holds those of the papers by name.
"""

from machine_tool_calibration.simulation.diagonal_run import DiagonalPlan
from machine_tool_calibration.simulation.direct_run import DirectPlan
from machine_tool_calibration.simulation.flaw import Chosen, Disturbance, Flaw
from machine_tool_calibration.simulation.flaws import FLAWS, choose_flaw
from machine_tool_calibration.simulation.machine_file import (
    Amplitudes,
    MachineSpec,
    TableSpec,
    build_machine,
    read_machine,
)
from machine_tool_calibration.simulation.probing_run import PartPoint, ProbingPlan
from machine_tool_calibration.simulation.rotary_run import RotaryPlan
from machine_tool_calibration.simulation.scene import Drift
from machine_tool_calibration.simulation.simulate import Simulated, Truth, measured_again, simulate
from machine_tool_calibration.simulation.spec import PRESETS, Chips, FlawSpec, SimulationSpec, Spread
from machine_tool_calibration.simulation.tracking_run import TrackingPlan

__all__ = [
    "FLAWS", "PRESETS", "Amplitudes", "Chips", "Chosen", "DiagonalPlan", "DirectPlan", "Disturbance", "Drift", "Flaw",
    "FlawSpec", "MachineSpec", "PartPoint", "ProbingPlan", "RotaryPlan", "Simulated", "SimulationSpec", "Spread",
    "TableSpec", "TrackingPlan", "Truth", "build_machine", "choose_flaw", "measured_again", "read_machine", "simulate",
]  # fmt: skip
