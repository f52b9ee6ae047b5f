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
    machine.position([[0.1, 0.2, 0.0]])          # (n, 3) where the functional point really is, m
    machine.position_error([[0.1, 0.2, 0.0]])    # actual minus commanded
    machine.tool_rotation([[0.1, 0.2, 0.0]])     # (n, 3, 3) orientation error of the tool, as a rotation
    machine.on_table([0.1, 0.0, 0.02], [0.5])    # where a point of the rotary table really is

One tracking reading at a time, as the nodes need it::

    azimuth, elevation = aim(estimated_station, commanded_target)
    origin, direction = Pointer(zero_offset=1e-5).beam(azimuth, elevation, true_station)
    path = sensed_path(actual_target, origin, direction)      # open loop
    path = distance(actual_target, true_station)              # a beam that follows the target

`LiveMachine` adds flaws, time and temperature to that (see `live.py`). Other instruments: `mirror_path` (a laser on a
flat mirror), `probed` (a stylus sphere on a surface). Other plans: `DiagonalPlan`, `RotaryPlan`, `ProbingPlan`,
`DirectPlan`; `PRESETS` holds those of the papers by name.
"""

from machine_tool_calibration.simulation.diagonal_run import DiagonalPlan
from machine_tool_calibration.simulation.direct_run import DirectPlan
from machine_tool_calibration.simulation.disturbance import Disturbance, Sight
from machine_tool_calibration.simulation.environment import Drift, Environment, random_environment
from machine_tool_calibration.simulation.flaw import Chosen, Flaw
from machine_tool_calibration.simulation.flaws import FLAWS, choose_flaw
from machine_tool_calibration.simulation.live import LiveMachine
from machine_tool_calibration.simulation.machine import VirtualMachine
from machine_tool_calibration.simulation.machine_file import (
    Amplitudes,
    MachineSpec,
    TableSpec,
    build_machine,
    machine_document,
    random_machine,
    read_machine,
)
from machine_tool_calibration.simulation.plans import PLANS, PRESETS
from machine_tool_calibration.simulation.probing_run import PartPoint, ProbingPlan
from machine_tool_calibration.simulation.rotary_run import RotaryPlan
from machine_tool_calibration.simulation.sensors import (
    Pointer,
    aim,
    beam_direction,
    distance,
    mirror_path,
    probed,
    sensed_path,
)
from machine_tool_calibration.simulation.simulate import Simulated, Truth, measured_again, simulate
from machine_tool_calibration.simulation.spec import Chips, FlawSpec, SimulationSpec, Spread
from machine_tool_calibration.simulation.tracking_run import TrackingPlan

__all__ = [
    "FLAWS",
    "PLANS",
    "PRESETS",
    "Amplitudes",
    "Chips",
    "Chosen",
    "DiagonalPlan",
    "DirectPlan",
    "Disturbance",
    "Drift",
    "Environment",
    "Flaw",
    "FlawSpec",
    "LiveMachine",
    "MachineSpec",
    "PartPoint",
    "Pointer",
    "ProbingPlan",
    "RotaryPlan",
    "Sight",
    "Simulated",
    "SimulationSpec",
    "Spread",
    "TableSpec",
    "TrackingPlan",
    "Truth",
    "VirtualMachine",
    "aim",
    "beam_direction",
    "build_machine",
    "choose_flaw",
    "distance",
    "machine_document",
    "measured_again",
    "mirror_path",
    "probed",
    "random_environment",
    "random_machine",
    "read_machine",
    "sensed_path",
    "simulate",
]
