# SPDX-License-Identifier: Apache-2.0
"""A measuring method that a package of its own adds, with one line that announces it: circles with a gauge."""

import json
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

import machine_tool_calibration as mtcal
from machine_tool_calibration.cli.main import run
from machine_tool_calibration.diagnosis.compare import compare
from machine_tool_calibration.diagnosis.diagnose import diagnose
from machine_tool_calibration.errors import SessionError
from machine_tool_calibration.methods.fitted import FitRequest
from machine_tool_calibration.methods.identify import identify, identify_sessions
from machine_tool_calibration.session.catalogue import METHODS, method_spec
from machine_tool_calibration.session.description import RotaryAxis, StepDiagonal
from machine_tool_calibration.session.folder import read_session
from machine_tool_calibration.session.session import Session
from machine_tool_calibration.simulation import PRESETS, SimulationSpec, simulate

from ..own_method import announced, forget

LINE = "circle_gauge = circle_gauge.spec:SPEC"
RADIUS, SIGMA = 0.15, 2e-7
SQUARENESS, MISMATCH, BACKLASH = 12e-6, -8e-6, 3e-6

DESCRIPTION = f"""format: mtcal-session/1
method: circle_gauge
machine: {{chain: w-Y-X-b-Z-t, travel: {{x: [0, 0.5], y: [0, 0.4]}}}}
repeats: 2
standard_uncertainty: {{displacement: {SIGMA}}}
setups:
- {{id: left, centre: [0.2, 0.2, 0.0], radius: {RADIUS}}}
- {{id: right, centre: [0.3, 0.2, 0.0], radius: {RADIUS}}}
"""


