# SPDX-License-Identifier: Apache-2.0
"""Features of a probed part: by hand, against the truth, in any frame, without a length, by draws."""

from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from scipy.optimize import least_squares

from machine_tool_calibration.coverage import COVERAGE
from machine_tool_calibration.errors import CalibrationError
from machine_tool_calibration.methods.fitted import fit_sessions
from machine_tool_calibration.methods.probing.features import Features, features, monte_carlo
from machine_tool_calibration.methods.probing.geometry import Circle, Line, element, through
from machine_tool_calibration.methods.probing.model import Responses
from machine_tool_calibration.model.fit import Fit
from machine_tool_calibration.procedure.workpiece.description import Workpiece, workpiece_points
from machine_tool_calibration.session.session import Session
from machine_tool_calibration.simulation import PartPoint

TOUCH = 1e-6
DRAWS = 1000
PLATE = Workpiece.model_validate(
    {
        "format": "mtcal-workpiece/1",
        "unit": "mm",
        "features": [
            {"kind": "pin", "name": "a", "centre": [70, 0], "diameter": 12, "count": 4},
            {"kind": "pin", "name": "b", "centre": [-60, 35], "diameter": 16, "count": 6},
            {"kind": "hole", "name": "c", "centre": [10, 80], "diameter": 30, "count": 5},
            {"kind": "sphere", "name": "d", "centre": [-20, -75], "diameter": 25, "count": 8},
            {"kind": "line", "name": "top", "start": [50, 60], "end": [90, 60], "material": "right", "count": 6},
            {"kind": "line", "name": "foot", "start": [90, -50], "end": [40, -50], "material": "right", "count": 5},
            {"kind": "line", "name": "side", "start": [-90, -50], "end": [-90, 50], "material": "right", "count": 7},
            {"kind": "points", "name": "free", "positions": [[0, 50], [30, 20], [-30, 30]],
             "normals": [[0, 1], [1, 1], [-1, 2]]},
        ],
    }
)  # fmt: skip
FRAMES = (None, ("a", "b"), ("d", "c"), ("c", "side"))
ASKED: dict[str, Any] = {
    "distances": [("a", "b"), ("d", "side"), ("top", "foot")],
    "angles": [("top", "side"), ("b", "a", "d")],
}


@pytest.fixture
def part(make: Callable[..., Any]) -> Callable[..., Any]:
    """A measurement of the plate at five angles, exact readings; seven nodes of the axes' tables cover it."""
    points = tuple(
        PartPoint(id=p.id, feature=p.feature, position=p.position, normal=p.normal)
        for p in workpiece_points(PLATE, None)
    )
    angles = tuple(np.radians((0, 40, 95, 160, 250)))
    return lambda **plan: make(**{"points": points, "angles": angles, "noise": TOUCH, **plan})


def fitted(session: Session) -> Fit:
    return fit_sessions(session).joint.fits[0]


def table(found: Features) -> dict[str, tuple[float, float]]:
    return {q.name: (v, u) for q, v, u in zip(found.quantities, found.deviation, found.uncertainty, strict=True)}


def test_a_pin_of_four_points_by_hand() -> None:
    normal = np.array([[1.0, 0], [0, 1], [-1, 0], [0, -1]])
    centre = np.array([0.2, 0.1])
    pin = element("pin", np.arange(4), centre + 0.006 * normal, normal, np.ones(4, dtype=bool))
    assert isinstance(pin, Circle) and not pin.hole
    np.testing.assert_allclose(pin.rows, [[0.5, 0, -0.5, 0], [0, 0.5, 0, -0.5], [0.25] * 4], atol=1e-12)
    # Independent touches, and an error that all points share: it is in the radius alone.
    deviation, covariance = Responses(
        np.array([3e-6, 1e-6, -1e-6, 5e-6]),
        np.full(4, TOUCH**2),
        np.full((4, 1), 2e-6),
        np.zeros((4, 0)),
        np.zeros(4),
        np.ones(4, dtype=bool),
    ).combine(pin.rows)
    np.testing.assert_allclose(deviation, [2e-6, -2e-6, 2e-6], atol=1e-15)
    np.testing.assert_allclose(covariance, np.diag([TOUCH**2 / 2, TOUCH**2 / 2, TOUCH**2 / 4 + 4e-12]), atol=1e-20)


