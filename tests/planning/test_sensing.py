# SPDX-License-Identifier: Apache-2.0
"""What readings yet to be taken would sense of an effect, and the smallest size that would be found.
Effects in perfect data: in which plan one shows, and what takes it up.
"""

from collections.abc import Callable

import numpy as np
import pytest

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.effects.catalogue import catalogue
from machine_tool_calibration.effects.effect import Coefficient, Effect
from machine_tool_calibration.methods.build import build_model
from machine_tool_calibration.model.effect_sizes import smallest_signal
from machine_tool_calibration.model.fit import fit_models, screen
from machine_tool_calibration.model.observations import Observations
from machine_tool_calibration.planning import forecast as module
from machine_tool_calibration.planning.forecast import detectable
from machine_tool_calibration.planning.injected import inject, where_it_shows
from machine_tool_calibration.planning.options import further_options
from machine_tool_calibration.planning.sensing import SizedEffect, sense
from machine_tool_calibration.session.session import Session

Simulated = Callable[..., Session]
EFFECTS = catalogue()


def assumed(name: str, shape: tuple[float, ...] = (), **size: float) -> SizedEffect:
    return SizedEffect(EFFECTS[name], shape, size)


def test_the_same_as_plain_algebra_on_the_whole_matrix(simulated: Simulated) -> None:
    """Probing: one unknown a point and the model's columns, projected off by a dense least-squares fit."""
    session = simulated("probing_cross")
    model = build_model(session)[0]
    sigma = session.sigma
    names = ("backlash_x", "backlash_y", "workpiece_thermal")
    label = session.readings.labels["point"]
    points = (np.unique(label)[:, None] == label[None, :]).astype(float)
    dense = np.concatenate([points, model.dense()]).T / sigma
    columns = {name: EFFECTS[name].columns(model.observations)[0] / sigma for name in names}
    basis = np.linalg.svd(dense / np.maximum(np.linalg.norm(dense, axis=0), 1e-300), full_matrices=False)
    basis = basis[0][:, basis[1] > 1e-7]
    left = {name: column - basis @ (basis.T @ column) for name, column in columns.items()}
    sensed = sense(session, [assumed(name, **{c.name: 1.0 for c in EFFECTS[name].coefficients}) for name in names])
    for one in names:
        assert sensed.information(one)[0] == pytest.approx(left[one] @ left[one], rel=1e-6)
        for other in names:
            cosine = abs(left[one] @ left[other]) / np.linalg.norm(left[one]) / np.linalg.norm(left[other])
            assert sensed.cosine(one, other) == pytest.approx(cosine, abs=1e-6)
            if one == other:
                assert sensed.apart(one, other) < 1e-3 * np.linalg.norm(left[one])
                continue
            apart = np.linalg.norm(left[one]) * np.sqrt(max(1 - cosine**2, 0.0))
            assert sensed.apart(one, other) == pytest.approx(apart, rel=1e-4)
    a, b = left["backlash_x"], left["backlash_y"]
    beside = a - b * (a @ b) / (b @ b)
    assert sensed.beside(["backlash_y"]).information("backlash_x")[0] == pytest.approx(beside @ beside, rel=1e-5)


@pytest.mark.parametrize("plan", ["tracking_2d", "rotary_axis", "step_diagonal"])
def test_nominal_geometry_senses_what_the_fit_senses(simulated: Simulated, plan: str) -> None:
    session = simulated(plan)
    fit = fit_models([build_model(session)[0]]).fits[0]
    name = {"tracking_2d": "backlash_y", "rotary_axis": "backlash_c", "step_diagonal": "dead_path"}[plan]
    columns = EFFECTS[name].columns(fit.model.observations)
    expected = screen(fit, columns).gram[0, 0]
    assert sense(session, [assumed(name, b=1.0)]).information(name)[0] == pytest.approx(expected, rel=0.02)


def test_an_effect_in_the_model_takes_its_share(simulated: Simulated) -> None:
    session = simulated("tracking_2d")
    drift = assumed("linear_drift", r=1e-9)
    alone = sense(session, [drift]).information("linear_drift")[0]
    beside = sense(session, [drift], present=[assumed("dead_path", D=1.0)]).information("linear_drift")[0]
    both = sense(session, [drift, assumed("dead_path", D=1.0)]).beside(["dead_path"])
    assert beside < 0.9 * alone
    assert beside == pytest.approx(both.information("linear_drift")[0], rel=1e-6)


