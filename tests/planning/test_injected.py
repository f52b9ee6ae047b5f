# SPDX-License-Identifier: Apache-2.0
"""Effects in perfect data: in which plan one shows, and what takes it up."""

import numpy as np
import pytest

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.effects.catalogue import catalogue
from machine_tool_calibration.effects.effect import Coefficient, Effect
from machine_tool_calibration.model.fit import screen
from machine_tool_calibration.model.observations import Observations
from machine_tool_calibration.planning.injected import inject, where_it_shows

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
    assert shown[2].left is None and shown[2].why_not == "the column y was not recorded"
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