def test_material_that_grows_makes_a_hole_smaller_and_a_wall_stand_out() -> None:
    angle = np.arange(3) * 2.1
    radial = np.column_stack([np.cos(angle), np.sin(angle)])
    hole = element("hole", np.arange(3), 0.01 * radial, -radial, np.ones(3, dtype=bool))
    assert isinstance(hole, Circle) and hole.hole
    np.testing.assert_allclose(hole.rows @ np.ones(3), [0, 0, -1], atol=1e-12)
    place = np.column_stack([np.full(3, 0.05), [0.0, 0.01, 0.04]])
    wall = element("wall", np.arange(3), place, np.tile([1.0, 0], (3, 1)), np.ones(3, dtype=bool))
    assert isinstance(wall, Line)
    np.testing.assert_allclose(wall.rows @ np.ones(3), [1, 0], atol=1e-12)
    # Turned counter-clockwise, what is higher goes towards -x.
    np.testing.assert_allclose(wall.rows @ (-1e-5 * (place[:, 1] - place[:, 1].mean())), [0, 1e-5], atol=1e-15)


def test_the_circle_and_the_line_through_centres_by_hand() -> None:
    def pin(k: int, place: np.ndarray) -> Circle:
        """Its x is the error of one point, its y that of another one."""
        rows = np.zeros((3, 8))
        rows[0, 2 * k] = rows[1, 2 * k + 1] = 1.0
        return Circle(f"pin{k}", np.array([2 * k, 2 * k + 1]), place, rows, 0.006, False)

    corners = 0.1 * np.array([[1.0, 0], [0, 1], [-1, 0], [0, -1]]) + [0.02, 0.03]
    pitch = through("pitch", [pin(k, place) for k, place in enumerate(corners)])
    assert isinstance(pitch, Circle) and not pitch.hole
    assert (*pitch.place, pitch.radius) == pytest.approx((0.02, 0.03, 0.1))
    dx, dy = 2 * np.arange(4), 2 * np.arange(4) + 1
    np.testing.assert_allclose(pitch.rows[0, dx], [0.5, 0, 0.5, 0], atol=1e-12)
    np.testing.assert_allclose(pitch.rows[2, [*dx, *dy]], np.array([1, 0, -1, 0, 0, 1, 0, -1]) / 4, atol=1e-12)
    row = through("row", [pin(k, np.array([0.05 * k, 0.01])) for k in range(4)])
    assert isinstance(row, Line)
    sense = row.normal[1]
    np.testing.assert_allclose(row.rows[0, dy], np.full(4, sense / 4), atol=1e-12)
    np.testing.assert_allclose(row.rows[:, dx], 0.0, atol=1e-12)
    # The last one 10 um higher than the first over 150 mm: turned counter-clockwise.
    np.testing.assert_allclose(row.rows[1, dy] @ np.linspace(0, 1e-5, 4), 1e-5 / 0.15, rtol=1e-9)


def actual(points: np.ndarray, normal: np.ndarray, nominal: tuple[float, ...]) -> np.ndarray:
    """Centre and radius of the circle nearest to points, by iteration."""
    return np.asarray(
        least_squares(lambda x: np.hypot(*(points - x[:2]).T) - x[2], nominal, xtol=1e-15, ftol=1e-15, gtol=1e-15).x
    )


def test_exact_readings_give_the_true_features(part: Callable[..., Any]) -> None:
    case = part(form=4e-8)
    found = features(fitted(case.session), frame=("a", "b"), **ASKED)
    points = case.session.description.workpiece
    place, normal = np.array([p.position for p in points]), np.array([p.normal for p in points])
    moved = place + np.array(case.truth.expected["workpiece_error"])[:, None] * normal
    circles = {
        one.name: actual(moved[one.index], normal[one.index], (*one.place, one.radius))
        for one in found.elements
        if isinstance(one, Circle)
    }
    # Into the frame: a where the drawing has it, b at its y.
    nominal = {one.name: one.place for one in found.elements}
    turn = (nominal["b"] - nominal["a"])[1] - (circles["b"] - circles["a"])[1]
    turn /= (nominal["b"] - nominal["a"])[0]
    table_ = table(found)
    for name, (x, y, radius) in circles.items():
        dx, dy = x - circles["a"][0], y - circles["a"][1]
        there = nominal["a"] + (dx - turn * dy, dy + turn * dx)
        assert table_[f"{name} x"][0] == pytest.approx(there[0] - nominal[name][0], abs=2e-12)
        assert table_[f"{name} y"][0] == pytest.approx(there[1] - nominal[name][1], abs=2e-12)
        r = next(q.nominal for q in found.quantities if q.name == f"{name} radius")
        assert table_[f"{name} radius"][0] == pytest.approx(radius - r, abs=2e-12)
    between = np.linalg.norm(circles["b"][:2] - circles["a"][:2]) - np.linalg.norm(nominal["b"] - nominal["a"])
    assert table_["a-b distance"][0] == pytest.approx(between, abs=2e-12)
    assert abs(between) > 1e-8
    # Walls: slopes and offsets of straight lines through the moved points.
    slope = {}
    for wall in (one for one in found.elements if isinstance(one, Line)):
        off = (moved[wall.index] - wall.place) @ wall.normal
        slope[wall.name] = np.polyfit((place[wall.index] - wall.place) @ wall.along, off, 1)
    assert table_["top-side angle"][0] == pytest.approx(slope["side"][0] - slope["top"][0], abs=5e-11)
    top = next(one for one in found.elements if one.name == "top")
    assert isinstance(top, Line)
    along = float((nominal["foot"] - nominal["top"]) @ top.along)
    apart = slope["top"][1] + slope["foot"][1] + along * slope["top"][0]
    assert table_["top-foot distance"][0] == pytest.approx(apart, abs=2e-12)
    assert found.left_out == {"free": "its points lie neither on a circle nor on a straight line"}


