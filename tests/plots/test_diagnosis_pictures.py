# SPDX-License-Identifier: Apache-2.0
"""Pictures of a diagnosis and of the error falling: for every method, and with the numbers that they are of."""

import re
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from machine_tool_calibration.diagnosis.consequence import consequences
from machine_tool_calibration.diagnosis.improve import Improvement, improve
from machine_tool_calibration.plots.diagnosis import draw_diagnosis, draw_improvement, save_diagnosis, save_improvement
from machine_tool_calibration.simulation import PRESETS, FlawSpec, SimulationSpec, simulate

from ..diagnosed import diagnosed

FLAWS = {
    "tracking_2d": FlawSpec(id="backlash_y", size=1.5e-6),
    "rotary_axis": FlawSpec(id="backlash_c", size=1.3e-5),
    "probing_cross": FlawSpec(id="probe_pretravel", amplitude=4e-6),
    "iso230_2": FlawSpec(id="backlash_x", size=2e-6),
}


@cache
def improved(plan: str) -> Improvement:
    spec = SimulationSpec(plan=PRESETS[plan], seed=7, effects=(FLAWS[plan],))
    return improve(simulate(spec).session)


@pytest.mark.long
@pytest.mark.parametrize(
    ("plan", "shows_over"),
    [
        ("tracking_2d", "direction of approach of y"),
        ("rotary_axis", "direction of approach of c"),
        ("probing_cross", "direction of the surface's normal"),
        ("iso230_2", "direction of approach of x"),
    ],
)
def test_every_method_has_its_pictures(plan: str, shows_over: str) -> None:
    done = improved(plan)
    figure = draw_improvement(done)
    fall, before, after = figure.axes[:3]
    residual = fall.lines[0].get_ydata()
    assert np.asarray(residual) == pytest.approx([1e6 * s.result.rms_residual for s in done.steps])
    assert [t.get_text() for t in fall.get_xticklabels()] == [s.label for s in done.steps]
    # Both maps to the same scale.
    assert before.get_ylim() == pytest.approx(after.get_ylim())
    assert before.get_xlim() == pytest.approx(after.get_xlim())
    found = done.diagnosis
    figure = draw_diagnosis(found, consequences(found))
    ranking, added, over = figure.axes
    assert ranking.get_yticklabels()[0].get_text() == found.ranked[0].candidate.name
    measured = np.concatenate([np.asarray(line.get_ydata()) for line in added.lines[:-1]])
    assert np.sort(measured) == pytest.approx(np.sort(1e6 * found.search.fit.fits[0].residuals))
    assert over.get_ylabel() == "residual, µm"
    assert found.accepted == (FLAWS[plan].id,)
    assert re.search(shows_over, over.get_xlabel())


@pytest.mark.long
def test_files(tmp_path: Path) -> None:
    done = improved("tracking_2d")
    picture, steps, residuals = save_improvement(done, tmp_path / "a" / "b")
    assert picture.read_bytes().startswith(b"\x89PNG")
    table = pd.read_csv(steps, comment="#")
    assert table["rms_residual"].to_numpy() == pytest.approx([s.result.rms_residual for s in done.steps])
    each = pd.read_csv(residuals, comment="#")
    for column, step in (("residual_before", done.steps[0]), ("residual_after", done.steps[-1])):
        assert np.sqrt(np.mean(each[column] ** 2)) == pytest.approx(step.result.rms_residual, rel=1e-9)
    picture, candidates = save_diagnosis(done.diagnosis, consequences(done.diagnosis), tmp_path)
    assert picture.read_bytes().startswith(b"\x89PNG")
    table = pd.read_csv(candidates, comment="#")
    assert table["effect"][0] == "backlash_y"
    assert (table["rms_after"] <= table["rms_before"] * 1.001).all()


@pytest.mark.long
def test_what_varied_with_wrong_readings_only_is_drawn_before_them_alone() -> None:
    """A temperature that was another one while the beam was broken."""
    session = simulate(SimulationSpec(plan=PRESETS["iso230_2"], seed=7)).session
    readings = session.readings
    wrong = np.arange(len(readings)) % 23 == 3
    columns = {k: v for k, v in readings.columns.items() if "temperature" not in k and k != "air_pressure"}
    columns["motor"] = np.where(wrong, 40.0, 30.0)
    displacement = readings.displacement + np.where(wrong, 1e-4, 0.0)
    found = improve(session.with_readings(replace(readings, columns=columns, displacement=displacement)))
    assert any(found.steps[-1].set_aside)
    figure = draw_improvement(found)
    before, after = figure.axes[1:3]
    assert "motor" in before.get_xlabel()
    assert not np.isfinite(after.lines[0].get_xdata()).any()


@pytest.mark.long
def test_without_a_candidate_that_was_added_the_picture_says_less() -> None:
    found = diagnosed(SimulationSpec(plan=PRESETS["tracking_2d"], seed=101))
    figure = draw_diagnosis(found, {})
    assert not figure.axes[1].axison