def test_what_the_model_absorbs_has_no_information(simulated: Simulated) -> None:
    session = simulated("tracking_2d")
    sensed = sense(session, [assumed("scale", s=1.0), assumed("backlash_y", b=1.0)])
    assert sensed.information("scale").tolist() == [0.0]
    assert sensed.share("scale") < 0.01 < sensed.share("backlash_y")


def test_a_part_that_is_turned_turns_its_effect_only(simulated: Simulated) -> None:
    session = simulated("tracking_2d")
    option = next(o for o in further_options(session) if o.kind == "turned")
    form = assumed("retroreflector_form", (3.0,), s2=1e-6, c3=1e-6)
    radial = assumed("pointer_radial_error", (3.0, 1.0), s2=1e-6, c3=1e-6)
    plain = sense(option.session, [form, radial], first_row=option.first_row)
    turned = sense(option.session, [form, radial], first_row=option.first_row, turned=option.turned)
    assert plain.cosine("retroreflector_form", "pointer_radial_error") == pytest.approx(1.0, abs=1e-6)
    assert turned.cosine("retroreflector_form", "pointer_radial_error") < 0.9
    assert turned.information("pointer_radial_error") == pytest.approx(plain.information("pointer_radial_error"))


def test_setups_that_are_new_get_coefficients_of_the_usual_size(simulated: Simulated) -> None:
    session = simulated("tracking_2d")
    option = next(o for o in further_options(session) if o.kind == "again")
    size = {f"{station}.v{axis}": 2e-9 for station in "ABCD" for axis in "xy"}
    sensed = sense(option.session, [assumed("station_drift", **size)], first_row=option.first_row)
    assert sensed.signal["station_drift"] == pytest.approx(np.full(16, 2e-9))


NAMES = ("backlash_x", "linear_drift", "pointer_radial_error", "dead_path", "scale", "probe_pretravel", "lost_motion_y")


def test_sizes_follow_from_the_columns_outside_the_model(simulated: Callable[..., Session]) -> None:
    fit = fit_models([build_model(simulated("tracking_2d"))[0]]).fits[0]
    told: list[tuple[str, float]] = []
    found = detectable(fit.joint, [catalogue()[name] for name in NAMES], progress=lambda *now: told.append(now))
    assert found.absorbed == ("scale",)
    assert found.excluded == {"probe_pretravel": "does not occur with tracking interferometer"}
    visible = {one.effect: one for one in found.visible}
    assert list(visible) == [name for name in NAMES if name not in ("scale", "probe_pretravel")]
    assert [share for _, share in told] == pytest.approx(np.arange(1, 8) / 7)
    # One of six that can act, or of the twenty that one effect's probability stands for.
    needed = np.log(20.0)
    for name in ("backlash_x", "linear_drift", "dead_path"):
        (coefficient,) = catalogue()[name].coefficients
        columns = catalogue()[name].columns(fit.model.observations)
        inner = screen(fit, columns).gram[0, 0]
        half = max(abs(coefficient.low), abs(coefficient.high)) / 2
        strength = inner * half**2
        size = smallest_signal(np.array([strength]), strength, needed, 0.8) / np.sqrt(inner)
        one = visible[name]
        assert one.size == pytest.approx(size, rel=1e-6)
        assert one.reading == pytest.approx(size * np.abs(columns).max(), rel=1e-6)
        assert (one.coefficient, one.unit) == (coefficient.name, coefficient.unit)
    # Of several coefficients the one that shows with the smallest change of a reading.
    assert visible["lost_motion_y"].coefficient.startswith("b")
    assert (visible["lost_motion_y"].reading or 1.0) < 3 * (visible["backlash_x"].reading or 0.0)


def test_in_several_passes_as_in_one(simulated: Callable[..., Session], monkeypatch: pytest.MonkeyPatch) -> None:
    joint = fit_models([build_model(simulated("rotary_axis"))[0]])
    effects = [catalogue()[name] for name in ("backlash_c", "retroreflector_form", "station_drift", "linear_drift")]
    at_once = detectable(joint, effects)
    monkeypatch.setattr(module, "_HELD", 1)
    assert [one.effect for one in at_once.visible] == [one.effect for one in detectable(joint, effects).visible]
    for one, other in zip(at_once.visible, detectable(joint, effects).visible, strict=True):
        assert one.size == pytest.approx(other.size, rel=1e-9)


