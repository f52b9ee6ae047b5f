# SPDX-License-Identifier: Apache-2.0
"""Pictures of probing results show what is determined, and mark what is not.
Pictures of a rotary axis and of direct deviations: drawn from the document, also where values are null.
"""

import re
from pathlib import Path

import numpy as np
import pytest

from machine_tool_calibration.diagnosis.compare import compare
from machine_tool_calibration.methods.identify import identify
from machine_tool_calibration.plots import direct, rotary_axis
from machine_tool_calibration.plots.compare import draw_map as draw_residual_map
from machine_tool_calibration.plots.error_map import draw_motions, draw_plane
from machine_tool_calibration.plots.pictures import figures
from machine_tool_calibration.plots.probing import draw_probing
from machine_tool_calibration.plots.style import save
from machine_tool_calibration.simulation import ProbingPlan, SimulationSpec, simulate
from machine_tool_calibration.words import words


def identified(**plan):
    session = simulate(SimulationSpec(plan=ProbingPlan(**plan), seed=2)).session
    return session, identify(session).document()


@pytest.fixture(scope="module")
def pins():
    return identified(part="pins")


def labels(panel):
    return panel.get_legend_handles_labels()[1]


def test_four_panels(pins):
    session, document = pins
    form, uncertainty, axes, table = draw_probing(session.description, document["error_map"]).axes[:4]
    assert "not determined" not in labels(form)
    assert uncertainty.get_title().endswith("µm")
    # the grid of 400 mm is larger than the part
    assert "not determined" in labels(axes)
    assert {"EXC", "EYC"} <= set(labels(table))


def test_points_are_drawn_along_their_normals(pins):
    session, document = pins
    panel = draw_probing(session.description, document["error_map"]).axes[0]
    drawn = next(line for line in panel.get_lines() if line.get_marker() == "d").get_xydata() / 1e3
    place = np.array([p.position for p in session.description.workpiece])
    normal = np.array([p.normal for p in session.description.workpiece])
    form = np.array(document["error_map"]["workpiece_form"])
    shift = np.sum((drawn - place) * normal, axis=1)
    scale = shift[np.argmax(np.abs(form))] / form[np.argmax(np.abs(form))]
    assert scale > 100
    np.testing.assert_allclose(shift, scale * form, atol=1e-9)


def test_disc_says_that_c_is_not_seen():
    session, document = identified(part="disc")
    panels = draw_probing(session.description, document["error_map"]).axes
    assert any("ECC is not determined" in panel.get_title() for panel in panels)


@pytest.mark.long
def test_file_is_written(pins, tmp_path):
    session, document = pins
    (file,) = save(figures([session], document), tmp_path)
    assert file.read_bytes().startswith(b"\x89PNG")


def _session(**plan):
    return simulate(SimulationSpec.model_validate({"seed": 1, "plan": plan})).session


@pytest.mark.long
def test_rotary_axis(tmp_path: Path) -> None:
    axis = "A"
    session = _session(method="rotary_axis", axis=axis, hidden={"P": (1.0, 1.5)})
    document = identify(session).document()
    files = save(figures([session], document), tmp_path)
    assert [file.name for file in files] == ["error_motions.png", "arrangement.png"]
    assert all(file.stat().st_size > 10_000 for file in files)
    figure = rotary_axis.draw_motions(document["error_map"], axis)
    panels = figure.axes
    assert [panel.get_title().split(":")[0] for panel in panels] == [f"E{c}{axis}" for c in "XYZABC"]
    expected = 1e6 * np.array(document["error_map"][f"EX{axis}"], dtype=float)
    drawn = next(line for line in panels[0].lines if len(line.get_xdata()) == 18)
    np.testing.assert_allclose(drawn.get_ydata(), expected)
    assert sum(line.get_linestyle() == ":" for line in panels[0].lines) == 2  # the two lost angles


@pytest.mark.long
@pytest.mark.parametrize(
    ("kind", "names"),
    [
        ("iso230_2", ["iso230_2_X.png", "error_motions.png"]),
        ("grid_plate", ["error_motions.png", "map.png"]),
        ("drilled_plate", ["map.png"]),
    ],
)
def test_direct(tmp_path: Path, kind: str, names: list[str]) -> None:
    session = _session(method="direct", kind=kind, repeats=3)
    files = save(figures([session], identify(session).document()), tmp_path)
    assert [file.name for file in files] == names
    assert all(file.stat().st_size > 5_000 for file in files)


def test_figures_of_the_standard_are_written_on_the_picture() -> None:
    (run,) = identify(_session(method="direct", kind="iso230_2", repeats=5)).document()["error_map"]["iso230_2"]
    title = direct.draw_positioning(run).get_suptitle()
    for name in ("A", "E", "M", "R", "B"):
        written = re.search(rf"\b{name} (\d+\.\d+) µm", title)
        # As many digits as its U allows.
        assert written and float(written[1]) == pytest.approx(1e6 * run[name], abs=0.2e6 * run[f"{name}_U"])
    single = {**run, "R": None, "A": None, "s_up": [None] * 11, "s_down": [None] * 11}
    assert "R " not in direct.draw_positioning(single).get_suptitle().replace("R↑", "").replace("R↓", "")


def test_a_title_stays_within_its_picture_in_every_language() -> None:
    figure = draw_motions({"EXX": np.array([[0.0, 0.0, 0.0], [0.1, 1e-6, 1e-7]])}, {})
    figure.suptitle(words("de").told(figure.get_suptitle()))
    figure.draw_without_rendering()
    assert figure._suptitle.get_window_extent().width < figure.bbox.width


def test_a_map_is_seen_across_the_plane_that_it_lies_in() -> None:
    content = identify(_session(method="direct", kind="grid_plate", repeats=2)).document()["error_map"]
    keys = ("points", "position_error", "position_error_u")
    upright = {key: np.array(content[key], dtype=float)[:, [0, 2, 1]] for key in keys}
    (flat,), (turned,) = (draw_plane(one).axes for one in (content, upright))
    assert (flat.get_ylabel(), turned.get_ylabel()) == ("y, mm", "z, mm")
    for one, other in zip(flat.lines, turned.lines, strict=True):
        np.testing.assert_allclose(one.get_xydata(), other.get_xydata())


def test_residuals_along_a_line_stand_up_from_it() -> None:
    session = _session(method="direct", kind="iso230_2", repeats=2)
    result = identify(session)
    (panel,) = draw_residual_map(compare(result)).axes
    assert (panel.get_xlabel(), panel.get_ylabel()) == ("x, mm", "residual along x, µm")
    drawn = np.concatenate([line.get_ydata() for line in panel.lines if line.get_marker() == "."])
    np.testing.assert_allclose(np.sort(drawn), np.sort(1e6 * result.fit.residuals), atol=1e-9)
