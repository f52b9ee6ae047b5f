# SPDX-License-Identifier: Apache-2.0
"""Proposals, and that they keep their word in the simulator, which knows nothing of them."""

from collections.abc import Callable
from functools import cache

import pytest

from machine_tool_calibration.diagnosis.diagnose import Diagnosis, diagnose
from machine_tool_calibration.methods.fitted import FitRequest
from machine_tool_calibration.planning.what_to_measure import Advice, Separation, alias_groups_of, what_to_measure
from machine_tool_calibration.session.session import Session
from machine_tool_calibration.simulation import PRESETS, FlawSpec, SimulationSpec, simulate

Simulated = Callable[..., Session]


def look(session: Session) -> tuple[Diagnosis, Advice]:
    """What a diagnosis says, and what to measure next; its progress is told, and rises."""
    found = diagnose(session)
    shares: list[float] = []
    advice = what_to_measure(found, progress=lambda what, share: shares.append(share))
    assert shares and shares == sorted(shares)
    return found, advice


@cache
def one_way(seed: int) -> tuple[Diagnosis, Advice]:
    """Of a rotary axis that turns in one direction only."""
    return look(simulate(SimulationSpec(plan=PRESETS["rotary_axis_one_way"], seed=seed)).session)


def separation(advice: Advice, *names: str) -> Separation:
    return next(s for s in advice.separations if set(names) <= set(s.effects))


def test_retroreflector_and_pointer_are_told_apart_by_turning_one(simulated: Simulated) -> None:
    found, advice = look(simulated("tracking_2d", 5, FlawSpec(id="pointer_radial_error", amplitude=4e-6)))
    assert found.verdict == "missing_effect"
    way = separation(advice, "pointer_radial_error", "retroreflector_form")
    assert way.kind == "turned"
    assert way.cosine_before == pytest.approx(1.0, abs=1e-6)
    assert way.separates
    assert way.apart_before < 1.0 < 6.0 < way.apart_after


def test_every_group_of_look_alikes_gets_an_answer(simulated: Simulated) -> None:
    flaw = FlawSpec(id="dead_path", amplitude=2e-6)
    found, advice = look(simulated("step_diagonal", 5, flaw, plan={"blocks": 4}))
    groups = list(alias_groups_of(found))
    assert found.accepted == ("dead_path",)
    assert [s.effects for s in advice.separations] == groups
    for s in advice.separations:
        assert s.measure
        assert 0.0 <= s.cosine_after <= 1.0
        assert (s.kind is None) == (not s.separates) or s.cosine_after < s.cosine_before


def test_backlash_that_one_direction_hides_shows_when_turning_back() -> None:
    """One-way runs of the table absorb the backlash of C; both ways show what was promised."""
    found, advice = one_way(5)
    assert "backlash_c" in {a.effect for a in found.search.absorbed}
    way = next(v for v in advice.visibilities if v.effect == "backlash_c")
    assert way.kind == "both_ways"
    assert way.before is None
    promised = way.after
    plan = PRESETS["rotary_axis"]
    effects = (FlawSpec(id="backlash_c", size=1.5 * promised),)
    session = simulate(SimulationSpec(plan=plan, seed=0, effects=effects)).session
    assert "backlash_c" in diagnose(session).accepted


def test_a_promised_size_is_what_the_longer_measurement_detects(simulated: Simulated) -> None:
    """The dead path in a step diagonal: a larger swing of the temperature shows a smaller one."""
    session = simulated("step_diagonal_three_orders", 5, environment_swing=0.3)
    _, advice = look(session)
    way = next((v for v in advice.visibilities if v.effect == "dead_path"), None)
    assert way is not None
    assert way.kind in ("swing", "warmer")
    assert way.before is not None
    assert way.after < 0.5 * way.before


def test_effects_that_are_in_the_model_keep_their_shape(simulated: Simulated) -> None:
    """A time constant, which is an unknown of the model, and a number of harmonics, which is not."""
    from machine_tool_calibration.planning.what_to_measure import present_effects

    warm = FlawSpec(id="warmup_y", size=3e-5, parameters={"tau": 900.0})
    flaws = (warm, FlawSpec(id="pointer_radial_error", amplitude=4e-6))
    session = simulated("tracking_2d", 5, *flaws)
    found = diagnose(FitRequest((session,), effects=("warmup_y", "pointer_radial_error", "backlash_x")))
    present = {p.effect.id: p for p in present_effects(found)}
    assert set(present) == {"warmup_y", "pointer_radial_error", "backlash_x"}
    assert present["warmup_y"].shape[0] > 0
    assert present["pointer_radial_error"].shape[0] in (3.0, 5.0, 8.0)
    assert present["backlash_x"].shape == ()
    advice = what_to_measure(found)
    named = {name for s in advice.separations for name in s.effects}
    assert not named & set(present)