def test_distances_angles_and_radii_are_the_same_in_every_frame(part: Callable[..., Any]) -> None:
    fit = fitted(part().noisy(np.random.default_rng(1)))
    tables = [table(features(fit, frame=frame, **ASKED)) for frame in FRAMES]
    same = [n for n in tables[0] if n.rsplit(" ", 1)[1] in ("distance", "angle", "radius")]
    assert len(same) == 9
    for one, other in pairwise(tables):
        np.testing.assert_allclose([one[n] for n in same], [other[n] for n in same], rtol=1e-6, atol=1e-15)
    assert tables[1]["b y"] == pytest.approx((0.0, 0.0), abs=1e-14)
    assert tables[2]["c x"] == pytest.approx((0.0, 0.0), abs=1e-14)
    assert tables[3]["side direction"] == pytest.approx((0.0, 0.0), abs=1e-14)
    assert tables[1]["c x"][1] != pytest.approx(tables[2]["c x"][1], rel=0.01)


def test_without_a_known_length_the_growth_of_the_whole_changes_nothing(part: Callable[..., Any]) -> None:
    def grown(session: Session) -> Session:
        points = {p.id: 1e-4 * float(np.dot(p.position, p.normal)) for p in session.description.workpiece}
        more = np.array([points[str(name)] for name in session.readings.labels["point"]])
        readings = session.readings
        return session.with_readings(replace(readings, displacement=readings.displacement + more))

    for length, change in ((None, 0.0), (2e-7, 1e-4)):
        session = part(known_uncertainty=length).session
        before, after = (features(fitted(s), frame=("a", "b"), **ASKED) for s in (session, grown(session)))
        lengths = np.array([q.unit == "m" and q.what in ("distance", "radius") for q in before.quantities])
        nominal = np.array([q.nominal for q in before.quantities])
        moved = after.deviation - before.deviation
        np.testing.assert_allclose(moved[lengths], change * nominal[lengths], atol=1e-9)
        angles = np.array([q.what == "angle" for q in before.quantities])
        np.testing.assert_allclose(moved[angles], 0.0, atol=1e-9)
        assert ("no length was measured" in before.datum) == (length is None)
        assert np.all(np.isfinite(before.uncertainty))


@pytest.mark.parametrize("distribution", ["normal", "rectangular", "triangular"])
def test_draws_agree_with_the_closed_form(part: Callable[..., Any], distribution: Any) -> None:
    fit = fitted(part().noisy(np.random.default_rng(2)))
    found = features(fit, frame=("a", "b"), **ASKED)
    drawn = monte_carlo(fit, found.rows, DRAWS, distribution)
    free = found.uncertainty > 1e-12
    assert free.sum() == len(free) - 3
    # Chance of a standard deviation from so many draws, five times: there are thirty quantities.
    chance = 5.0 / np.sqrt(2.0 * (DRAWS - 1))
    np.testing.assert_allclose(drawn.uncertainty[free], found.uncertainty[free], rtol=chance)
    np.testing.assert_allclose(drawn.high[free] - drawn.low[free], 4.0 * found.uncertainty[free], rtol=2 * chance)


def test_one_rectangular_touch_has_a_narrower_interval_than_a_normal_one(part: Callable[..., Any]) -> None:
    session = part(repeats=3).session
    readings = session.readings
    points = np.array([k for k, p in enumerate(session.description.workpiece) if p.feature == "d"])
    first = session.description.workpiece[points[0]].id
    once = (readings.labels["point"] != first) | ((readings.setup == 2) & (readings.repeat == 1))
    fit = fitted(session.with_readings(readings.select(once)))
    # How far the first point of the sphere is off the circle through all of them.
    design = np.column_stack([[session.description.workpiece[k].normal for k in points], np.ones(len(points))])
    row = np.zeros((1, len(session.description.workpiece)))
    row[0, points] = (np.eye(len(points)) - design @ np.linalg.pinv(design))[0]
    wide = {}
    for distribution in ("normal", "rectangular"):
        drawn = monte_carlo(fit, row, 20_000, distribution)
        wide[distribution] = (drawn.high[0] - drawn.low[0]) / 2 / drawn.uncertainty[0]
    # Alone it would be 0.9545 of the square root of 3; other touches add a little.
    assert wide["normal"] == pytest.approx(2.0, rel=0.03)
    assert np.sqrt(3) * COVERAGE < wide["rectangular"] < 1.9


