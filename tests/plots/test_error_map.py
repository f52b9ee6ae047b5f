# SPDX-License-Identifier: Apache-2.0
"""The pictures of a map: what is drawn, where, and in which units."""

import numpy as np
import pytest
from matplotlib.collections import EllipseCollection, LineCollection

from machine_tool_calibration.methods.identify import identify
from machine_tool_calibration.model.model import motion_value, place_of
from machine_tool_calibration.model.result import Estimate
from machine_tool_calibration.plots.error_map import draw_map, draw_tables, read_tables
from machine_tool_calibration.plots.pictures import figures
from machine_tool_calibration.plots.style import round_down, save, spaced
from machine_tool_calibration.plots.tracking import draw_stations
from machine_tool_calibration.simulation import SimulationSpec, TrackingPlan, simulate


def identified(dimension=2, model="free", lost=None, **plan):
    session = simulate(SimulationSpec(plan=TrackingPlan(dimension=dimension, **plan), seed=3)).session
    if lost is not None:
        session.readings.displacement[lost(session.readings)] = np.nan
    return session, identify(session, model=model)


@pytest.fixture(scope="module")
def plane():
    return identified()


@pytest.fixture(scope="module")
def volume():
    return identified(3, "rigid_body", z=(0.0, 0.2, 0.4))


def offsets(panel, label):
    line = next(line for line in panel.get_lines() if line.get_label() == label)
    return line.get_xydata()


def test_magnified_errors_land_where_they_belong(plane):
    _, result = plane
    content = result.error_map.content
    panel = draw_map(content).axes[0]
    magnification = float(panel.figure.get_suptitle().split("magnified ")[1].split(" times")[0].replace(" ", ""))
    expected = 1e3 * (content["points"][:, :2] + magnification * content["position_error"])
    assert np.allclose(offsets(panel, "measured"), expected)
    assert np.allclose(offsets(panel, "nominal"), 1e3 * content["points"][:, :2])


def test_scale_bar_is_as_long_as_it_says(plane):
    _, result = plane
    panel = draw_map(result.error_map.content).axes[0]
    magnification = float(panel.figure.get_suptitle().split("magnified ")[1].split(" times")[0].replace(" ", ""))
    bar = next(line for line in panel.get_lines() if line.get_linewidth() == 2.5).get_xydata()
    (text,) = [t.get_text() for t in panel.texts if t.get_text().endswith("µm")]
    assert np.ptp(bar[:, 0]) == pytest.approx(magnification * float(text.split()[0]) * 1e-3)


def test_ellipses_are_twice_the_uncertainty_to_the_stated_scale(plane):
    _, result = plane
    content = result.error_map.content
    figure = draw_map(content)
    panel = figure.axes[0]
    (ellipses,) = [c for c in panel.collections if isinstance(c, EllipseCollection)]
    magnification = float(figure.get_suptitle().split("magnified ")[1].split(" times")[0].replace(" ", ""))
    (label,) = [t for t in panel.get_legend_handles_labels()[1] if t.startswith("U (95 %)")]
    larger = float(label.split(",")[1].split()[0]) if "larger" in label else 1.0
    widths = ellipses.get_widths()
    assert np.allclose(widths, 4e3 * magnification * larger * content["position_error_u"][:, 0])


def test_a_grid_is_drawn_as_lines_between_neighbours(plane):
    _, result = plane
    panel = draw_map(result.error_map.content).axes[0]
    lines = [c for c in panel.collections if isinstance(c, LineCollection)]
    assert [len(c.get_segments()) for c in lines] == [60, 60]


def test_targets_that_are_not_determined_are_marked():
    _, result = identified(lost=lambda r: (r.columns["x"] == 0) & (r.columns["y"] == 0) & (r.setup > 0))
    panel = draw_map(result.error_map.content).axes[0]
    assert offsets(panel, "not determined").tolist() == [[0.0, 0.0]]
    assert len(offsets(panel, "measured")) == 35


def test_nothing_determined_is_drawn_without_numbers(plane):
    _, result = plane
    content = dict(result.error_map.content)
    content["position_error"] = np.full((36, 2), np.nan)
    content["position_error_u"] = np.full((36, 2), np.nan)
    figure = draw_map(content)
    assert "no target is determined" in figure.get_suptitle()
    figure.canvas.draw()


