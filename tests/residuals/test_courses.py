# SPDX-License-Identifier: Apache-2.0
"""What many readings in a row share is no gross error; what stands out of it is one."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from machine_tool_calibration.methods.build import build_model
from machine_tool_calibration.methods.identify import identify
from machine_tool_calibration.model.model import MethodModel
from machine_tool_calibration.residuals.gross_errors import Outlier, find_outliers, suspected_rows
from machine_tool_calibration.session.folder import read_session
from machine_tool_calibration.session.session import Session
from machine_tool_calibration.simulation import PRESETS, FlawSpec, SimulationSpec, simulate

NOISE = 1.5e-7
HEAD = """format: mtcal-session/1
method: direct
machine: {chain: w-X-b-t, travel: {x: [0.0, 0.5]}}
repeats: 1
standard_uncertainty: {displacement: 1.5e-07}
datum: offset
terms: [EXX]
setups:
- {id: A}
"""


def found_in(session: Session) -> list[Outlier]:
    """What is set aside by the method's own model."""
    return find_outliers(session, lambda part: build_model(part)[0])


def warming(folder: Path, constants: tuple[float, float], size: float, gross: dict[int, float]) -> Session:
    """One place read 570 times in three hours while the frame warms up; then five others."""
    rng = np.random.default_rng(4)
    time = 19.0 * np.arange(575)
    course = size * (0.6 * np.exp(-time / constants[0]) + 0.4 * np.exp(-time / constants[1]))
    displacement = np.where(np.arange(575) < 570, course, 0.0) + NOISE * rng.standard_normal(575)
    displacement[list(gross)] += NOISE * np.array(list(gross.values()))
    x = 0.1 + 0.05 * np.maximum(np.arange(575) - 569, 0)
    rows = zip(time, x, displacement, strict=True)
    lines = ["time,setup,repeat,x,dir_x,gx,gy,gz,displacement"]
    lines += [f"{t:.1f},A,0,{place:.3f},1,1,0,0,{value:.12g}" for t, place, value in rows]
    (folder / "session.yaml").write_text(HEAD, encoding="utf-8")
    (folder / "observations.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
    return read_session(folder)


@pytest.mark.parametrize("size", [116e-6, 15e-6, 3e-6])
@pytest.mark.parametrize("constants", [(70.0, 600.0), (300.0, 3600.0), (1200.0, 1500.0)])
def test_a_transient_loses_no_reading(tmp_path: Path, size: float, constants: tuple[float, float]) -> None:
    assert found_in(warming(tmp_path, constants, size, {})) == []


def test_gross_errors_within_a_transient_are_found(tmp_path: Path) -> None:
    errors = {60: 40.0, 150: -20.0, 151: 30.0, 400: -15.0}
    found = found_in(warming(tmp_path, (300.0, 3600.0), 15e-6, errors))
    assert {o.row for o in found} == set(errors)


def test_an_answer_does_not_depend_on_what_was_asked_before() -> None:
    spec = SimulationSpec(plan=PRESETS["tracking_2d"], seed=3, effects=(FlawSpec(id="backlash_y", size=1e-6),))
    session = simulate(spec).session

    def build(part: Session) -> MethodModel:
        return build_model(part)[0]

    first = find_outliers(session, build)
    suspected_rows(session, build)
    assert find_outliers(session, build) == first


def test_a_place_that_is_lost_is_said() -> None:
    """Of a place that was read twice, nothing tells which reading is right."""
    plan = PRESETS["straightness"].model_copy(update={"repeats": 2})
    session = simulate(SimulationSpec(plan=plan, seed=5)).session
    readings = session.readings
    displacement = readings.displacement.copy()
    displacement[4] += 3e-4
    wrong = session.with_readings(replace(readings, displacement=displacement))
    found = identify(wrong)
    rejected = found.rejected
    assert {r.row for r in rejected} == set(np.flatnonzero(readings.columns["x"] == readings.columns["x"][4]).tolist())
    assert all("no other reading of its place is left" in r.reason for r in rejected)
    where = f"({1e3 * readings.columns['x'][4]:g}, 0, 0) mm"
    assert [(n.name, n.why) for n in found.not_determined if where in n.name] == [
        (f"deviation along (0, 1, 0) at {where}", "no reading of it is left")
    ]
    assert identify(session).not_determined == identify(wrong, keep_all=True).not_determined


def test_a_place_that_other_setups_read_is_not_lost() -> None:
    """A straightness measured once in each of several mountings."""
    plan = PRESETS["straightness"].model_copy(update={"repeats": 8})
    session = simulate(SimulationSpec(plan=plan, seed=5)).session
    readings, names = session.readings, [f"m{k}" for k in range(8)]
    setups = tuple(session.description.setups[0].model_copy(update={"id": name}) for name in names)
    displacement = readings.displacement.copy()
    displacement[4] += 3e-4
    mounted = replace(
        session,
        description=session.description.model_copy(update={"setups": setups, "repeats": 1, "datum": "offset"}),
        readings=replace(readings, setup=readings.repeat, repeat=0 * readings.repeat, displacement=displacement),
    )
    rejected = identify(mounted).rejected
    assert [r.row for r in rejected] == [4]
    assert "no other reading of its place" not in rejected[0].reason


def test_a_run_on_another_zero_loses_no_reading(tmp_path: Path) -> None:
    """Most of its places nothing else read: there it agrees with itself, which is no sign that the others are wrong."""
    rng = np.random.default_rng(6)
    repeated = [(place, k) for place in (0.1, 0.25, 0.4) for k in range(1, 6)]
    run = [(place, 0) for place in np.linspace(0.0, 0.5, 11)]
    lines = ["setup,repeat,x,dir_x,gx,gy,gz,displacement"]
    for place, k in repeated + run + run[::-1]:
        value = (30e-6 if k == 0 else 0.0) + NOISE * rng.standard_normal()
        lines.append(f"A,{k},{place:.3f},1,1,0,0,{value:.12g}")
    (tmp_path / "session.yaml").write_text(HEAD.replace("repeats: 1", "repeats: 6"), encoding="utf-8")
    (tmp_path / "observations.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
    session = read_session(tmp_path)
    assert found_in(session) == []
    (spread,) = identify(session).document()["spread"]
    assert spread["size"] > 5e-6


@pytest.mark.parametrize("after", [26, 28, 30])
def test_a_step_within_a_run_loses_no_reading(after: int) -> None:
    """The model takes up most of it, so that five or ten readings before and after it stand out together."""
    session = simulate(SimulationSpec(plan=PRESETS["rotary_axis"], seed=3)).session
    readings = session.readings
    later = np.flatnonzero((readings.setup == 2) & (readings.repeat == 0))[after:]
    displacement = readings.displacement.copy()
    displacement[later] += 17.0 * session.sigma
    assert found_in(session.with_readings(replace(readings, displacement=displacement))) == []


def test_what_reproduces_is_no_gross_error() -> None:
    """Both readings of one place are off by as much."""
    session = simulate(SimulationSpec(plan=PRESETS["step_diagonal"], seed=3)).session
    readings = session.readings
    displacement = readings.displacement.copy()
    displacement[[60, 217]] += 17.0 * session.sigma
    assert [readings.columns[axis][60] for axis in "xyz"] == [readings.columns[axis][217] for axis in "xyz"]
    assert found_in(session.with_readings(replace(readings, displacement=displacement))) == []
    displacement[217] -= 17.0 * session.sigma
    alone = found_in(session.with_readings(replace(readings, displacement=displacement)))
    assert [outlier.row for outlier in alone] == [60]
