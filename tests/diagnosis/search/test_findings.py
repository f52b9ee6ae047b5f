# SPDX-License-Identifier: Apache-2.0
"""Sizes that occur: what is tried for is twice the limits of a coefficient; and what an effect's law leaves."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from machine_tool_calibration.diagnosis.search.candidates import Shaped, effect_candidates
from machine_tool_calibration.diagnosis.search.findings import Size, _detectable, without_laws
from machine_tool_calibration.effects.catalogue import find_effects
from machine_tool_calibration.effects.effect import Coefficient
from machine_tool_calibration.methods.build import build_model
from machine_tool_calibration.model.effect_sizes import smallest_signal
from machine_tool_calibration.model.fit import fit_models
from machine_tool_calibration.model.imperfection import scaled_values
from machine_tool_calibration.residuals.pool import Pool
from machine_tool_calibration.simulation import PRESETS, SimulationSpec, simulate

WAVE = Coefficient("s", "m", -5e-5, 5e-5)


@pytest.mark.parametrize(
    ("value", "uncertainty", "plausible"),
    [
        (9e-6, 9e-6, True),
        (9e-5, 2e-5, True),
        (-9e-5, 1e-9, True),
        (1.1e-4, 1e-5, True),
        (-1.5e-4, 1e-5, False),
        # Intervals that reach into what occurs, and lie beyond it for the most part.
        (6.7e-4, 8.7e-4, False),
        (-1.6e-4, 1e-3, False),
        # Of several coefficients that go together none may be known well.
        (5e-5, 1e-4, True),
    ],
)
def test_a_wide_interval_makes_no_size_plausible(value: float, uncertainty: float, plausible: bool) -> None:
    assert Size(WAVE, value, uncertainty).plausible is plausible


def test_of_more_shapes_a_larger_size_is_needed_and_of_the_more_probable_a_smaller_one() -> None:
    """Even odds after the readings; before them it has its own, shared among its shapes."""
    inner, shaped = np.array([[4e12]]), Shaped((), np.zeros((1, 3)), (WAVE,))
    told = {}
    for count, log_odds in ((1, -3.0), (12, -3.0), (12, -1.0)):
        candidate: Any = SimpleNamespace(count=count)
        told[count, log_odds] = _detectable(candidate, shaped, inner, 2.25, log_odds)["s"]
        strength = 4e12 * 2.5e-5**2
        signal = smallest_signal(np.array([strength]), strength, np.log(count) - log_odds)
        assert told[count, log_odds] == pytest.approx(signal * 1.5 / 2e6)
    assert told[1, -3.0] < told[12, -1.0] < told[12, -3.0]


@pytest.mark.parametrize(("other", "kept"), [("linear_drift", False), ("backlash_y", True)])
def test_what_comes_with_the_direction_of_approach_is_not_what_a_warm_up_differs_from_its_law_by(
    other: str, kept: bool
) -> None:
    """The same signal is that of a slow effect, or not."""
    session = simulate(SimulationSpec(plan=PRESETS["tracking_2d"], seed=4)).session
    pool = Pool(fit_models([build_model(session)[0]]))
    found = {c.name: c for c in effect_candidates(pool, find_effects(["warmup_y", other]))[0]}
    warm = 1e-5 * found["warmup_y"].shapes[0].columns[0]
    late = 0.3 * warm * scaled_values(pool.observations[0].clock)
    names = without_laws([found["warmup_y"], found[other]], pool, [warm, late])
    assert names == (("warmup_y", other) if kept else ("warmup_y",))
