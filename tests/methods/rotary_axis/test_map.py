# SPDX-License-Identifier: Apache-2.0
"""What a fit of a rotary axis says, worked out again from the unknowns and their covariance.
The stated uncertainties are those of the errors.
"""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from machine_tool_calibration.methods.identify import identify
from machine_tool_calibration.methods.rotary_axis.model import average_line, line_names
from machine_tool_calibration.model.result import Result

RADIUS = 0.5
SQUARE = np.array([[RADIUS, 0.0, 0.0], [0.0, RADIUS, 0.0], [-RADIUS, 0.0, 0.0], [0.0, -RADIUS, 0.0]])
U = 2e-6


def result(rotary: SimpleNamespace, **plan: Any) -> Result:
    return identify(rotary.measured(3, **plan).session)


def test_errors_of_an_axis_average_line_are_those_across_it() -> None:
    assert line_names("C") == (("X0C", 0), ("Y0C", 1), ("A0C", 3), ("B0C", 4))
    assert line_names("B") == (("X0B", 0), ("Z0B", 2), ("A0B", 3), ("C0B", 5))
    assert line_names("A") == (("Y0A", 1), ("Z0A", 2), ("B0A", 4), ("C0A", 5))


@pytest.mark.parametrize("vector", [(0.0, 0.0, 0.0), (1e-3, -2e-3, 5e-3), (0.3, -0.2, 0.9)])
def test_the_line_of_stations_that_were_moved_is_that_motion(vector: tuple[float, float, float]) -> None:
    turn, shift = Rotation.from_rotvec(vector), np.array([0.4, -0.2, 0.1])
    found = average_line(SQUARE, 1e-14 * np.eye(12), turn.apply(SQUARE) + shift, np.full(4, U))
    assert found is not None
    np.testing.assert_allclose(found[0], [*shift, *vector], atol=1e-11)


def test_stations_on_a_square_place_the_line_as_well_as_their_mean_and_arms() -> None:
    """Half as uncertain as one of four; turned about their plane's normal by all, about X and Y by two of them."""
    found = average_line(SQUARE, np.zeros((12, 12)), SQUARE, np.full(4, U))
    assert found is not None
    arms = np.array([2.0, 2.0, 4.0]) * RADIUS**2
    np.testing.assert_allclose(found[1], np.diag([*np.full(3, U**2 / 4), *(U**2 / arms)]), atol=1e-18)
    # What they are known to in the axis's frame adds to what they are stated to.
    more = average_line(SQUARE, 3.0 * U**2 * np.eye(12), SQUARE, np.full(4, U))
    assert more is not None
    np.testing.assert_allclose(more[1], 4.0 * found[1], rtol=1e-9, atol=1e-24)


def test_a_station_that_is_stated_better_keeps_its_place_and_one_that_is_worse_follows() -> None:
    off = SQUARE + 1e-5 * np.outer([0.0, 1.0, 1.0, 1.0], [0.0, 0.0, 1.0])
    found = average_line(SQUARE, np.zeros((12, 12)), off, U * np.array([1e-3, 1.0, 1e3, 1.0]))
    assert found is not None
    # The plane through the first and through the middle of the two beside it.
    at = Rotation.from_rotvec(found[0][3:]).apply(SQUARE) + found[0][:3]
    np.testing.assert_allclose(at[:, 2], [0.0, 1e-5, 2e-5, 1e-5], atol=1e-9)


def test_two_stations_and_stations_on_a_line_place_no_axis() -> None:
    line = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [2.0, 0.0, 0.0]])
    assert average_line(SQUARE[:2], np.zeros((6, 6)), SQUARE[:2], np.full(2, U)) is None
    assert average_line(line, np.zeros((9, 9)), line, np.full(3, U)) is None


@pytest.mark.parametrize("axis", ["A", "C"])
def test_position_errors_are_the_motions_at_the_targets(rotary: SimpleNamespace, axis: str) -> None:
    """e = delta + epsilon x arm, target after target at every angle, and its covariance."""
    found = result(rotary, axis=axis, sign=-1)
    model, content = found.fit.model, found.error_map.content
    motions, _ = rotary.found(content, axis)
    angles = content[axis.lower()]
    place = [p.name for p in model.parameters]
    nominal = np.array([target.position for target in model.observations.session.description.targets])
    turns = Rotation.from_rotvec(-angles[:, None] * np.eye(3)["ABC".index(axis)])
    for k in (0, 7, len(angles) - 1):
        for t in range(len(nominal)):
            row = k * len(nominal) + t
            arm = turns[k].apply(model.targets[t])
            np.testing.assert_allclose(found.error_map.points[row], arm, atol=1e-12)
            expected = motions[:3, k] + np.cross(motions[3:, k], arm)
            np.testing.assert_allclose(found.error_map.error[row], expected, atol=1e-15)
            x, y, z = arm
            slope = np.column_stack([np.eye(3), [[0.0, z, -y], [-z, 0.0, x], [y, -x, 0.0]]])
            own = [place.index(f"{name}({angles[k]:.6g})") for name in rotary.motions(axis)]
            spread = slope @ found.fit.covariance[np.ix_(own, own)] @ slope.T
            np.testing.assert_allclose(found.error_map.covariance[row], spread, rtol=1e-9, atol=1e-20)
            np.testing.assert_allclose(found.error_map.uncertainty[row], np.sqrt(np.diag(spread)), rtol=1e-9)


