# SPDX-License-Identifier: Apache-2.0
"""Each instrument's geometry against cases worked out by hand."""

import numpy as np
import pytest

from machine_tool_calibration.arrays import unit_vectors
from machine_tool_calibration.simulation.flaws import STANDARD, refractivity, vapour_pressure
from machine_tool_calibration.simulation.sensors import (
    Pointer,
    across,
    aim,
    distance,
    mirror_path,
    probed,
    sensed_path,
    tilted,
)  # fmt: skip


def _off_standard(*air: float) -> np.ndarray:
    return refractivity(*air) - refractivity(*STANDARD)


def test_pointing_uses_all_four_quadrants():
    station = np.zeros((4, 3))
    target = np.array([[1, 1, 0], [-1, 1, 0], [-1, -1, 0], [1, -1, np.sqrt(2)]], float)
    azimuth, elevation = aim(station, target)
    np.testing.assert_allclose(azimuth, np.radians([45, 135, -135, -45]))
    np.testing.assert_allclose(elevation, [0, 0, 0, np.pi / 4])
    assert not aim(station, target, 2)[1].any()


def test_beam_that_passes_beside_the_target_reads_the_projection():
    """Ibaraki et al. 2014: 0.8 mm off the beam at 320 mm is 1.0 um."""
    target = np.array([[0.32, 0.0008, 0.0]])
    origin, direction = Pointer().beam(np.zeros(1), np.zeros(1), np.zeros((1, 3)))
    error = distance(target, origin) - sensed_path(target, origin, direction)
    assert error[0] == pytest.approx(1.0e-6, rel=1e-3)


def test_cosine_error_of_a_turned_beam():
    target, station = np.array([[0.3, 0.4, 0.1]]), np.array([[0.0, 0.0, 0.1]])
    azimuth, elevation = aim(station, target)
    origin, direction = Pointer(zero_offset=2e-3).beam(azimuth, elevation, station)
    assert sensed_path(target, origin, direction)[0] == pytest.approx(0.5 * np.cos(2e-3), abs=1e-15)
    origin, direction = Pointer(elevation_offset=-1e-3).beam(azimuth, elevation, station)
    assert sensed_path(target, origin, direction)[0] == pytest.approx(0.5 * np.cos(1e-3), abs=1e-15)


def test_radial_error_motion_adds_its_harmonics_to_the_path():
    azimuth = np.linspace(-3, 3, 7)
    target = np.column_stack([0.5 * np.cos(azimuth), 0.5 * np.sin(azimuth), np.zeros(7)])
    origin, direction = Pointer(radial={3: (2e-6, -1e-6)}).beam(azimuth, np.zeros(7), np.zeros((7, 3)))
    expected = 0.5 + 2e-6 * np.cos(3 * azimuth) - 1e-6 * np.sin(3 * azimuth)
    np.testing.assert_allclose(sensed_path(target, origin, direction), expected, atol=1e-15)


def test_radial_error_motion_is_in_the_plane_of_azimuth():
    """A beam that rises by 60 degrees senses half of it."""
    up, azimuth = np.full(5, np.pi / 3), np.linspace(-2, 2, 5)
    beam = unit_vectors(azimuth, up)
    origin, direction = Pointer(radial={2: (3e-6, 0.0)}).beam(azimuth, up, np.zeros((5, 3)))
    assert np.abs(origin[:, 2]).max() == 0.0
    expected = 0.5 + 0.5 * 3e-6 * np.cos(2 * azimuth)
    np.testing.assert_allclose(sensed_path(0.5 * beam, origin, direction), expected, atol=1e-15)


def test_eccentric_beam_reads_the_same_path_from_beside_the_centre():
    target = np.array([[0.5, 0.0, 0.0]])
    origin, direction = Pointer(eccentricity=1e-3).beam(np.zeros(1), np.zeros(1), np.zeros((1, 3)))
    np.testing.assert_allclose(origin, [[0.0, 1e-3, 0.0]])
    assert sensed_path(target, origin, direction)[0] == pytest.approx(0.5)


def test_tilted_mirror_reads_n_d_over_n_l():
    beam = np.array([1.0, 2.0, 2.0]) / 3.0
    normal = tilted(beam[None], np.array([[1e-3, -2e-3]]))[0]
    mirror = np.array([[0.1, 0.2, 0.2], [0.11, 0.2, 0.2]])
    path = mirror_path(mirror[0] - 0.3 * beam, beam, mirror, normal)
    assert path[0] == pytest.approx(0.3, abs=1e-15)
    assert path[1] - path[0] == pytest.approx(0.01 * normal[0] / (normal @ beam), abs=1e-15)