@pytest.fixture
def plugin(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.syspath_prepend(str(Path(__file__).parent))
    monkeypatch.syspath_prepend(str(announced(tmp_path / "site", LINE)))
    forget()
    yield
    forget()


def circles(folder: Path, backlash: float = 0.0, seed: int = 1) -> Path:
    """Readings from exact distances between displaced tool and displaced centre, both ways round."""
    rng = np.random.default_rng(seed)
    rows = ["time,setup,repeat,x,y,dir_x,dir_y,displacement"]
    time = 0.0
    for name, centre in (("left", (0.2, 0.2)), ("right", (0.3, 0.2))):
        offset, length = rng.normal(0.0, 2e-5, 2), rng.normal(0.0, 1e-5)
        for repeat, sense in ((0, 1.0), (1, -1.0)):
            for angle in sense * np.linspace(0.0, 2.0 * np.pi, 80, endpoint=False) + 0.01:
                x, y = centre[0] + RADIUS * np.cos(angle), centre[1] + RADIUS * np.sin(angle)
                towards = np.sign([-sense * np.sin(angle), sense * np.cos(angle)])
                actual = np.array(
                    [x - SQUARENESS * y - 0.5 * MISMATCH * x, y + 0.5 * MISMATCH * y - 0.5 * backlash * towards[1]]
                )
                reading = np.hypot(*(actual - centre - offset)) - (RADIUS + length) + rng.normal(0.0, SIGMA)
                rows.append(f"{time},{name},{repeat},{x:.9f},{y:.9f},{towards[0]:g},{towards[1]:g},{reading:.12g}")
                time += 0.5
    folder.mkdir()
    (folder / "session.yaml").write_text(DESCRIPTION)
    (folder / "observations.csv").write_text("\n".join(rows) + "\n")
    return folder


def within(found: dict[str, tuple[float, float]]) -> None:
    """What was put in is found within four standard uncertainties, which are small against it."""
    for name, truth in (("C0Y", SQUARENESS), ("scale_mismatch", MISMATCH)):
        value, u = found[name]
        assert 0.0 < u < 0.05 * abs(truth)
        assert abs(value - truth) < 4.0 * u


@pytest.mark.usefixtures("plugin")
def test_it_is_identified_and_compared_as_the_others_are(tmp_path: Path) -> None:
    session = read_session(circles(tmp_path / "circles"))
    assert session.instrument == "ball_bar"
    result = identify(session)
    within({p.name: (p.value, p.standard_uncertainty) for p in result.parameters})
    assert 0.7 < result.fit.joint.reduced_chi_square < 1.3
    assert "mean_scale" in [entry.name for entry in result.not_determined]
    assert np.isnan(result.error_map.error[:, 2]).all()
    comparison = compare(session)
    assert comparison.fit.joint.reduced_chi_square == pytest.approx(result.fit.joint.reduced_chi_square, rel=0.1)
    fit = mtcal.identify(mtcal.load(tmp_path / "circles"))
    motions = fit.error_motions.set_index("motion")
    assert motions.loc["C0Y", "value"] == pytest.approx(SQUARENESS, abs=4.0 * motions.loc["C0Y", "u"])


@pytest.mark.long
@pytest.mark.usefixtures("plugin")
def test_nothing_is_found_where_nothing_is_missing_and_a_backlash_where_there_is_one(tmp_path: Path) -> None:
    sound = diagnose(read_session(circles(tmp_path / "sound")))
    assert sound.verdict == "adequate"
    assert sound.accepted == ()
    found = diagnose(read_session(circles(tmp_path / "lost", backlash=BACKLASH)))
    assert found.verdict == "missing_effect"
    assert found.accepted == ("backlash_y",)


@pytest.mark.usefixtures("plugin")
def test_two_sessions_share_the_machine_s_squareness(tmp_path: Path) -> None:
    sessions = [read_session(circles(tmp_path / f"on_day_{seed}", seed=seed)) for seed in (1, 2)]
    alone = {p.name: p.standard_uncertainty for p in identify(sessions[0]).parameters}
    joint = identify_sessions(FitRequest(sessions, ("first", "second")))
    found = {p.name: (p.value, p.standard_uncertainty) for p in joint.parameters}
    value, u = found["C0Y"]
    assert abs(value - SQUARENESS) < 4.0 * u
    assert 0.5 * alone["C0Y"] < u < 0.9 * alone["C0Y"]
    assert {"first/scale_mismatch", "second/scale_mismatch"} <= found.keys()


@pytest.mark.long
@pytest.mark.usefixtures("plugin")
def test_the_command_line_knows_it(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = str(circles(tmp_path / "circles", backlash=BACKLASH))
    assert run(["identify", folder, "--effect", "backlash_y", "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert document["method"] == "circle_gauge"
    within({p["name"]: (p["value"], p["standard_uncertainty"]) for p in document["parameters"]})
    assert run(["identify", folder, "--plot", "-o", str(tmp_path / "out")]) == 0
    assert "circles with a gauge" in capsys.readouterr().out
    assert (tmp_path / "out" / "error_map.png").exists()
    assert run(["convert", folder, str(tmp_path / "bag")]) == 0
    assert run(["compare", str(tmp_path / "bag")]) == 0


@pytest.mark.usefixtures("plugin")
def test_its_session_is_checked(tmp_path: Path) -> None:
    folder = circles(tmp_path / "circles")
    text = (folder / "session.yaml").read_text()
    (folder / "session.yaml").write_text(text.replace("centre:", "center:"))
    with pytest.raises(SessionError, match=r"session\.yaml line 7: unknown key .*did you mean 'centre'"):
        read_session(folder)
    (folder / "session.yaml").write_text(text)
    rows = (folder / "observations.csv").read_text().replace(",x,", ",position,", 1)
    (folder / "observations.csv").write_text(rows)
    with pytest.raises(SessionError, match="the column 'x' is missing, which circle_gauge needs"):
        read_session(folder)


def test_a_method_has_the_name_of_its_description_and_a_pointer_where_it_has_stations() -> None:
    assert [method_spec(name).name for name in METHODS] == list(METHODS)
    pointed = [name for name in METHODS if method_spec(name).beam_from_pointer]
    assert pointed == ["tracking_interferometer", "rotary_axis"]


def test_a_description_is_of_its_own_method_alone() -> None:
    session: Session = simulate(SimulationSpec(plan=PRESETS["rotary_axis"], seed=1)).session
    assert session.description.as_a(RotaryAxis) is session.description
    with pytest.raises(TypeError, match="a description of rotary_axis is no StepDiagonal"):
        session.description.as_a(StepDiagonal)
