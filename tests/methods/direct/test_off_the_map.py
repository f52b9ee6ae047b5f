# SPDX-License-Identifier: Apache-2.0
"""Maps and their uncertainty where straight lines between evenly spread nodes do not follow an axis."""

import numpy as np
import pytest
from tests import plates

from machine_tool_calibration.diagnosis.diagnose import diagnose
from machine_tool_calibration.diagnosis.improve import improve
from machine_tool_calibration.methods.fitted import FitRequest
from machine_tool_calibration.methods.identify import identify, identify_sessions
from machine_tool_calibration.reports.goodness import off_the_map_words

U = 3e-7


def scan(deviation: np.ndarray, x: np.ndarray, passes: int, seed: int = 0):
    """Passes along an axis of which each place (k,) deviates (k,), m."""
    at, noise = np.tile(x, passes), np.random.default_rng(seed).normal(size=passes * len(x))
    columns = {"time": 10.0 * np.arange(len(at)), "x": at, "displacement": np.tile(deviation, passes) + U * noise}
    return plates.session(columns, U, "none", ("EXX",), np.repeat(np.arange(passes), len(x)))


X = np.linspace(0.0, 2.0, 401)
SMOOTH, STEEP = 3e-6 * np.sin(3.0 * X), 6e-5 * np.exp(-X / 0.05)


def test_a_steep_end_that_was_read_once_is_within_its_uncertainty() -> None:
    found = identify(scan(SMOOTH + STEEP, X, 1)).error_map
    off = np.abs(found.error[:, 0] - SMOOTH - STEEP)
    assert off.max() > 30.0 * U  # between the first nodes the map is far off,
    assert (off < 2.0 * found.uncertainty[:, 0]).all()  # and says so there,
    assert (found.uncertainty[X > 1.0, 0] < 0.3 * off.max()).all()  # and not where it follows


@pytest.mark.parametrize("passes", [1, 2])
def test_a_wave_that_no_table_follows_is_within_the_uncertainty(passes: int) -> None:
    wave = 1e-6 * np.sin(2.0 * np.pi * X / 0.0137)
    found = identify(scan(SMOOTH + wave, X, passes)).error_map
    off, u = np.abs(found.error[:, 0] - SMOOTH - wave), found.uncertainty[:, 0]
    assert off.max() > 3.0 * U
    assert (off < 2.0 * u).all()
    assert np.median(u) == pytest.approx(1e-6 / np.sqrt(2.0), rel=0.1)


def test_two_sessions_together_are_as_uncertain_where_both_are_off_the_map() -> None:
    wave = 1e-6 * np.sin(2.0 * np.pi * X / 0.0137)
    both = tuple(scan((SMOOTH + wave)[::step], X[::step], 2, step) for step in (1, 2))
    alone, found = (identify_sessions(FitRequest(own, "ab"[: len(own)])).error_map for own in (both[:1], both))
    off = np.abs(found.error[:, 0] - np.interp(found.points[:, 0], X, SMOOTH + wave))
    assert (off < 2.0 * found.uncertainty[:, 0]).all()
    assert np.median(found.uncertainty[:, 0]) > 0.9 * np.median(alone.uncertainty[:, 0])
    assert found.content["off_the_map"].max() > 2.0 * U


@pytest.mark.parametrize("bend", [STEEP, 2e-5 * np.exp(-(((X - 0.83) / 0.03) ** 2))], ids=["steep", "worn"])
def test_what_both_passes_show_has_nodes_of_its_own(bend: np.ndarray) -> None:
    found = identify(scan(SMOOTH + bend, X, 2)).error_map
    off = found.error[:, 0] - SMOOTH - bend
    assert np.sqrt(np.mean(off**2)) < 0.5 * U
    assert np.abs(off).max() < 4.0 * U  # evenly spread ones are off by 20 U


