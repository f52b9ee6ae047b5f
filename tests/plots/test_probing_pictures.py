# SPDX-License-Identifier: Apache-2.0
"""Pictures of probing results show what is determined, and mark what is not."""

import numpy as np
import pytest

from machine_tool_calibration.methods.identify import identify
from machine_tool_calibration.plots.pictures import figures
from machine_tool_calibration.plots.probing import draw_probing
from machine_tool_calibration.plots.style import save
from machine_tool_calibration.simulation import ProbingPlan, SimulationSpec, simulate


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


def test_file_is_written(pins, tmp_path):
    session, document = pins
    (file,) = save(figures([session], document), tmp_path)
    assert file.read_bytes().startswith(b"\x89PNG")