def test_a_volume_is_drawn_layer_by_layer(volume):
    _, result = volume
    figure = draw_map(result.document()["error_map"])
    titles = [panel.get_title() for panel in figure.axes if panel.get_title()]
    assert titles == [f"z = {z} mm" for z in (0, 200, 400)]
    assert any(panel.get_ylabel() == "error along z, µm" for panel in figure.axes)
    assert len({t.get_text() for panel in figure.axes for t in panel.texts}) == 1


def test_points_at_random_are_joined_to_their_nominal_places():
    points = np.random.default_rng(0).random((80, 3)) * 0.4
    _, result = identified(3, points=tuple(map(tuple, np.round(points, 6).tolist())))
    figure = draw_map(result.error_map.content)
    panels = [panel for panel in figure.axes if " to " in panel.get_title()]
    assert len(panels) == 4
    segments = sum(len(c.get_segments()) for p in panels for c in p.collections if isinstance(c, LineCollection))
    assert segments == 80


@pytest.mark.long
def test_files_of_a_session(tmp_path, volume):
    session, result = volume
    written = save(figures([session], result.document()), tmp_path)
    assert sorted(path.name for path in written) == ["error_map.png", "error_motions.png", "stations.png"]
    assert all(path.read_bytes().startswith(b"\x89PNG") for path in written)


def test_common_pictures_of_any_result(tmp_path, plane):
    _, result = plane
    assert [path.name for path in save(figures((), result.document()), tmp_path)] == ["error_map.png"]
    assert save(figures((), {**result.document(), "error_map": {}, "parameters": []}), tmp_path) == []


def test_tables_in_micrometres_with_their_bands(volume):
    _, result = volume
    parameters = result.document()["parameters"]
    tables = read_tables(parameters)
    assert tables["EXX"].shape == (5, 3)
    assert tables["EXX"][:, 0].tolist() == pytest.approx([0, 0.1, 0.2, 0.3, 0.4])
    figure = draw_tables(parameters)
    panel = figure.axes[0]
    line = next(line for line in panel.get_lines() if line.get_label() == "EXX")
    assert np.allclose(line.get_xydata(), tables["EXX"][:, :2] * [1e3, 1e6])
    band = panel.collections[0].get_paths()[0].vertices
    top = tables["EXX"][-1, 1] + 2 * tables["EXX"][-1, 2]
    assert band[:, 1].max() >= 1e6 * top - 1e-9
    assert "C0Y = " in figure.get_suptitle()
    assert panel.get_xlabel() == "X, mm"


def test_tables_by_setup_are_not_taken_for_tables_by_position():
    by_setup, place = motion_value("ECC", "C1", "rad"), place_of("A", "x", 0.0)
    for parameter in (by_setup, place):
        entry = Estimate.of(parameter, 0.0, 1.0).document()
        assert read_tables([entry]) == {}
        assert draw_tables([entry]) is None


def test_stations_with_their_uncertainty(volume):
    _, result = volume
    figure = draw_stations(result.document()["error_map"])
    texts = [text.get_text() for text in figure.axes[0].texts]
    assert [text[0] for text in texts] == ["A", "B", "C", "D"]
    assert all("µm" in text for text in texts)
    assert len(figure.axes) == 2


def test_a_station_that_was_not_read_is_left_out():
    _, result = identified(lost=lambda r: r.setup == 3)
    figure = draw_stations(result.document()["error_map"])
    assert [text.get_text()[0] for text in figure.axes[0].texts] == ["A", "B", "C"]


@pytest.mark.parametrize(("value", "expected"), [(1.0, 1.0), (19.9, 10.0), (20.0, 20.0), (0.0049, 0.002), (7e5, 5e5)])
def test_round_down(value, expected):
    assert round_down(value) == pytest.approx(expected)


def test_spaced():
    assert spaced(20000.0) == "20 000"


def test_a_table_of_which_only_the_datum_has_a_value_is_not_determined() -> None:
    at_zero = {"name": "EXX(0)", "error_motion": "EXX", "position": 0.0, "value": 0.0, "standard_uncertainty": 0.0}
    known = {**at_zero, "error_motion": "EYX", "position": 0.1, "standard_uncertainty": 1e-7}
    figure = draw_tables([at_zero, {**at_zero, "error_motion": "EYX"}, known])
    assert figure is not None
    assert [[text.get_text() for text in panel.texts] for panel in figure.axes] == [["not determined"], []]
