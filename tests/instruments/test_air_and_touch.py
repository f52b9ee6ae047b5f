# SPDX-License-Identifier: Apache-2.0
"""The refractive index of air, against the other usual equation and a figure from tables.
Planned touches: where they begin, which point they are meant for, which triggers count.
"""

import numpy as np
import pytest

from machine_tool_calibration.errors import SessionError
from machine_tool_calibration.instruments.refractive_index import STANDARD_AIR, index_deviation, refractivity
from machine_tool_calibration.instruments.touch import Part, judge
from machine_tool_calibration.session.description import Probing
from machine_tool_calibration.simulation import flaws as edlen

TEMPERATURE, PRESSURE, HUMIDITY = (
    grid.ravel() for grid in np.meshgrid([16.0, 20.0, 24.0], [9.4e4, 1.013e5, 1.04e5], [0.0, 0.4, 0.7])
)


def test_of_standard_air() -> None:
    # Ciddor's equation: 2.7137e-4 with 450 ppm of carbon dioxide.
    assert refractivity(*(np.array([v]) for v in STANDARD_AIR))[0] == pytest.approx(2.7137e-4, abs=3e-8)


def test_as_the_updated_equation_of_edlen_over_the_range_of_workshops() -> None:
    """Birch and Downs 1994, with 50 ppm more carbon dioxide, another dispersion, another law of the vapour."""
    found = refractivity(TEMPERATURE, PRESSURE, HUMIDITY)
    np.testing.assert_allclose(found, edlen.refractivity(TEMPERATURE, PRESSURE, HUMIDITY), atol=5e-8)
    found = index_deviation(TEMPERATURE, PRESSURE, HUMIDITY)
    np.testing.assert_allclose(
        found, edlen.refractivity(TEMPERATURE, PRESSURE, HUMIDITY) - edlen.refractivity(*edlen.STANDARD), atol=3e-8
    )


def test_what_was_not_recorded_is_standard() -> None:
    standard = index_deviation(TEMPERATURE, np.full(27, 101325.0), np.full(27, 0.5))
    np.testing.assert_array_equal(index_deviation(TEMPERATURE, None, None), standard)
    assert index_deviation(*(np.array([v]) for v in STANDARD_AIR))[0] == 0.0


def part(sign=-1, points=((0.05, 0.01, 1.0, 0.0), (0.0, 0.03, 0.0, -1.0))):
    workpiece = [{"id": k, "position": p[:2], "normal": p[2:]} for k, p in enumerate(points)]
    return Part(
        Probing.model_validate(
            {
                "format": "mtcal-session/1",
                "method": "probing",
                "machine": {"chain": "w-C-b-Y-X-Z-t", "rotation_sign": sign},
                "probe": {"stylus_diameter": 0.006},
                "workpiece": workpiece,
                "setups": [{"id": "C1", "c": 0.0}],
                "standard_uncertainty": {"displacement": 1e-6},
            }
        )
    )


@pytest.mark.parametrize("sign", [-1, 1])
def test_touch_turns_with_the_table(sign):
    touch = part(sign).touch(0, np.pi / 2, 0.004)
    # a quarter turn: x becomes -y clockwise, +y counter-clockwise
    np.testing.assert_allclose(touch.normal, [0.0, sign], atol=1e-12)
    np.testing.assert_allclose(touch.centre, [-sign * 0.01, sign * 0.053], atol=1e-12)
    assert touch.at(0.004) == pytest.approx({"x": -sign * 0.01, "y": sign * 0.057})


def test_the_point_is_known_by_where_the_axes_stand():
    known = part()
    for point in (0, 1):
        for c in (0.0, 1.3):
            touch = known.touch(point, c, 0.004)
            again = known.meant({**touch.at(0.004), "c": c, "z": 0.0})
            assert again.point == point
            assert again.standoff == pytest.approx(0.004)
            np.testing.assert_allclose(again.centre, touch.centre)


def test_in_front_of_nothing_or_of_two():
    with pytest.raises(SessionError, match="in front of no point"):
        part().meant({"x": 0.0, "y": 0.0, "c": 0.0})
    slot = part(points=((0.0, 0.01, 0.0, -1.0), (0.0, -0.01, 0.0, 1.0)))
    with pytest.raises(SessionError, match="in front of the points '0' and '1'"):
        slot.meant({"x": 0.0, "y": 0.0, "c": 0.0})


@pytest.mark.parametrize(
    ("displacement", "reason"),
    [(2e-5, ""), (-9e-4, ""), (-2e-3, "missed"), (1.5e-3, "too early"), (5e-3, "before it approached")],
)
def test_which_triggers_count(displacement, reason):
    found = judge(displacement, 0.004)
    assert (reason in found) if reason else found == ""