def test_so_much_noise_hides_all_that_is_plausible(simulated: Callable[..., Session]) -> None:
    joint = fit_models([build_model(simulated("tracking_2d", noise=3e-4))[0]])
    (one,) = detectable(joint, [catalogue()["backlash_x"]]).visible
    assert one.size is not None and one.size > 5e-5


@pytest.mark.parametrize("order", [[0, 1, 2], [1, 2, 0], [2, 0, 1]])
def test_of_several_coefficients_the_one_that_shows_with_the_smallest_change_is_told(order: list[int]) -> None:
    """All as well determined; a metre of the second changes no reading by more than half of that. One is not seen."""
    named = [Coefficient(name, "m", 0.0, 1e-4) for name in "abc"]
    inner, seen, largest = np.full(3, 1e14), np.array([True, True, False]), np.array([1.0, 0.5, 0.1])
    best = module._Screened("e", 1, (([named[k] for k in order], inner[order], seen[order], largest[order]),)).smallest(
        np.log(20.0)
    )
    assert best is not None and best.coefficient == "b"
    size = smallest_signal(np.full(2, 1e14 * 5e-5**2), 1e14 * 5e-5**2, np.log(20.0), 0.8) / 1e7
    assert (best.size, best.reading) == pytest.approx((size, size / 2.0))


PLANS = ("step_diagonal", "tracking_2d", "rotary_axis")


class Own(Effect):
    """One that the simulator does not know."""

    id, title, formula, source, kind = "own", "own", "", "", "reading"
    coefficients = (Coefficient("a", "m", 0.0, 4e-6), Coefficient("b", "m", -1e-6, 1e-6))
    methods = ("tracking_interferometer",)

    def columns(self, observations: Observations, shape: tuple[float, ...] = ()) -> Array:
        number = observations.readings.row
        return np.array([1.0 * (number % 3 == 0), 1.0 * (number % 5 == 1)])


def test_an_effect_shows_in_the_first_plan_that_leaves_enough_of_it() -> None:
    shown = where_it_shows(catalogue()["backlash_y"], PLANS)
    assert [one.plan for one in shown] == list(PLANS)
    assert [one.method for one in shown] == ["step_diagonal", "tracking_interferometer", "rotary_axis"]
    assert shown[2].left is None and shown[2].why_not == "the chain has no axis Y"
    left = {one.plan: one.left for one in shown}
    made = inject(catalogue()["backlash_y"], PLANS)
    assert made is not None and made.from_geometry and not made.taken_up
    assert made.plan == next(plan for plan in PLANS if (left[plan] or 0.0) > 0.3)
    assert made.left == left[made.plan]
    # The share that is left is that of the change outside the model; without the mean of each run.
    fit = made.comparison.fit
    run = fit.model.observations.run
    assert np.bincount(run, made.change) == pytest.approx(0.0, abs=1e-15)
    assert 4e-6 < np.ptp(made.change) <= 1e-5
    outside = screen(fit, made.change[None]).gram[0, 0] / np.sum((made.change / fit.model.sigma) ** 2)
    assert made.left == pytest.approx(np.sqrt(outside), rel=2e-3)


def test_what_every_plan_takes_up_is_shown_where_most_is_left() -> None:
    made = inject(catalogue()["scale"], ("tracking_2d", "step_diagonal"))
    assert made is not None and made.taken_up and made.left < 0.02
    (shown,) = where_it_shows(catalogue()["scale"], ("tracking_2d",))
    assert shown.left is not None and shown.left < 0.02 and shown.taken_up_by
    assert inject(catalogue()["backlash_c"], ("tracking_2d",)) is None


def test_one_of_the_users_own_is_its_formula_in_the_middle_of_its_range() -> None:
    made = inject(Own(), PLANS)
    assert made is not None and made.plan == "tracking_2d" and not made.from_geometry
    observations = made.comparison.fit.model.observations
    # 2 um of the first, and of the second, whose middle is zero, its limit; the largest change is 5 um.
    expected = np.array([2e-6, 1e-6]) @ Own().columns(observations)
    expected *= 5e-6 / 3e-6
    for run in np.unique(observations.run):
        expected[observations.run == run] -= expected[observations.run == run].mean()
    np.testing.assert_allclose(made.change, expected, atol=1e-12)
