# SPDX-License-Identifier: Apache-2.0
"""What the graph must measure: the same session from the simulator, without any node."""

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.simulation.machine_file import MachineSpec
from machine_tool_calibration.simulation.simulate import simulate
from machine_tool_calibration.simulation.spec import FlawSpec, SimulationSpec
from machine_tool_calibration.simulation.tracking_run import TrackingPlan


def reference(procedure: dict, site: dict) -> Array:
    """Displacements without noise, from the first reading of each setup."""
    session, grid = procedure["session"], procedure["path"]["grid"]
    lines = {}
    for axis, entry in grid.items():
        if isinstance(entry, dict):
            step = (entry["last"] - entry["first"]) / (entry["count"] - 1)
            values = [entry["first"] + step * i for i in range(entry["count"] - 1)] + [entry["last"]]
        else:
            values = entry
        lines[axis] = tuple(values)
    pointer = site.get("pointer", {})
    plan = TrackingPlan(
        dimension=session["dimension"],
        stations=tuple(tuple(setup["position"]) for setup in session["setups"]),
        station_uncertainty=0.0,
        repeats=session["repeats"],
        chain=session["machine"]["chain"],
        zero_offset=pointer.get("zero_offset", 0.0),
        radial=pointer.get("radial", {}),
        **lines,
    )
    spec = SimulationSpec(
        plan=plan,
        machine=MachineSpec(**site["machine"]),
        effects=tuple(FlawSpec(**effect) for effect in site.get("effects", ())),
        noise_factor=0.0,
    )
    return simulate(spec).session.readings.displacement
