# SPDX-License-Identifier: Apache-2.0
"""Descriptions of workpieces, CSV and DXF outlines to points."""

import numpy as np
import pytest

from machine_tool_calibration.errors import SessionError
from machine_tool_calibration.procedure.workpiece.description import read_workpiece, workpiece_entries
from machine_tool_calibration.session.description import WorkpiecePoint

HEAD = "format: mtcal-workpiece/1\nunit: mm\nfeatures:\n"


@pytest.fixture
def read(tmp_path):
    def write(text, head=HEAD):
        file = tmp_path / "part.yaml"
        file.write_text(head + text)
        return read_workpiece(file)

    return write


def arrays(points):
    return np.array([p.position for p in points]), np.array([p.normal for p in points])


def test_pin_hole_and_sphere(read):
    points = read(
        "- {kind: pin, name: p, centre: [200, 0], diameter: 12, count: 4}\n"
        "- {kind: hole, name: h, centre: [0, 50], diameter: 20, count: 3}\n"
        "- {kind: sphere, name: s, centre: [-70, 0], diameter: 25.4, count: 8, first: 0.1}\n"
    )
    assert [p.id for p in points] == [str(k) for k in range(15)]
    assert [p.feature for p in points] == ["p"] * 4 + ["h"] * 3 + ["s"] * 8
    position, normal = arrays(points)
    np.testing.assert_allclose(position[:4], [[0.206, 0], [0.2, 0.006], [0.194, 0], [0.2, -0.006]], atol=1e-12)
    np.testing.assert_allclose(normal[:4], [[1, 0], [0, 1], [-1, 0], [0, -1]], atol=1e-12)
    # out of the material of a hole is towards its centre
    np.testing.assert_allclose(position[4:7] + 0.01 * normal[4:7], [[0, 0.05]] * 3, atol=1e-12)
    np.testing.assert_allclose(normal[7], [np.cos(0.1), np.sin(0.1)], atol=1e-12)


def test_pocket_with_stylus(read):
    text = "- {kind: outline, material: outside, spacing: 5, vertices: [[-20, -20], [20, -20], [20, 20], [-20, 20]]}\n"
    assert len(read(text)) == 32
    head = HEAD.replace("unit: mm\n", "unit: mm\nstylus_diameter: 6\n")
    position, normal = arrays(read(text, head))
    # points at 2.5 mm from a corner are nearer than the stylus's radius
    assert len(position) == 24
    assert np.all(np.sum(position * normal, axis=1) < 0)


def test_line_and_points(read):
    points = read(
        "- {kind: line, start: [0, 0], end: [100, 0], material: right, count: 5}\n"
        "- {kind: points, name: odd, positions: [[1, 2]], normals: [[3, 4]]}\n"
    )
    position, normal = arrays(points)
    np.testing.assert_allclose(position[:5, 0], [0.01, 0.03, 0.05, 0.07, 0.09])
    np.testing.assert_allclose(normal[:5], [[0, 1]] * 5, atol=1e-12)
    np.testing.assert_allclose((*position[5], *normal[5]), [0.001, 0.002, 0.6, 0.8])


def test_points_fit_a_session(read):
    points = read("- {kind: disc, centre: [0, 0], diameter: 160, count: 36}\n")
    again = [WorkpiecePoint.model_validate(entry) for entry in workpiece_entries(points)]
    assert tuple(again) == points
    lengths = [np.hypot(*p.normal) for p in points]
    np.testing.assert_allclose(lengths, 1.0, atol=1e-11)


def test_csv_outline(read, tmp_path):
    (tmp_path / "triangle.csv").write_text("x,y\n0,0\n60,0\n0,80\n")
    points = read("- {kind: file, path: triangle.csv, unit: mm, material: inside, spacing: 20}\n")
    position, normal = arrays(points)
    assert len(points) == 3 + 5 + 4
    np.testing.assert_allclose(normal[3:8], [[0.8, 0.6]] * 5, atol=1e-12)
    np.testing.assert_allclose(position[:, 0].max(), 0.054, atol=1e-12)


