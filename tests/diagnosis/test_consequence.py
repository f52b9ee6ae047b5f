# SPDX-License-Identifier: Apache-2.0
import numpy as np
import pytest

from machine_tool_calibration.arrays import rms
from machine_tool_calibration.diagnosis.consequence import consequences
from machine_tool_calibration.methods.identify import identify
from machine_tool_calibration.simulation import PRESETS, FlawSpec, SimulationSpec

from ..diagnosed import diagnosed


def test_two_effects_found_are_told_with_both_in_the_model() -> None:
    effects = (FlawSpec(id="backlash_y", amplitude=1.5e-6), FlawSpec(id="backlash_x", amplitude=1.2e-6))
    found = diagnosed(SimulationSpec(plan=PRESETS["tracking_2d"], seed=31, effects=effects))
    assert set(found.accepted) == {"backlash_x", "backlash_y"}
    changes = consequences(found, most=2)
    assert list(changes)[:2] == list(found.accepted)
    assert len(changes) == 4
    both = {p.name: p.value for p in identify(found.chosen.sessions[0], effects=found.accepted).parameters}
    for name in found.accepted:
        (size,) = changes[name].parameters
        assert size.value == pytest.approx(both[size.name], rel=1e-6)
    first, second = (changes[name] for name in found.accepted)
    assert first.rms_after == pytest.approx(second.rms_before)
    assert second.rms_after < second.rms_before < first.rms_before
    taken = found.fits[0].fits[0].residuals - found.fits[2].fits[0].residuals
    assert first.explained + second.explained == pytest.approx(taken)


def test_a_share_in_the_readings_is_told_only_where_the_data_tell_it() -> None:
    found = diagnosed(SimulationSpec(plan=PRESETS["tracking_2d"], seed=101))
    changes = consequences(found)
    # Nothing is missing: no candidate's share is larger than its uncertainty.
    assert all(change.signal is None for change in changes.values())
    strong = SimulationSpec(plan=PRESETS["tracking_2d"], seed=7, effects=(FlawSpec(id="backlash_y", size=2e-6),))
    change = consequences(diagnosed(strong))["backlash_y"]
    assert change.signal is not None
    assert np.abs(change.signal).max() == pytest.approx(2e-6, rel=0.1)
    assert rms(change.signal) < 2e-6
