# SPDX-License-Identifier: Apache-2.0
"""An effect on readings that were left out: a real one predicts them, one that bends around the readings does not."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from machine_tool_calibration.diagnosis.diagnose import diagnose
from machine_tool_calibration.diagnosis.search.candidates import effect_candidates
from machine_tool_calibration.diagnosis.search.effect_search import EffectSearch, search_effects
from machine_tool_calibration.diagnosis.search.prediction import Prediction, predictions
from machine_tool_calibration.effects.catalogue import catalogue
from machine_tool_calibration.errors import ModelError
from machine_tool_calibration.methods.build import build_model
from machine_tool_calibration.model.fit import JointFit, fit_models
from machine_tool_calibration.residuals.pool import Pool
from machine_tool_calibration.session.session import Session
from machine_tool_calibration.simulation import PRESETS, FlawSpec, SimulationSpec, simulate

EFFECT = "backlash_y"


def fit_of(parts: Sequence[Session]) -> JointFit:
    return fit_models([build_model(part)[0] for part in parts])


def with_effect(only_in: int | None) -> Session:
    """Backlash of 5 um; in one setup alone, if asked, where no machine has it."""
    session = simulate(SimulationSpec(plan=PRESETS["tracking_2d"], seed=4)).session
    column = catalogue()[EFFECT].columns(build_model(session)[0].observations)[0]
    if only_in is not None:
        column = column * (session.readings.setup == only_in)
    readings = session.readings
    return session.with_readings(replace(readings, displacement=readings.displacement + 5e-6 * column))


def predicted(session: Session) -> tuple[Prediction, ...]:
    fit = fit_of([session])
    candidates, _ = effect_candidates(Pool(fit), [catalogue()[EFFECT]])
    look: EffectSearch = search_effects(Pool(fit), candidates, [])
    # Every reading has a noise of its own; without any structure to be tried what setups differ by passes for memory.
    return predictions([session], replace(look, accepted=(EFFECT,), memory=1.0), fit_of)[EFFECT]


def test_a_real_effect_predicts_every_part() -> None:
    found = predicted(with_effect(None))
    assert {"setups", "blocks of places", "cycles"} == {each.what for each in found}
    for each in found:
        assert np.isfinite(each.log_gains).all()
        assert min(each.log_gains) > 0.0
        assert 0.0 < each.gain < 1.0
        assert not each.speaks_against


def test_an_effect_of_one_setup_does_not_predict_the_others() -> None:
    found = {each.what: each for each in predicted(with_effect(0))}
    setups = found["setups"]
    # The setup that has it tells for it; without one of the others the effect is surer.
    assert setups.log_gains[0] > 3.0
    assert min(setups.log_gains[1:]) < -3.0
    assert setups.speaks_against


@pytest.mark.long
def test_an_effect_that_its_predictions_speak_against_is_refused_although_it_is_probable(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    spec = SimulationSpec(plan=PRESETS["iso230_2"], seed=4, effects=(FlawSpec(id="backlash_x", size=2e-6),))
    speaks_against = (Prediction("setups", (30.0, -4.0, -4.0, 1.0), 100),)
    # What contains it takes its place, and fails as well.
    against = dict.fromkeys(("backlash_x", "lost_motion_x"), speaks_against)
    monkeypatch.setattr("machine_tool_calibration.diagnosis.diagnose.predictions", lambda *_: against)
    found = diagnose(simulate(spec).session)
    assert found.search.of("backlash_x").probability > 0.95
    assert found.accepted == () and set(found.refused) >= {"backlash_x", "lost_motion_x"}


def test_without_an_accepted_effect_there_is_nothing_to_predict() -> None:
    session = simulate(SimulationSpec(plan=PRESETS["tracking_2d"], seed=4)).session
    fit = fit_of([session])
    look = search_effects(Pool(fit), effect_candidates(Pool(fit), [catalogue()[EFFECT]])[0], [])
    assert predictions([session], look, fit_of) == {}


@pytest.mark.parametrize(
    ("gains", "setups", "places"),
    [
        ((5.0, 4.0, 6.0), False, False),
        ((20.0, -1.0, -1.0), False, False),
        ((-2.0, -2.0), True, True),
        # It acts in one setup alone, or at some places alone.
        ((30.0, -4.0, -4.0, 1.0), True, False),
        ((30.0, 2.0, -4.0, 1.0), False, False),
        ((5.0, 1.0, -4.0, 0.5), False, True),
    ],
)
def test_parts_that_are_predicted_worse_speak_against(gains: tuple[float, ...], setups: bool, places: bool) -> None:
    assert Prediction("setups", gains, 100).speaks_against is setups
    assert Prediction("blocks of places", gains, 100).speaks_against is places


@pytest.mark.long
def test_what_has_no_cause_does_not_count_against_an_effect() -> None:
    """A warm-up beside a wave in half of the places: without the wave among the known, those places contradict."""
    flaws = [FlawSpec(id="warmup_x", amplitude=8e-6, parameters={"tau": 160.0})]
    session = simulate(SimulationSpec(plan=PRESETS["iso230_2"], seed=23, effects=tuple(flaws))).session
    readings = session.readings
    far = readings.columns["x"] > np.median(readings.columns["x"])
    disturbed = readings.displacement + 6e-6 * far * np.sin(2.0 * np.pi * np.arange(len(readings)) / 7.3)
    found = diagnose(session.with_readings(replace(readings, displacement=disturbed)))
    assert found.search.unknown > 0.99
    assert len(found.search.without_cause)
    assert "warmup_x" not in found.refused


@pytest.mark.long
def test_of_two_cycles_whose_passes_differ_one_predicts_the_other() -> None:
    """A single cycle has one pass of each direction: alone it knows nothing of what passes differ by."""
    session = simulate(SimulationSpec(plan=PRESETS["iso230_2"], seed=1)).session
    readings = session.readings.select(session.readings.repeat < 2)
    x, direction = readings.columns["x"], readings.columns["dir_x"]
    u = 2.0 * (x - x.min()) / np.ptp(x) - 1.0
    sizes = 6e-7 * np.random.default_rng(1).normal(size=(4, 3))  # offset, slope and bow of each pass, m
    own = sizes[2 * readings.repeat + (direction > 0)]
    passes = own[:, 0] + own[:, 1] * u + own[:, 2] * (u**2 - 0.4)
    reversal = -6e-6 * direction * (1.0 + 0.6 * np.sin(3.5 * u) + 0.3 * np.cos(5.0 * u))
    disturbed = replace(readings, displacement=readings.displacement + reversal + passes)
    found = diagnose(session.with_readings(disturbed))
    assert set(found.search.spread) == {"pass"}
    assert found.accepted == ("lost_motion_x",)
    cycles = next(each for each in found.predicted["lost_motion_x"] if each.what == "cycles")
    assert min(cycles.log_gains) > 100.0


def test_the_gain_is_the_share_by_which_the_mean_square_falls() -> None:
    """Ten readings that are predicted to within their noise, which are off by twice as much without the effect."""
    squares = 10 * (2.0**2 - 1.0**2)
    assert Prediction("setups", (0.2 * squares, 0.3 * squares), 10).gain == pytest.approx(0.75)
    assert Prediction("setups", (0.0, 0.0), 10).gain == 0.0
    assert Prediction("setups", (-2.0, -3.0), 10).gain == pytest.approx(-1.0)


def test_parts_without_which_there_is_no_model_are_counted_and_one_prediction_says_nothing() -> None:
    session = with_effect(None)
    fit = fit_of([session])
    candidates, _ = effect_candidates(Pool(fit), [catalogue()[EFFECT]])
    look = replace(search_effects(Pool(fit), candidates, []), accepted=(EFFECT,))

    def found(*needed: int) -> dict[str, Prediction]:
        def fitted(left: Sequence[Session]) -> JointFit:
            if not set(needed) <= set(left[0].readings.setup.tolist()):
                raise ModelError("too little")
            return fit_of(left)

        return {each.what: each for each in predictions([session], look, fitted)[EFFECT]}

    whole, without = found(), found(0)
    assert without["setups"].needed == 1 and whole["setups"].needed == 0
    assert without["setups"].log_gains == whole["setups"].log_gains[1:]
    assert without["cycles"] == whole["cycles"]
    count = np.bincount(session.readings.setup)
    assert {each.readings for each in whole.values()} == {count.sum()}
    assert without["setups"].readings == count[1:].sum()
    assert len(found(0, 1)["setups"].log_gains) == 2
    assert set(found(0, 1, 2)) == set(found(0, 1, 2, 3)) == set(whole) - {"setups"}