@pytest.fixture
def drawing(tmp_path):
    ezdxf = pytest.importorskip("ezdxf")
    from ezdxf import units

    def make(unit=units.MM):
        document = ezdxf.new(setup=True)
        document.units = unit
        return document, document.modelspace(), tmp_path / "part.dxf"

    return make


def test_dxf_of_lines_and_arcs(read, drawing):
    """A slot with round ends, its four pieces drawn in any order."""
    document, space, file = drawing()
    space.add_arc((40, 0), radius=10, start_angle=270, end_angle=90)
    space.add_line((-40, 10), (40, 10))
    space.add_line((-40, -10), (40, -10))
    space.add_arc((-40, 0), radius=10, start_angle=90, end_angle=270)
    space.add_circle((100, 0), radius=5, dxfattribs={"layer": "OTHER"})
    document.saveas(file)
    position, normal = arrays(read("- {kind: file, path: part.dxf, layer: '0', material: outside, spacing: 4}\n"))
    straight = np.abs(position[:, 0]) < 0.04
    np.testing.assert_allclose(np.abs(position[straight, 1]), 0.01)
    np.testing.assert_allclose(normal[straight], -np.sign(position[straight]) * [0, 1], atol=1e-12)
    centre = np.sign(position[~straight]) * [0.04, 0]
    np.testing.assert_allclose(position[~straight] + 0.01 * normal[~straight], centre, atol=1e-12)
    assert len(read("- {kind: file, path: part.dxf, material: outside, spacing: 4}\n")) == len(position) + 8


def test_dxf_polyline_with_bulge(read, drawing):
    document, space, file = drawing()
    # a half disc: bulge 1 is half a circle
    space.add_lwpolyline([(-30, 0, 0), (30, 0, 1)], format="xyb", close=True)
    document.saveas(file)
    position, normal = arrays(read("- {kind: file, path: part.dxf, material: inside, spacing: 5}\n"))
    arc = position[:, 1] > 1e-9
    np.testing.assert_allclose(np.linalg.norm(position[arc], axis=1), 0.03, atol=1e-12)
    np.testing.assert_allclose(normal[arc], position[arc] / 0.03, atol=1e-9)
    np.testing.assert_allclose(normal[~arc], [[0, -1]] * int((~arc).sum()), atol=1e-12)


@pytest.mark.parametrize("unit", [1, 2, 4, 5, 6, 13, 14])
def test_dxf_is_in_the_unit_that_the_drawing_says(read, drawing, unit):
    from ezdxf import units

    document, space, file = drawing(unit)
    space.add_circle((0, 0), radius=0.02 * units.conversion_factor(units.M, document.units))
    document.saveas(file)
    position, _ = arrays(read("- {kind: file, path: part.dxf, material: inside, spacing: 5}\n"))
    np.testing.assert_allclose(np.linalg.norm(position, axis=1), 0.02)


