# SPDX-License-Identifier: Apache-2.0
"""The other interferometer methods through the graph: readings are those of the simulator."""

import copy
from types import SimpleNamespace

import numpy as np
import pytest
import yaml

from machine_tool_calibration.cli.demo import error_against_truth
from machine_tool_calibration.methods.identify import identify
from machine_tool_calibration.methods.tracking.pointer_alignment import rotation_centre
from machine_tool_calibration.nodes.shared import procedure_file
from machine_tool_calibration.procedure import read_procedure
from machine_tool_calibration.session.collect import live_session
from machine_tool_calibration.simulation.simulate import simulate
from machine_tool_calibration.simulation.site import Site, SiteSpec
from machine_tool_calibration.simulation.spec import SimulationSpec

# not the usual sizes, which the simulator would change to suit the method
MACHINE = {"seed": 9, "random": {"positioning": 4e-6}}
FREE = {"seed": 5, "noise": 0.0, "station_uncertainty": 0.0, "target_uncertainty": 0.0, "mirror_tilt": 0.0}


def load(name):
    return yaml.safe_load(procedure_file(name).read_text())


def diagonal():
    procedure = load("step_diagonal")
    session = procedure["session"]
    session["blocks"], session["repeats"] = 3, 2
    session["setups"][1]["start"] = [0.036, 0.0, 0.0]
    session["setups"][2]["start"] = [0.0, 0.036, 0.0]
    session["setups"][3]["start"] = [0.036, 0.036, 0.0]
    session["machine"]["travel"] = {axis: [0.0, 0.036] for axis in "xyz"}
    session["setups"][2]["id"] = "pnp_zxy"
    effects = [{"id": "scale", "size": 2e-5}]
    plan = {"method": "step_diagonal", "blocks": 3, "mirror_tilt": 0.0, "repeats": 2, "chain": "w-Y-X-b-Z-t"}
    plans = [plan, {**plan, "diagonals": ["pnp"], "orders": ["zxy"], "linear": []}]
    return procedure, effects, plans


def rotary():
    procedure = load("rotary_axis")
    session = procedure["session"]
    session["repeats"] = 2
    procedure["path"]["alternate"] = False
    procedure["path"]["grid"]["c"] = {"first": 0.0, "last": 6.0, "count": 5}
    plan = {
        "method": "rotary_axis",
        "repeats": 2,
        "targets": {target["id"]: target["position"] for target in session["targets"]},
        "stations": [setup["position"] for setup in session["setups"]],
        "angles": np.linspace(0.0, 6.0, 5).tolist(),
        "station_uncertainty": 0.0,
        "target_uncertainty": 0.0,
    }
    return procedure, [{"id": "backlash_c", "size": 1e-5}], [plan]


def direct():
    procedure = load("direct_iso230_2")
    procedure["session"]["machine"]["travel"] = {"x": [-0.01, 0.41], "y": [0.0, 0.05], "z": [0.0, 0.05]}
    procedure["session"]["repeats"] = 2
    procedure["path"] = {"grid": {"x": {"first": 0.0, "last": 0.4, "count": 5}}}
    plan = {"method": "direct", "count": 5, "repeats": 2, "chain": "w-Y-X-b-Z-t"}
    return procedure, [{"id": "pitch_periodic_x", "size": 1e-6, "parameters": {"phase": 1.0}}], [plan]


def tracking():
    """In space the retroreflector's form counts by the angle to the spindle's axis."""
    procedure = load("tracking_3d")
    session = procedure["session"]
    session["repeats"] = 2
    grid = {axis: [0.05, 0.2, 0.35] for axis in "xyz"}
    procedure["path"] = {"grid": grid}
    plan = {
        "method": "tracking_interferometer",
        "dimension": 3,
        "repeats": 2,
        "stations": [setup["position"] for setup in session["setups"]],
        "station_uncertainty": 0.0,
        "chain": session["machine"]["chain"],
        **grid,
    }
    form = {"orders": [2, 3], "weights": [1.0, 0.5], "phases": [0.3, 1.1]}
    return procedure, [{"id": "retroreflector_form", "size": 1e-6, "parameters": form}], [plan]