def test_what_does_not_reproduce_is_among_the_inputs(part: Callable[..., Any]) -> None:
    session = part().noisy(np.random.default_rng(4))
    readings = session.readings
    drift = np.random.default_rng(5).normal(size=5)[readings.setup] * 5e-6
    time = readings.column("time")
    for k in range(5):
        mine = readings.setup == k
        drift[mine] *= np.linspace(-1, 1, int(mine.sum()))[np.argsort(np.argsort(time[mine]))]
    fit = fitted(session.with_readings(replace(readings, displacement=readings.displacement + drift)))
    assert fit.joint.marginal.ratios.max() > 1.0
    found = features(fit, frame=("a", "b"))
    drawn = monte_carlo(fit, found.rows, 4 * DRAWS)
    free = found.uncertainty > 1e-12
    # The closed form averages over the sizes that are possible, the draws have their root mean square.
    np.testing.assert_allclose(drawn.uncertainty[free], found.uncertainty[free], rtol=0.1)


def test_one_angle_determines_no_feature(part: Callable[..., Any]) -> None:
    session = part(repeats=4).session
    fit = fitted(session.with_readings(session.readings.select(session.readings.setup == 0)))
    found = features(fit, frame=("a", "b"), **ASKED)
    fixed = {"a x", "a y", "b y"}
    assert all(np.isnan(v) for name, (v, _) in table(found).items() if name not in fixed)
    assert np.isnan(monte_carlo(fit, found.rows).uncertainty).sum() >= len(found.quantities) - 3


@pytest.mark.parametrize(
    ("asked", "message"),
    [
        ({"frame": ("a", "z")}, "frame: no feature 'z'; there are a, b, c, d, top, foot, side"),
        ({"frame": ("top", "a")}, "frame top,a: the first one, top, is a line and has no centre"),
        ({"frame": ("a", "a")}, "frame a,a: the two centres coincide and give no direction"),
        ({"distances": [("a", "aa")]}, "distance: no feature 'aa' (did you mean 'a'?)"),
        ({"distances": [("a", "a")]}, "distance a,a: their centres coincide"),
        ({"distances": [("top", "side")]}, "distance top,side: the lines are not parallel"),
        ({"centres": {"p": ["a", "zz"]}}, "feature p: no feature 'zz'; there are a, b, c, d, top, foot, side"),
        ({"centres": {"a": ["b", "c"]}}, "feature a: there is one of that name already"),
        ({"centres": {"p": ["a", "t*"]}}, "feature p: top is a line and has no centre"),
        ({"centres": {"p": ["a", "b", "c", "d"]}}, "feature p: its points lie neither on a circle"),
        ({"centres": {"p": ["a"]}}, "feature p: its points lie neither on a circle"),
        ({"angles": [("top", "a")]}, "angle top,a: it is between two lines, or at the second of three circles"),
        ({"angles": [("a", "a", "b")]}, "angle a,a,b: the centres of a and a coincide"),
        ({"centres": {"p": []}}, "feature p: no centre is given"),
        ({"named": {"e": []}}, "feature e: no point is given"),
        ({"named": {"e": ["0", "x1"]}}, "feature e: the workpiece has no point 'x1'"),
        ({"named": {"e": ["0", "0"]}}, "feature e: a point stands in it twice"),
        ({"named": {"e": ["0", "1"]}}, "feature e: 2 touched points do not determine centre and radius"),
        ({"named": {"e": ["0", "5", "9"]}}, "feature e: its points lie neither on a circle nor on a straight line"),
    ],
)  # fmt: skip
def test_what_cannot_be_asked_is_one_line(exact_fit: Fit, asked: dict[str, Any], message: str) -> None:
    with pytest.raises(CalibrationError) as raised:
        features(exact_fit, **asked)
    assert str(raised.value).startswith(message)
    assert "\n" not in str(raised.value)


@pytest.fixture
def exact_fit(part: Callable[..., Any]) -> Fit:
    return fitted(part().session)


def test_draws_that_cannot_be(exact_fit: Fit) -> None:
    rows = np.zeros((1, len(exact_fit.model.observations.session.description.workpiece)))
    with pytest.raises(CalibrationError, match="10 draws are too few"):
        monte_carlo(exact_fit, rows, 10)
    with pytest.raises(CalibrationError, match="no distribution 'flat'; there are normal, rectangular, triangular"):
        monte_carlo(exact_fit, rows, 1000, "flat")
