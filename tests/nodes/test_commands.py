# SPDX-License-Identifier: Apache-2.0
"""`mtcal run` and `mtcal demo` as a person or a program calls them."""

import json

import numpy as np
import pytest
from matplotlib.figure import Figure

from machine_tool_calibration.cli.main import run
from machine_tool_calibration.cli.measuring import readings_bar
from machine_tool_calibration.methods.identify import identify
from machine_tool_calibration.nodes import measurement
from machine_tool_calibration.recording.session_bag import session_from_bag
from machine_tool_calibration.session.folder import read_session

from .conftest import PROCEDURE, SITE
from .forked import ForkedGraph


@pytest.fixture
def mtcal(tmp_path, monkeypatch, capfd):
    """Runs a command in this process and in an empty folder, its nodes forked; gives its status and what it said."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(measurement, "Graph", ForkedGraph)
    return lambda *arguments: (run([str(word) for word in arguments]), capfd.readouterr())


@pytest.mark.long
def test_demo_finds_what_is_hidden_and_its_recording_gives_the_same_map(tmp_path, mtcal, monkeypatch):
    monkeypatch.setattr(Figure, "get_layout_engine", lambda figure: None)  # the pictures of tests/plots are laid out
    status, said = mtcal("demo", "--seed", 3, "--json")
    assert status == 0, said.err
    document = json.loads(said.out)
    assert document["format"] == "mtcal-demo/1"
    assert document["readings"] == 288
    # what was hidden is found, and the map gets better
    assert document["verdict"] == "missing_effect"
    assert document["found"] == [document["hidden"]]
    assert document["result"]["reduced_chi_square"] > 2.0
    assert 0.5 < document["improved"]["reduced_chi_square"] < 1.5
    assert document["map_error_rms"] < document["map_error_rms_before"]
    # the improved map is as good as its stated uncertainty, and far better than no map
    stated = np.array(document["improved"]["error_map"]["position_error_u"], dtype=float)[:, :2]
    assert document["map_error_rms"] < 2.0 * np.sqrt(np.mean(np.sum(stated**2, axis=1)))
    assert document["map_error_rms"] < 0.3 * document["machine_error_rms"]

    # the recording and the session hold the same readings, and give the same map to the last bit
    recorded = session_from_bag(tmp_path / document["bag"])
    written = read_session(tmp_path / document["session"])
    maps = []
    for session in (recorded, written):
        assert len(session.readings) == 288
        maps.append(identify(session).error_map.error)
    live = np.array(document["result"]["error_map"]["position_error"], dtype=float)
    assert np.array_equal(maps[0], maps[1], equal_nan=True)
    assert np.array_equal(maps[0][:, :2], live[:, :2])

    # the same again does not overwrite
    status, again = mtcal("demo", "--seed", 3, "--json", "--output", document["output"])
    assert status == 1
    assert again.err.strip() == f"mtcal: {document['output']}: is there already; choose another output folder"


def test_run_in_a_namespace_without_recording(tmp_path, bench, mtcal):
    procedure, site = bench.write("small.yaml", PROCEDURE), bench.write("site.yaml", SITE)
    more = ("--no-record", "--namespace", "cell_7", "--model", "rigid_body")
    status, said = mtcal("run", procedure, "--site", site, *more)
    assert status == 0, said.err
    assert "72 readings" in said.out and "finished (72 of 72 readings)\n" in said.err
    output = tmp_path / "mtcal_output" / "small"
    assert read_session(output / "session").readings.displacement.shape == (72,)
    assert json.loads((output / "result.json").read_text())["model"] == "rigid_body"
    assert not (output / "bag").exists()


@pytest.mark.long
def test_what_aligns_a_pointer_is_measured_and_not_identified(tmp_path, mtcal):
    status, said = mtcal("run", "pointer_zero", "--output", tmp_path / "zero")
    assert status == 0, said.err
    assert f"next: mtcal align-pointer {tmp_path / 'zero'}" in " ".join(said.out.split())
    assert mtcal("align-pointer", tmp_path / "zero" / "session")[0] == 0


@pytest.mark.long
def test_a_run_ends_as_soon_as_it_is_enough(tmp_path, bench, mtcal):
    procedure, site = bench.write("small.yaml", PROCEDURE), bench.write("site.yaml", {**SITE, "noise": 3e-7})
    status, said = mtcal("run", procedure, "--site", site, "--until", "U=1.5um", "--json")
    assert status == 0, said.err
    document = json.loads(said.out)
    stages = document["reached"]
    assert [one["enough"] for one in stages] == [False] * (len(stages) - 1) + [True]
    as_left = list({one["setup"]: one for one in stages}.values())
    assert 2 <= len(as_left) < 4 and len(as_left) < len(stages) and stages[-1]["U"] < 1.55e-6  # of two digits
    assert stages[0]["U"] is None  # one station alone determines no map
    session = read_session(tmp_path / "mtcal_output" / "small" / "session")
    assert len(session.readings) == document["readings"] == stages[-1]["readings"] < 72
    # the recording holds what was decided, and is as whole as that of any other run
    assert len(session_from_bag(tmp_path / document["bag"]).readings) == document["readings"]
    status, said = mtcal("enough", tmp_path / document["bag"], "--until", "U=1.5um", "--json")
    assert status == 0, said.err
    again = json.loads(said.out)["reached"]
    assert [(one["setup"], one["enough"]) for one in again] == [(one["setup"], one["enough"]) for one in as_left]
    assert again[-1]["U"] == pytest.approx(stages[-1]["U"])


def test_how_many_readings_there_are_stands_once_with_every_change_of_it(capfd):
    with readings_bar() as progress:
        for text, done in (("starting", 0), ("12 readings at P1", 3), ("finished", 9), ("closing", 9)):
            progress(text, done, 72)
    said = capfd.readouterr().err.splitlines()
    assert said == ["starting", "12 readings at P1 (3 of 72 readings)", "finished (9 of 72 readings)", "closing"]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["run", "tracking_2d", "--until", "soon"], "mtcal: until: 'soon' is neither U=2um nor told="),
        (["run", "tracking_2d", "--until", "told=backlash"], "mtcal: unknown effect 'backlash' (did you mean "),
        (["run", "tracking_2d", "--until", "U=0um"], "mtcal: until U: '0um' must be positive"),
        (
            ["run", "nothing"],
            "mtcal: nothing: no such file, and no procedure of that name; known are ball_bar, direct_iso230_2, ",
        ),
        (["run", "nothing.yaml"], "mtcal: nothing.yaml: no such file"),
        (["run", "tracking_2d", "--site", "no.yaml"], "mtcal: no.yaml: no such file"),
    ],
)
def test_what_is_wrong_is_said_in_one_line(tmp_path, monkeypatch, capfd, arguments, message):
    monkeypatch.chdir(tmp_path)
    assert run(arguments) == 1
    said = capfd.readouterr().err
    assert said.startswith(message)
    assert len(said.strip().splitlines()) == 1
    assert list(tmp_path.iterdir()) == []


@pytest.mark.long
def test_a_procedure_that_fails_keeps_what_was_measured(tmp_path, bench, mtcal):
    # the pointer's true direction is wrong by 0.5 degrees: the beam misses the retroreflector
    site = bench.write("site.yaml", {**SITE, "pointer": {"zero_offset": 0.009}})
    status, said = mtcal("run", bench.write("small.yaml", PROCEDURE), "--site", site)
    assert status == 1
    assert said.err.strip().splitlines()[-1].startswith("mtcal: the procedure ended: instrument: the beam is beside")
    assert (tmp_path / "mtcal_output" / "small" / "log" / "instrument.log").exists()
