# SPDX-License-Identifier: Apache-2.0
"""Stable windows, simulated samples and the environment of a moment, without ROS."""

from collections import deque

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from machine_tool_calibration.instruments.samples import Batch, NotYet, Recent, is_steady
from machine_tool_calibration.nodes.environment import interpolate
from machine_tool_calibration.nodes.shared import procedure_file
from machine_tool_calibration.procedure import read_procedure
from machine_tool_calibration.simulation.interferometer import SimulatedSource
from machine_tool_calibration.simulation.optics import make_optics
from machine_tool_calibration.simulation.site import Beam, Site, SiteSpec

from .conftest import SITE

MS = 1_000_000


def batch(start, count, path):
    return Batch(start + MS * np.arange(count), np.broadcast_to(np.asarray(path, float), count).copy())


def test_a_window_is_the_newest_samples():
    recent = Recent(1.0)
    recent.add(batch(0, 500, 1.0))
    recent.add(batch(500 * MS, 500, 2.0))
    window = recent.window(0.1, 1e-9)
    assert (window.path, window.spread, window.samples) == (2.0, 0.0, 101)
    assert (window.start, window.end) == (899 * MS, 999 * MS)


@pytest.mark.parametrize(
    ("path", "kind"), [(np.linspace(0, 1e-3, 500), "unstable"), (np.where(np.arange(500) == 450, np.nan, 0.0), "beam")]
)
def test_no_window_while_the_path_changes_or_is_missing(path, kind):
    recent = Recent(1.0)
    recent.add(batch(0, 500, path))
    with pytest.raises(NotYet) as caught:
        recent.window(0.1, 1e-6)
    assert caught.value.kind == kind


def test_no_window_before_enough_samples():
    recent = Recent(1.0)
    with pytest.raises(NotYet, match="no sample"):
        recent.window(0.1, 1e-6)
    recent.add(batch(0, 50, 0.0))
    with pytest.raises(NotYet, match="too few"):
        recent.window(0.1, 1e-6)


def test_noise_is_steady_and_a_slow_creep_is_not():
    noise = 1e-7 * np.random.default_rng(1).normal(size=1000)
    assert is_steady(noise, 1e-7)
    assert not is_steady(noise + np.linspace(0, 1e-6, 1000), 1e-7)


def test_old_samples_are_forgotten():
    recent = Recent(0.2)
    for index in range(100):
        recent.add(batch(index * 100 * MS, 100, 0.0))
    assert len(recent._batches) <= 4


@given(st.permutations([(0, 1.0), (10, 2.0), (20, 4.0)]), st.integers(-30, 50))
def test_environment_of_a_moment_does_not_depend_on_the_order_of_messages(samples, stamp):
    value = interpolate(deque(samples), stamp, age=15)
    near = [entry for entry in [(0, 1.0), (10, 2.0), (20, 4.0)] if abs(entry[0] - stamp) <= 15]
    if not near:
        assert value is None
    else:
        assert value == pytest.approx(np.interp(stamp, *zip(*near, strict=True)))


@pytest.fixture
def source():
    made = SimulatedSource(Site(SiteSpec(**{**SITE, "noise": 3e-7})), 0, 1000.0, 2e-8)
    made.set_setup(0, "A", 0, Beam(np.array([-0.35, 0.0, 0.0]), np.array([1.0, 0.0, 0.0])))
    return made


def hold(source, begin, end, x):
    source.add_pose(begin, np.array([x, 0.0, 0.0]))
    source.add_pose(end, np.array([x, 0.0, 0.0]))


def test_a_reading_in_simulated_time_is_the_path_and_its_noise(source):
    values = []
    for index in range(400):
        hold(source, index * 1000 * MS, (index * 1000 + 500) * MS, 0.1)
        window = source.window(0.1)
        assert (window.start, window.end) == ((index * 1000 + 400) * MS, (index * 1000 + 500) * MS)
        assert window.path == pytest.approx(source.averaged.path.mean(), abs=1e-12)
        values.append(window.path)
    assert np.mean(values) == pytest.approx(0.45, abs=5 * 3e-7 / 20)
    assert np.std(values) == pytest.approx(3e-7, rel=0.15)


