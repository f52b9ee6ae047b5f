# SPDX-License-Identifier: Apache-2.0
import json
from pathlib import Path

import numpy as np
import pytest
import yaml

from machine_tool_calibration import simulation
from machine_tool_calibration.errors import CalibrationError
from machine_tool_calibration.session.folder import read_session
from machine_tool_calibration.simulation import MachineSpec, SimulationSpec, TrackingPlan, build_machine, read_machine
from machine_tool_calibration.simulation.machine_file import machine_document
from machine_tool_calibration.simulation.spec import parse_effect, parse_setting, spec_from

MACHINES = sorted((Path(__file__).parents[2] / "config" / "machines").glob("*.yaml"))


def test_written_session_reads_back_to_the_last_bit(tmp_path, verb):
    folder = tmp_path / "out"
    words = ["--method", "tracking_interferometer", "--dimension", "3", "--seed", "5"]
    summary = verb("simulate", *words, "--effect", "backlash_y", "--size", "2e-6", folder, "--json").document
    assert summary["observations"] == 1000
    assert summary["effects"][0] | {"size": 2e-6} == {"id": "backlash_y", "size": 2e-6, "unit": "m"}
    session = read_session(folder)
    truth = json.loads((folder / "truth.json").read_text())
    again = spec_from(
        None,
        plan=truth["spec"]["plan"],
        method="tracking_interferometer",
        effects=[{"id": "backlash_y", "size": 2e-6}],
        fields={"seed": 5},
    )
    simulated = simulation.simulate(again)
    np.testing.assert_array_equal(session.readings.displacement, simulated.session.readings.displacement)
    assert session.description == simulated.session.description
    assert truth["effect"] == "backlash_y"
    assert truth["amplitude"] == pytest.approx(np.max(np.abs(simulated.truth.signal)))
    assert len(truth["position_error"]) == len(truth["points"]) == 125


@pytest.mark.parametrize("method", ["step_diagonal", "tracking_interferometer", "rotary_axis", "probing", "direct"])
def test_every_method_is_written_and_read(method, tmp_path, verb):
    told = verb("simulate", "--method", method, tmp_path / "s")
    assert told.err == "" and f"mtcal identify {tmp_path / 's'}" in told.out.replace("\n", "")
    session = read_session(tmp_path / "s")
    assert session.method == method
    assert np.isfinite(session.readings.displacement).all()


def test_a_preset_may_stand_in_the_place_of_a_file(tmp_path, verb):
    for words in (["iso230_2"], ["--preset", "iso230_2"]):
        verb("simulate", *words, tmp_path / str(len(words)))
    one, other = ((tmp_path / n / "observations.csv").read_bytes() for n in "12")
    assert one == other


def test_a_session_in_the_way_is_kept(tmp_path, verb):
    verb("simulate", "--method", "direct", tmp_path)
    before = (tmp_path / "observations.csv").read_bytes()
    verb.refused("simulate", "--method", "direct", "--seed", "1", tmp_path)
    assert (tmp_path / "observations.csv").read_bytes() == before
    verb("simulate", "--method", "direct", "--seed", "1", "--overwrite", tmp_path)
    assert (tmp_path / "observations.csv").read_bytes() != before
    assert json.loads((tmp_path / "truth.json").read_text())["seed"] == 1


def test_spec_file_and_options_on_top(tmp_path, verb):
    spec = tmp_path / "spec.yaml"
    spec.write_text("plan: {method: probing, part: pins}\nseed: 3\nnoise: 2e-6\neffects: [{id: probe_pretravel}]\n")
    words = ["--seed", "4", "--plan", "repeats=2", "--effect", "workpiece_thermal:amplitude=5e-6"]
    words += ["--chips", "0.03", "--missing", "0.01"]
    summary = verb("simulate", spec, tmp_path / "s", *words, "--json").document
    assert (summary["seed"], summary["observations"], summary["standard_uncertainty"]) == (4, 2 * 704, 2e-6)
    assert [e["id"] for e in summary["effects"]] == ["probe_pretravel", "workpiece_thermal"]
    assert summary["outliers"] > 0
    assert summary["missing"] > 0


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--method", "direct", "--effect", "backlash_q"], "no effect 'backlash_q' can be simulated"),
        (["--method", "direct", "--effect", "dead_path"], "does not occur in direct"),
        (["--preset", "nonsense"], "no preset 'nonsense'; there are tracking_2d"),
        (["--preset", "tracking_2d", "--method", "direct"], "is of the method tracking_interferometer, not direct"),
        (["--method", "direct", "--plan", "repeats=0"], "plan.repeats must be at least 1"),
        (["--method", "direct", "--plan", "colour=red"], "unknown key 'plan.colour'"),
        (["--method", "direct", "--plan", "repeats"], "'repeats' is not KEY=VALUE"),
        (["--method", "direct", "--noise", "-1"], "noise must be greater than 0"),
        (["--method", "direct", "--noise", "0.3"], "0.3 m is implausible; lengths are in metres: did you mean 3e-07"),
        (["--method", "direct", "--repeatability", "2"], "repeatability: 2 m is implausible"),
        (["--method", "direct", "--spread", "0.1"], "spread.slope: 0.1 m is implausible"),
        (["--method", "direct", "--effect", "backlash_x", "--size", "3"], "backlash_x: size 3 m is implausible"),
        (["--method", "direct", "--effect", "backlash_x", "--amplitude", "3"], "backlash_x: amplitude: 3 m is"),
        (["--method", "direct", "--effect", "backlash_x", "--amplitude", "1e-308"], "amplitude must be at least 1e-12"),
        (["--method", "direct", "--noise-factor", "1e308"], "noise_factor must be at most 10000, not 1e+308"),
        (["--method", "direct", "--plan", "interval=1e308"], "plan.interval must be at most 100000, not 1e+308"),
        (["--preset", "iso230_2", "--effect", "warmup_x:tau=-1"], "the readings come out as no numbers"),
        (["--method", "direct", "--effect", "warmup_x:tau=.inf"], "tau must be a finite number, not inf"),
        (["--method", "direct", "--effect", "warmup_x:tau=long"], "tau must be a finite number, not long"),
        (["--method", "direct", "--machine", "nowhere.yaml"], "nowhere.yaml: no such file"),
        ([], "say what to simulate"),
        (["missing_spec.yaml"], "missing_spec.yaml: no such file"),
    ],
)
def test_wrong_requests_get_one_line(words, said, tmp_path, verb):
    assert said in verb.refused("simulate", *words, tmp_path / "s")
    assert not (tmp_path / "s").exists()