def test_dxf_ellipse_and_unit(read, drawing):
    document, space, file = drawing(unit=0)
    space.add_ellipse((0, 0), major_axis=(2, 0), ratio=0.5)
    document.saveas(file)
    text = "- {{kind: file, path: part.dxf, material: inside, spacing: 5{}}}\n"
    with pytest.raises(SessionError, match="does not say its unit"):
        read(text.format(""))
    position, normal = arrays(read(text.format(", unit: inch")))
    assert len(position) > 20
    a, b = 0.0508, 0.0254
    np.testing.assert_allclose((position[:, 0] / a) ** 2 + (position[:, 1] / b) ** 2, 1.0, atol=1e-5)
    exact = position / np.array([a * a, b * b])
    exact /= np.linalg.norm(exact, axis=1)[:, None]
    assert np.max(np.abs(exact - normal)) < 1e-2


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("- {kind: pin, centre: [0, 0], diameter: 12, count: 4, hue: 1}\n", r"line 4: unknown key 'features\[0\].hue'"),
        ("- {kind: gear}\n", r"features\[0\].kind is 'gear', not 'line', 'pin', .*"),
        ("- {start: [0, 0]}\n", r"the key 'features\[0\].kind' is missing"),
        ("- {kind: pin, centre: [1e308, 0], diameter: 12, count: 4}\n", r"features\[0\].centre\[0\] must be at most"),
        ("- {kind: pin, centre: [0, 0], diameter: 5e-324, count: 4}\n", r"features\[0\].diameter must be at least"),
        (
            "- {kind: line, start: [0, 0], end: [1e6, 0], material: left, spacing: 1e-6}\n",
            "an outline of more than 100000 points: is the spacing of 1e-09 m right",
        ),
        ("- {kind: line, start: [0, 0], end: [0, 0], material: left, count: 2}\n", "start and end are the same"),
        ("- {kind: line, start: [0, 0], end: [9, 0], material: left}\n", "must have either spacing or count"),
        ("- {kind: file, path: nothing.csv, material: inside, spacing: 1}\n", "does not say its unit"),
        ("- {kind: file, path: part.step, material: inside, spacing: 1}\n", r"read from \.dxf and \.csv"),
    ],
)
def test_one_line_says_what_is_wrong(read, text, message):
    with pytest.raises(SessionError, match=message) as caught:
        read(text)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    "text",
    ["X,Y\n0,0\n60,0\n0,80.5\n", "# a part\nX;Y\n0;0\n60;0\n0;80,5\n", "x; y; note\n0; 0; a\n60; 0; b\n0; 80.5; c\n"],
)
def test_csv_outline_of_a_spreadsheet(read, tmp_path, text):
    (tmp_path / "triangle.csv").write_text(text)
    points = read("- {kind: file, path: triangle.csv, unit: mm, material: inside, spacing: 20}\n")
    (tmp_path / "triangle.csv").write_text("x,y\n0,0\n60,0\n0,80.5\n")
    assert points == read("- {kind: file, path: triangle.csv, unit: mm, material: inside, spacing: 20}\n")


def test_csv_defects(read, tmp_path):
    text = "- {kind: file, path: part.csv, unit: mm, material: inside, spacing: 1}\n"
    for content, message in (
        ("a,b\n1,2\n", "column 'x' is missing"),
        ("x,X,y\n1,1,2\n", "column 'x' stands twice"),
        ("x,y\n1,2\nthree,4\n", "row 2: x and y must be numbers"),
        ("x,y\n0,0\n1e308,0\n0,1e308\n", "row 2: x and y must be numbers, of 1e\\+06 at most"),
        ("x,y\n0,0\n1e-300,0\n0,1e-300\n", "needs at least 3 different corners"),
        ("x,y\n1,2\n1,2\n", "needs at least 3 different corners"),
    ):
        (tmp_path / "part.csv").write_text(content)
        with pytest.raises(SessionError, match=message):
            read(text)


def test_not_a_drawing(read, tmp_path):
    pytest.importorskip("ezdxf")
    (tmp_path / "part.dxf").write_text("hello\n")
    with pytest.raises(SessionError, match=r"part\.dxf"):
        read("- {kind: file, path: part.dxf, material: inside, spacing: 1}\n")


def test_a_layer_without_any_line(read, drawing):
    document, space, path = drawing()
    space.add_circle((0, 0), radius=5)
    space.add_text("a note")
    document.saveas(path)
    with pytest.raises(SessionError, match=r"part\.dxf: no line, arc, .* or spline on the layer 'CUT'"):
        read("- {kind: file, path: part.dxf, layer: CUT, material: inside, spacing: 1}\n")


def test_hole_smaller_than_the_stylus(read):
    head = HEAD.replace("unit: mm\n", "unit: mm\nstylus_diameter: 6\n")
    with pytest.raises(SessionError, match="does not fit into a hole"):
        read("- {kind: hole, centre: [0, 0], diameter: 5, count: 4}\n", head)