def test_error_motion_values_are_ranges_with_the_uncertainty_of_a_difference(rotary: SimpleNamespace) -> None:
    found = result(rotary)
    content, names = found.error_map.content, [p.name for p in found.fit.model.parameters]
    kinds = ("radial", "radial", "axial", "tilt", "tilt", "angular positioning")
    assert [(one["motion"], one["kind"]) for one in content["iso230_7"]] == list(
        zip(rotary.motions(), kinds, strict=True)
    )
    for one in content["iso230_7"]:
        values = content[one["motion"]]
        assert one["angles"] == len(values) == 18
        assert one["value"] == pytest.approx(values.max() - values.min())
        assert one["unit"] == ("rad" if one["motion"][1] in "ABC" else "m")
        first = names.index(f"{one['motion']}({content['c'][0]:.6g})")
        difference = np.zeros(len(names))
        difference[first + np.argmax(values)], difference[first + np.argmin(values)] = 1.0, -1.0
        assert one["U"] == pytest.approx(2.0 * np.sqrt(difference @ found.fit.covariance @ difference))


def test_places_of_targets_and_stations_are_those_of_the_fit(rotary: SimpleNamespace) -> None:
    found = result(rotary)
    content, fit = found.error_map.content, found.fit
    value = {p.name: (p.reference + v, u) for p, v, u in zip(
        fit.model.parameters, fit.theta, np.sqrt(np.diag(fit.covariance)), strict=True)}  # fmt: skip
    for kind in ("target", "station"):
        for id_, place, u in zip(content[f"{kind}_ids"], content[f"{kind}s"], content[f"{kind}s_u"], strict=True):
            expected = [value[f"{id_}.{axis}"] for axis in "xyz"]
            np.testing.assert_allclose(place, [v for v, _ in expected], atol=1e-12)
            np.testing.assert_allclose(u, [s for _, s in expected], rtol=1e-9)


@pytest.mark.long
def test_a_station_that_read_nothing_does_not_place_the_line(rotary: SimpleNamespace) -> None:
    """However well its place is stated: the line is that of the three others."""
    session = rotary.measured(3).session
    left = session.with_readings(session.readings.select(session.readings.setup != 1))
    setups = list(session.description.setups)
    assert setups[1].position_uncertainty is not None
    setups[1] = setups[1].model_copy(update={"position_uncertainty": None})
    unstated = replace(left, description=session.description.model_copy(update={"setups": tuple(setups)}))
    line, expected = (identify(one).error_map.content["axis_average_line"] for one in (left, unstated))
    assert line["X0C"] is not None and line == pytest.approx(expected, rel=1e-9)
    assert line["X0C_u"] > identify(session).error_map.content["axis_average_line"]["X0C_u"]


@pytest.mark.long
def test_normalised_errors_over_many_runs(rotary: SimpleNamespace, many: Any) -> None:
    errors, stated, chi = rotary.judged(many.count)
    assert np.mean((errors / stated) ** 2) == pytest.approx(1.0, abs=many.off(0.055))
    assert chi.mean() == pytest.approx(1.0, abs=many.off(0.03))
    # As small as the Cramer-Rao bound, motion by motion.
    ratio = np.sqrt(np.mean(errors**2, axis=(0, 2)) / np.mean(stated**2, axis=(0, 2)))
    assert (ratio < 1.0 + many.off(0.1)).all()


@pytest.mark.long
@pytest.mark.parametrize("plan", [{"repeats": 3}, {"both_ways": True, "sign": -1}, {"missing": 0.05}])
def test_variants_over_some_runs(rotary: SimpleNamespace, plan: dict[str, object], many: Any) -> None:
    some = many.part(0.4)
    errors, stated, chi = rotary.judged(some.count, **plan)
    assert np.nanmean((errors / stated) ** 2) == pytest.approx(1.0, abs=some.off(0.067))
    assert chi.mean() == pytest.approx(1.0, abs=some.off(0.03))


def test_repeats_lower_the_uncertainty_by_their_root(reproducible: None, rotary: SimpleNamespace) -> None:
    one = identify(rotary.measured(1).session).error_map.content
    four = identify(rotary.measured(1, repeats=4).session).error_map.content
    for name in ("EXC", "EYC", "EZC", "EAC", "EBC", "ECC"):
        assert np.mean(one[f"{name}_u"]) / np.mean(four[f"{name}_u"]) == pytest.approx(2.0, rel=0.02)


@pytest.mark.long
def test_quarter_turn_is_weak_but_honest(rotary: SimpleNamespace, many: Any) -> None:
    some = many.part(0.4)
    errors, stated, _ = rotary.judged(some.count, angles=tuple(np.linspace(0.0, np.pi / 2, 10)))
    assert np.mean((errors / stated) ** 2) == pytest.approx(1.0, abs=some.off(0.1))
    full = result(rotary).error_map.content
    assert np.mean(stated[:, 3]) > 3 * np.mean(full["EAC_u"])


@pytest.mark.long
def test_small_turn_does_not_claim_more_than_it_knows(rotary: SimpleNamespace, many: Any) -> None:
    some, angles = many.part(0.4), tuple(np.linspace(0.0, np.pi / 6, 10))
    errors, stated, _ = rotary.judged(some.count, angles=angles)
    assert np.mean((errors / stated) ** 2) < 1.0 + some.off(0.1)
    assert "leave open stay where they are stated" in result(rotary, angles=angles).document()["datum"]