def test_list_and_help(verb):
    out = verb("simulate", "--list").out
    for word in ("tracking_3d", "backlash_x", "unlisted_step", "station_drift"):
        assert word in out
    listed = verb("simulate", "--list", "--json").document
    assert listed["presets"]["probing_pins"] == "probing"
    assert {"id", "formula", "unit", "typical", "methods", "listed"} == set(listed["effects"][0])
    assert "mtcal simulate SPEC.yaml OUT" in verb("simulate", "--help").out


def test_wrong_command_line_is_status_2(tmp_path, verb):
    verb("simulate", "--method", "direct", status=2)
    verb("simulate", "--method", "direct", "--size", "1e-6", tmp_path / "s", status=2)
    verb("simulate", "--method", "nonsense", tmp_path / "s", status=2)


def test_effects_and_settings_from_words():
    assert parse_effect("EXX") == {"id": "EXX"}
    assert parse_effect("pointer_radial_error:size=1e-6,orders=[5, 3],weights=[1, 0.5]") == {
        "id": "pointer_radial_error",
        "size": 1e-6,
        "parameters": {"orders": [5, 3], "weights": [1, 0.5]},
    }
    assert parse_setting("stations=[[0, 0, 1e-3]]") == ("stations", [[0, 0, 1e-3]])


@pytest.mark.parametrize("path", MACHINES, ids=lambda p: p.stem)
def test_example_machines_can_be_built_and_written_again(path):
    machine = build_machine(read_machine(path))
    document = yaml.safe_load(yaml.safe_dump(machine_document(machine)))
    again = build_machine(MachineSpec.model_validate(document))
    points = np.random.default_rng(1).uniform(0, 0.1, (20, 3))
    np.testing.assert_allclose(again.functional_point(points), machine.functional_point(points), atol=2e-9)
    np.testing.assert_allclose(
        again.on_table(points, points[:, 0] * 30), machine.on_table(points, points[:, 0] * 30), atol=2e-7
    )


def test_a_machine_file_decides_the_errors(tmp_path, verb):
    file = tmp_path / "machine.yaml"
    file.write_text("random: null\nsquareness: {C0Y: 2e-5}\n")
    verb("simulate", "--preset", "tracking_2d", "--machine", file, tmp_path / "s")
    truth = json.loads((tmp_path / "s" / "truth.json").read_text())
    points, error = np.array(truth["points"]), np.array(truth["position_error"])
    np.testing.assert_allclose(error[:, 0], -2e-5 * points[:, 1], atol=1e-12)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("motions: {EXX: {nodes: [0, 0], values: [1, 2]}}", r"machine.yaml line 1: motions.EXX: .* must increase"),
        ("motions: {EXX: {nodes: [0, 1], values: [1, 2, 3]}}", "yaml line 1: motions.EXX: .* 2 nodes and 3 values"),
        ("motions: {EXA: {nodes: [0, 1], values: [1, 2]}}", r"'EXA': the chain .* has no such axis"),
        ("travel: {x: [1, 0]}", "travel of x must run from low to high"),
        ("travel: {x: [0, 1.0e-12]}\nrandom: {}", "travel of x must run from low to high by 1e-06 at least"),
        ("travel: {x: [0, 5.0e-324]}", "too small to be anything of a machine"),
        ("motions: {EXX: {nodes: [0, 1.0e-90, 1], values: [1, 2, 3]}}", "motions.EXX: .* must increase, by 1e-12"),
        ("chain: w-X-t", "must run from w through one b to t"),
        ("squareness: {C0C: 1e-5}", "'C0C' is no squareness"),
    ],
)
def test_unfit_machines_are_refused(text, said, tmp_path):
    file = tmp_path / "machine.yaml"
    file.write_text(text)
    with pytest.raises(CalibrationError, match=said):
        simulation.simulate(SimulationSpec(plan=TrackingPlan(), machine=read_machine(file)))


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("squareness: {C0Q: 1e-5}", "'C0Q' is no squareness"),
        ("motions: {EXA: {nodes: [0, 1], values: [1, 2]}}", "error motion 'EXA': the chain"),
    ],
)
def test_what_is_unfit_in_a_machine_file_is_said_with_its_name(text, said, tmp_path, verb):
    file = tmp_path / "machine.yaml"
    file.write_text(text)
    words = ("simulate", "--preset", "tracking_2d", "--machine", file, tmp_path / "s")
    assert f"{file}: {said}" in verb.refused(*words)
    assert not (tmp_path / "s").exists()