def test_no_reading_while_the_axes_move_or_have_not_stood_long_enough(source):
    hold(source, 0, 50 * MS, 0.1)
    with pytest.raises(NotYet, match="not stood still for"):
        source.window(0.1)
    source.add_pose(500 * MS, np.array([0.2, 0.0, 0.0]))
    with pytest.raises(NotYet, match="not stood still"):
        source.window(0.1)


def test_a_target_beside_the_beam_is_not_read(source):
    source.add_pose(0, np.array([0.1, 0.003, 0.0]))
    source.add_pose(500 * MS, np.array([0.1, 0.003, 0.0]))
    with pytest.raises(NotYet) as caught:
        source.window(0.1)
    assert caught.value.kind == "beam"


def test_what_was_said_before_the_last_command_is_no_lost_beam(source):
    """The axes and the pointer may be heard later by the instrument than by the procedure, and one before the other."""
    hold(source, 0, 500 * MS, 0.1)
    source.expect(600 * MS)
    for stamp in (1100 * MS, 1600 * MS):
        source.add_pose(stamp, np.array([0.1, 0.2, 0.0]))
    with pytest.raises(NotYet, match="pointer has not answered") as caught:
        source.window(0.1)
    assert caught.value.kind == "other"
    along = np.array([0.45, 0.2, 0.0]) / np.hypot(0.45, 0.2)
    beam = Beam(np.array([-0.35, 0.0, 0.0]), along)
    source.set_setup(700 * MS, "A", 0, beam)
    assert source.window(0.1).path == pytest.approx(np.hypot(0.45, 0.2), abs=2e-6)
    source.expect(1700 * MS)
    source.set_setup(1800 * MS, "A", 0, Beam(beam.origin, np.array([1.0, 0.0, 0.0])))
    with pytest.raises(NotYet, match="since their last command") as caught:
        source.window(0.1)
    assert caught.value.kind == "other"
    assert source.lost() == ""


def test_moving_the_instrument_to_another_setup_loses_the_count(source):
    assert source.lost() == ""
    moved = source.set_setup(1, "B", 1, Beam(np.zeros(3), np.array([1.0, 0.0, 0.0])))
    assert moved == "the instrument was moved from setup A to B"
    assert source.lost() == ""
    assert source.set_setup(2, "B", 1) == ""
    assert source.lost() == ""


def test_the_stream_follows_the_motion_without_gaps(source):
    batches = []
    for tick in range(100):
        source.add_pose(tick * 10 * MS, np.array([0.001 * tick, 0.0, 0.0]))
        batches.append(source.take(tick * 10 * MS))
    time = np.concatenate([entry.time for entry in batches])
    path = np.concatenate([entry.path for entry in batches])
    assert set(np.diff(time)) == {MS}
    assert np.abs(path - (0.35 + 0.1 * time * 1e-9)).max() < 5e-6


@pytest.mark.long
def test_the_streams_noise_has_the_declared_size(source):
    batches = []
    for tick in range(4000):
        source.add_pose(tick * 50 * MS, np.array([0.1, 0.0, 0.0]))
        batches.append(source.take(tick * 50 * MS).path)
    assert np.concatenate(batches).std() == pytest.approx(3e-7, rel=0.15)


def test_a_site_is_the_same_for_every_process():
    one, two = Site(SiteSpec(**SITE)), Site(SiteSpec(**SITE))
    moment = one.moment(12.0, {"x": 0.1, "y": 0.2}, {"x": 1, "y": -1})
    assert one.functional_point(moment).tolist() == two.functional_point(moment).tolist()
    assert one.sensed(7.0) == two.sensed(7.0)


def test_where_the_tool_was_says_nothing_about_the_table():
    """The session may come after the true positions of what it does not measure."""
    source = SimulatedSource(Site(SiteSpec()), 0, 1e3, 0.0)
    for stamp in (400 * MS, 1400 * MS):
        source.add_pose(stamp, np.zeros(3))
    source.look_at(make_optics(source.site, read_procedure(procedure_file("rotary_axis")).session))
    source.set_setup(0, "A", 0, Beam(np.array([1.0, 0.0, 0.0]), np.array([-1.0, 0.0, 0.0])))
    with pytest.raises(NotYet, match="have not said where they are"):
        source.window(0.1)
