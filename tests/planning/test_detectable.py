# SPDX-License-Identifier: Apache-2.0
"""The smallest sizes that would be found, from what a fit leaves of each effect's columns."""

from collections.abc import Callable

import numpy as np
import pytest

from machine_tool_calibration.effects.catalogue import catalogue
from machine_tool_calibration.effects.effect import Coefficient
from machine_tool_calibration.methods.build import build_model
from machine_tool_calibration.model.effect_sizes import smallest_signal
from machine_tool_calibration.model.fit import fit_models, screen
from machine_tool_calibration.planning import forecast as module
from machine_tool_calibration.planning.forecast import detectable
from machine_tool_calibration.session.session import Session

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