@pytest.mark.parametrize("beam", [(0, 0, 1), (0, 0, -1), (1, 0, 0), (0.6, 0, 0.8)])
def test_directions_across_a_beam_are_orthonormal(beam):
    beam = np.array(beam, float)
    first, second = across(beam)
    frame = np.array([first, second, beam])
    np.testing.assert_allclose(frame @ frame.T, np.eye(3), atol=1e-15)


def contact(error=(0, 0, 0), material=0.0, tilt=0.0, bend=0.0, angle=0.3):
    """Probing a surface at (0.1, 0.05) whose normal points at `angle`; radius 3 mm."""
    n = np.array([[np.cos(angle), np.sin(angle), 0.0]])
    p = np.array([[0.1, 0.05, 0.0]])
    facing = np.array([[np.cos(angle + tilt), np.sin(angle + tilt), 0.0]])
    return probed(p + 0.003 * n + np.array([error]), n, p + material * n, facing, 0.003, bend)[0], n[0]


@pytest.mark.parametrize("bend", [0.0, 1 / 0.006, -1 / 0.02])
def test_probe_sees_material_and_minus_the_machines_error(bend):
    assert contact(bend=bend)[0] == pytest.approx(0.0, abs=1e-15)
    assert contact(material=5e-6, bend=bend)[0] == pytest.approx(5e-6, abs=1e-15)
    error = np.array([3e-6, -2e-6, 0.0])
    value, n = contact(error, bend=bend)
    across = np.cross(n, error)[2]
    assert value == pytest.approx(-n @ error, abs=across**2 / (2 * 0.009) + 1e-14)  # the sphere rolls round the pin


def test_probe_on_a_pin_against_two_circles():
    """Off centre by e, spheres of radius R and r touch at sqrt((R + r)^2 - e^2) from the pin's centre."""
    value, _ = contact(error=np.array([-np.sin(0.3), np.cos(0.3), 0.0]) * 1e-4, bend=1 / 0.006)
    assert value == pytest.approx(np.sqrt(0.009**2 - 1e-8) - 0.009, abs=1e-14)


def test_probe_in_a_hole_against_two_circles():
    value, _ = contact(error=np.array([-np.sin(0.3), np.cos(0.3), 0.0]) * 1e-4, bend=-1 / 0.02)
    assert value == pytest.approx(0.017 - np.sqrt(0.017**2 - 1e-8), abs=1e-14)


def test_probe_on_a_plane_that_is_turned():
    """The sphere rolls along a turned plane: the contact is early by r (1/cos(t) - 1)."""
    assert contact(tilt=1e-2)[0] == pytest.approx(0.003 * (1 / np.cos(1e-2) - 1), abs=1e-15)


def bonsch_potulski(t, p, vapour):
    """Another published equation: Bönsch and Potulski, Metrologia 35 (1998) 133, for 400 ppm of carbon dioxide."""
    s = 0.6329908**-2
    normal = 1e-8 * (8091.37 + 2333983 / (130 - s) + 15518 / (38.9 - s))
    dry = normal * p / 93214.60 * (1 + 1e-8 * (0.5953 - 0.009876 * t) * p) / (1 + 0.0036610 * t)
    return dry - vapour * (3.8020 - 0.0384 * s) * 1e-10


def test_air_agrees_with_another_equation():
    for t, p, h in ((20.0, 101325.0, 0.5), (15.0, 98000.0, 0.2), (25.0, 103000.0, 0.4)):
        vapour = float(vapour_pressure(t, h))
        # they differ by the carbon dioxide and by what the authors state, a few parts in 1e8 of the index
        assert refractivity(t, p, h) == pytest.approx(bonsch_potulski(t, p, vapour), abs=4e-8)
        change = bonsch_potulski(t, p, vapour) - bonsch_potulski(20.0, 101325.0, float(vapour_pressure(20.0, 0.5)))
        assert _off_standard(t, p, h) == pytest.approx(change, abs=2e-8)


def test_air_has_the_size_that_metrologists_know():
    assert refractivity(20.0, 101325.0, 0.5) == pytest.approx(2.714e-4, abs=1e-7)
    assert vapour_pressure(20.0, 1.0) == pytest.approx(2339.0, rel=1e-3)
    # about 1 ppm a kelvin, 0.27 ppm a hectopascal, 0.09 ppm for 10 % of humidity
    assert _off_standard(21.0, 101325.0, 0.5) == pytest.approx(-0.95e-6, abs=0.05e-6)
    assert _off_standard(20.0, 101425.0, 0.5) == pytest.approx(0.268e-6, abs=0.003e-6)
    assert _off_standard(20.0, 101325.0, 0.6) == pytest.approx(-0.087e-6, abs=0.005e-6)