def keyed(session, displacement):
    """Readings by setup, repeat, target and order."""
    found = {}
    target = session.readings.labels.get("target", np.full(len(displacement), ""))
    for setup, repeat, name, value in zip(
        session.readings.setup, session.readings.repeat, target, displacement, strict=True
    ):
        found.setdefault((session.setup_ids[setup], int(repeat), str(name)), []).append(value)
    return {key: np.array(values) for key, values in found.items()}


CASES = {"step_diagonal": diagonal, "rotary_axis": rotary, "direct": direct, "tracking": tracking}


@pytest.mark.long
@pytest.mark.parametrize("case", CASES.values(), ids=CASES)
def test_readings_are_those_of_the_simulator(bench, finish, case):
    procedure, effects, plans = case()
    machine = {**MACHINE, **copy.deepcopy(procedure["session"]["machine"])}
    machine.pop("axis", None)
    site = {**FREE, "machine": machine, "effects": effects}
    names = ("axis_simulator", "instrument", "procedure")
    graph = bench.graph(
        (*names, "rotary_pointer") if case in (rotary, tracking) else names, procedure=procedure, site=site
    )
    operator = bench.operator(graph)
    finish(operator)
    measured = live_session(*operator.heard.session())
    live = keyed(measured, measured.readings.displacement)
    expected = {}
    for plan in plans:
        own = {**MACHINE, "travel": procedure["session"]["machine"]["travel"]}
        content = {"plan": plan, "machine": own, "effects": effects, "noise_factor": 0.0}
        session = simulate(SimulationSpec.model_validate(content)).session
        expected |= keyed(session, session.readings.displacement)
    compared = 0
    for key, values in live.items():
        if key not in expected:
            continue
        reference = expected[key]
        assert np.abs((values - values[0]) - (reference - reference[0])).max() < 2e-12, key
        compared += len(values)
    assert compared == len(measured.readings)
    assert measured.readings.columns["datum"].max() > 0 or case is direct
    if case is rotary:
        # Readings without noise, all of one direction: what the demonstration's table errs by is found to nanometres.
        (bench.folder / "site.yaml").write_text((bench.folder / "site1.yaml").read_text())
        found = error_against_truth(SimpleNamespace(output=bench.folder, session=measured), identify(measured))
        assert found.before > 1e-6 > 1000 * found.rms


@pytest.mark.long
def test_a_pointer_turns_about_a_target_that_stands_still(bench, finish):
    procedure = load("pointer_centre")
    procedure["session"]["repeats"] = 1
    procedure["path"]["azimuth"] = {"first": 0.0, "last": 5.934119456780721, "count": 18}
    setup = procedure["session"]["setups"][0]
    setup["position_uncertainty"] = 2e-4
    site = {**FREE, "station_uncertainty": None, "machine": {**MACHINE, **procedure["session"]["machine"]}}
    operator = bench.operator(bench.graph(procedure=procedure, site=site))
    finish(operator)
    columns = [dict(zip(message.names, message.values, strict=True)) for message in operator.heard.session()[1]]
    azimuth, displacement = (np.array([row[name] for row in columns]) for name in ("azimuth", "displacement"))
    true = Site(SiteSpec.model_validate(site))
    place = {axis: columns[0][axis] for axis in "xyz"}
    stands = true.functional_point(true.moment(0.0, place))[0, :2]
    found = rotation_centre(azimuth, displacement, stands)
    station = true.station(read_procedure(procedure_file("pointer_centre")).session, 0)
    assert np.abs(station[:2] - setup["position"][:2]).max() > 5e-5
    assert found.centre == pytest.approx(station[:2], abs=1e-11)