def test_what_one_pass_shows_has_none() -> None:
    """A step in time, half-way through the second pass, is at no place of the axis."""
    session = scan(SMOOTH, X, 2)
    late = session.readings.row >= 3 * len(X) // 2
    moved = plates.with_columns(session, session.readings.displacement + 10.0 * U * late)
    nodes = [len(identify(one).error_map.content["tables"]["EXX"]["nodes"]) for one in (session, moved)]
    assert nodes[0] == nodes[1] == 21


@pytest.mark.long
def test_a_wave_beside_a_steep_end_is_found() -> None:
    wave = 6e-7 * np.sin(2.0 * np.pi * X / 0.0327 + 0.4)
    found = diagnose(scan(SMOOTH + STEEP + wave, X, 2))
    assert "pitch_periodic_x" in found.accepted
    assert found.search.of("pitch_periodic_x").shape[0] == pytest.approx(0.0327, rel=0.01)


@pytest.mark.long
def test_noise_alone_widens_nothing() -> None:
    x = np.linspace(0.0, 2.0, 401)
    widest = [identify(scan(3e-6 * np.sin(3.0 * x), x, 2, seed)).error_map.uncertainty[:, 0].max() for seed in range(6)]
    assert max(widest) < U / 2.0  # ten readings and more tell a node


@pytest.mark.long(but=("20.26",))
@pytest.mark.parametrize("period", [20.26, 23.7])
def test_a_wave_between_the_tried_ones_is_one_of_the_axis(period: float) -> None:
    """In a single scan time is the place, and waves in time are tried more finely; in so many steps of 5 mm."""
    wave = 4e-7 * np.sin(2.0 * np.pi * X / (5e-3 * period) + 1.0)
    found = diagnose(scan(SMOOTH + wave, X, 1))
    assert found.accepted == ("pitch_periodic_x",)
    lead = found.search.of("pitch_periodic_x").shape[0]
    assert lead == pytest.approx(5e-3 * period, rel=0.01)


@pytest.mark.long
def test_a_second_wave_is_found_beside_the_first_and_none_where_there_is_none() -> None:
    first, second = (size * np.sin(2.0 * np.pi * X / lead) for size, lead in ((2e-6, 0.02), (4e-7, 0.0483)))
    found = improve(scan(SMOOTH + first + second, X, 1))
    assert found.accepted == ("pitch_periodic_x", "second_periodic_x")
    leads = {p.name: p.value for p in found.steps[-1].result.parameters if p.name.endswith(".lead")}
    assert leads == pytest.approx({"pitch_periodic_x.lead": 0.02, "second_periodic_x.lead": 0.0483}, rel=0.01)
    assert improve(scan(SMOOTH + first, X, 1)).accepted == ("pitch_periodic_x",)


def test_a_place_that_is_off_the_map_is_named() -> None:
    """A hole of a plate that two setups find at the same wrong place, which tables of the axes cannot follow."""
    rng, (x, y) = np.random.default_rng(3), (axis.ravel() for axis in np.meshgrid(*[np.linspace(0.0, 0.3, 8)] * 2))
    hole = np.where((x == x[19]) & (y == y[19]), 2e-5, 0.0)
    columns = {"x": np.tile(x, 2), "y": np.tile(y, 2), "gz": 1.0}
    columns["displacement"] = np.tile(hole, 2) + 1e-6 * rng.normal(size=128)
    setup = np.repeat([0, 1], 64).tolist()
    found = identify(plates.session(columns, 1e-6, "offset", ["EZX", "EZY"], None, "A", "B", setup=setup))
    content = found.error_map.content
    (at,) = np.flatnonzero(content["off_the_map"] > 1e-5)
    np.testing.assert_allclose(found.error_map.points[at, :2], [x[19], y[19]])
    (says,) = off_the_map_words(content)
    assert f"x = {1e3 * x[19]:.4g} mm" in says
    assert not list(off_the_map_words({**content, "off_the_map": np.zeros(64)}))
