# SPDX-License-Identifier: Apache-2.0
"""One look at what a model leaves: structures beside effects, and probabilities that belong together.
Sizes that occur: what is tried for is twice the limits of a coefficient; and what an effect's law leaves.
"""

from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.special import expit
from scipy.stats import binom

from machine_tool_calibration.diagnosis.diagnose import diagnose
from machine_tool_calibration.diagnosis.search import effect_search
from machine_tool_calibration.diagnosis.search.candidates import Candidate, ShapedColumns, effect_candidates
from machine_tool_calibration.diagnosis.search.effect_search import EffectSearch, search_effects
from machine_tool_calibration.diagnosis.search.findings import Size, _detectable, without_laws
from machine_tool_calibration.effects.catalogue import catalogue, find_effects
from machine_tool_calibration.effects.effect import Coefficient
from machine_tool_calibration.effects.effect_terms import effect_term
from machine_tool_calibration.effects.formula import FormulaEffect
from machine_tool_calibration.estimation import priors
from machine_tool_calibration.methods.build import build_model
from machine_tool_calibration.model.effect_sizes import smallest_signal
from machine_tool_calibration.model.fit import fit_models
from machine_tool_calibration.model.imperfection import scaled_values
from machine_tool_calibration.residuals.pool import Pool
from machine_tool_calibration.session.session import Session
from machine_tool_calibration.simulation import PRESETS, FlawSpec, SimulationSpec, simulate
from machine_tool_calibration.words import say

from ...plates import with_columns

EFFECTS = ("backlash_x", "backlash_y", "pointer_radial_error", "retroreflector_form", "pointer_zero_offset")


@cache
def session(effect: str | None) -> Session:
    flaws = () if effect is None else (FlawSpec(id=effect, amplitude=4e-6),)
    return simulate(SimulationSpec(plan=PRESETS["tracking_2d"], seed=5, effects=flaws)).session


def looked(
    measured: Session, structures: Sequence[tuple[str, np.ndarray]] = (), effects: Sequence[str] = EFFECTS
) -> EffectSearch:
    fit = fit_models([build_model(measured)[0]])
    candidates, _ = effect_candidates(Pool(fit), [catalogue()[name] for name in effects])
    smooth = say("shape.smooth")
    made = [Candidate(name, (ShapedColumns((), columns),), dependence=(name, smooth)) for name, columns in structures]
    return search_effects(Pool(fit), candidates, made)


def columns_of(effect: str) -> np.ndarray:
    return catalogue()[effect].columns(build_model(session(None))[0].observations)


@pytest.mark.long
def test_a_structure_in_the_span_of_an_effect_is_that_effect() -> None:
    """Otherwise it would take a share of its probability."""
    copied = 3.0 * columns_of("backlash_y")
    look = looked(session("backlash_y"), [("dir_y", copied)])
    assert look.structure == ()
    without = looked(session("backlash_y"))
    assert look.unknown == pytest.approx(without.unknown)
    assert look.of("backlash_y").probability > 0.9
    assert look.of("backlash_y").probability == pytest.approx(without.of("backlash_y").probability)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_structure_of_a_size_that_no_effect_has_is_none_whatever_its_sign(sign: float) -> None:
    """Backlash of three millimetres is something else that goes with the direction."""
    readings, (column,) = session(None).readings, columns_of("backlash_y")
    moved = replace(readings, displacement=readings.displacement + sign * 1.5e-3 * column)
    look = looked(session(None).with_readings(moved), [("dir_y", column[None])], ["backlash_y"])
    assert [one.covariate for one in look.structure] == ["dir_y"]
    assert look.accepted == ()


@pytest.mark.parametrize("effect", ["backlash_y", "pointer_radial_error"])
def test_what_an_effect_would_leave_of_the_residuals_is_what_a_fit_with_it_leaves(effect: str) -> None:
    model, found = build_model(session(effect))[0], looked(session(effect)).of(effect)
    term = effect_term(catalogue()[effect], model.observations, found.shape)
    before, after = (
        np.sqrt(np.mean(fit_models([one]).fits[0].residuals ** 2)) for one in (model, model.with_terms((term,)))
    )
    # A screening need not be exact, and tells most of what the effect takes away.
    assert after < 0.9 * before
    assert found.rms_after == pytest.approx(after, rel=0.05)


@pytest.mark.long
def test_of_a_structure_what_an_effect_does_is_that_effect() -> None:
    """Otherwise the effect would have only what the structure leaves, and the structure is in no model."""
    own = np.random.default_rng(4).normal(size=(2, len(session(None).readings)))
    both = looked(session("backlash_y"), [("dir_y", np.concatenate([3.0 * columns_of("backlash_y"), own]))])
    without = looked(session("backlash_y"), [("dir_y", own)])
    assert both.unknown == pytest.approx(without.unknown, rel=1e-3)
    assert both.of("backlash_y").probability == pytest.approx(without.of("backlash_y").probability, rel=1e-3)


def test_a_structure_of_its_own_is_told_and_no_effect_is() -> None:
    rng = np.random.default_rng(3)
    own = rng.normal(size=(1, len(session(None).readings)))
    moved = session(None).readings.displacement + session(None).sigma * own[0]
    look = looked(with_columns(session(None), moved), [("temper", own)])
    assert look.unknown > 0.99
    assert look.structure[0].covariate == "temper" and look.structure[0].shape == "smooth"
    assert 0.2 < look.structure[0].share < 0.8
    assert look.accepted == ()


@pytest.mark.long
def test_probabilities_belong_together() -> None:
    for effect in (None, "backlash_y"):
        look = looked(session(effect))
        assert sum(p for _, p in look.sets) == pytest.approx(1.0)
        assert look.nothing == pytest.approx(dict(look.sets).get((), 0.0))
        for finding in look.findings:
            with_it = sum(p for names, p in look.sets if finding.name in names)
            assert finding.probability == pytest.approx(with_it)
            assert 0.0 <= finding.p_value <= 1.0
        ranked = [finding.probability for finding in look.findings if finding.rank]
        assert ranked == pytest.approx(sorted(ranked, reverse=True), abs=1e-9)
        assert [bool(finding.rank) for finding in look.findings] == [True] * len(ranked) + [False]


@pytest.mark.parametrize(("usual", "seldom", "expected"), [(8, 4, 0.05), (18, 8, 0.05), (36, 16, 1.0 / 40.0)])
def test_of_very_many_effects_no_more_than_one_is_expected(
    monkeypatch: pytest.MonkeyPatch, usual: int, seldom: int, expected: float
) -> None:
    """One of which others are usual counts as a fourth of one, and is as much less probable."""
    monkeypatch.setattr(effect_search, "search", lambda gram, blocks, log_odds, **how: expit(log_odds))
    monkeypatch.setattr(effect_search, "special_cases", lambda columns: {})
    count = usual + seldom
    columns: Any = SimpleNamespace(
        seen=range(count + 1),
        effects=count,
        candidates=[SimpleNamespace(is_seldom=k >= usual) for k in range(count)] + [None],  # and a structure
        gram=SimpleNamespace(with_memory=lambda memory: None),
        blocks=(),
        pool=SimpleNamespace(side_by_side=False),
    )
    found = effect_search._searched(columns, 1.0)
    assert found == pytest.approx([expected] * usual + [expected / 4.0] * seldom + [priors.STRUCTURE])


def test_the_bayesian_criterion_falls_by_what_an_effect_explains_less_the_price_of_its_coefficients() -> None:
    """As fits with and without it say, beside little that does not reproduce."""
    measured = session("backlash_y")
    look, n = looked(measured, effects=("backlash_x", "backlash_y")), len(measured.readings)
    (model, _), without = build_model(measured), fit_models([build_model(measured)[0]]).solution.chi_square
    for name in ("backlash_x", "backlash_y"):
        added = model.with_terms([effect_term(catalogue()[name], model.observations)])
        gained = n * np.log(without / fit_models([added]).solution.chi_square)
        assert look.of(name).bic_gain == pytest.approx(gained - np.log(n), rel=0.03)


def test_what_the_model_absorbs_is_neither_found_nor_detectable() -> None:
    look = looked(session(None))
    (absorbed,) = (a for a in look.absorbed if a.effect == "pointer_zero_offset")
    assert absorbed.by
    found = look.of("pointer_zero_offset")
    assert (found.rank, found.probability, found.detectable, found.place) == (0, 0.0, {}, None)


def test_look_alikes_make_a_group_and_of_those_as_likely_the_commoner_is_accepted() -> None:
    look = looked(session("pointer_radial_error"))
    (group,) = (g for g in look.groups if "pointer_radial_error" in g)
    assert set(group) == {"pointer_radial_error", "retroreflector_form"}
    assert look.accepted == ("pointer_radial_error",)
    assert sum(look.of(name).probability for name in group) > priors.ACCEPTED
    # In a plane the columns of both are the same: what differs is how large they may be.
    radial, form = (look.of(name).probability for name in ("pointer_radial_error", "retroreflector_form"))
    assert radial == pytest.approx(form, rel=0.4)


def test_a_finer_point_of_another_effect_is_seldom_and_what_is_no_effect_is_not() -> None:
    fit = fit_models([build_model(session(None))[0]])
    found, _ = effect_candidates(Pool(fit), find_effects(["backlash_y", "thermal_lag_y", "reversal_ECY"]))
    assert {one.name: one.is_seldom for one in found} == {
        "backlash_y": False, "thermal_lag_y": True, "reversal_ECY": True,
    }  # fmt: skip
    assert not replace(found[1], effect=None).is_seldom


@pytest.mark.long
def test_a_size_that_is_seldom_stands_for_no_look_alike_that_is_as_likely() -> None:
    """A drift of the reading, or a dead path of metres in air that warms up steadily."""
    drift = FlawSpec(id="linear_drift", amplitude=4e-7)
    look = diagnose(simulate(SimulationSpec(plan=PRESETS["iso230_2"], seed=3, effects=(drift,))).session).search
    assert look.of("dead_path").probability > look.of("linear_drift").probability > 0.2
    assert look.of("dead_path").sizes[0].value > 1.0
    assert look.accepted == ("linear_drift",)


@pytest.mark.long
def test_detectable_sizes_are_found_that_often(many: Any) -> None:
    """An effect of the stated smallest size is found in about 80 of 100 sessions, one of half the size seldom."""
    size = looked(session(None)).of("backlash_y").detectable["b"]

    def found(share: float, runs: int) -> int:
        flaw = FlawSpec(id="backlash_y", size=share * size)
        specs = [SimulationSpec(plan=PRESETS["tracking_2d"], seed=2000 + k, effects=(flaw,)) for k in range(runs)]
        return sum("backlash_y" in looked(simulate(spec).session).accepted for spec in specs)

    full, half = many.part(0.6).count, many.part(0.3).count
    low, high = binom.interval(0.998, full, 0.8)
    assert low <= found(1.0, full) <= high
    assert found(0.5, half) < half / 2


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
    inner, shaped = np.array([[4e12]]), ShapedColumns((), np.zeros((1, 3)), (WAVE,))
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
    effects = [found["warmup_y"], found[other]]
    names = without_laws(effects, pool, [warm, late], lambda some: 1.0)
    assert names == (("warmup_y", other) if kept else ("warmup_y",))


def test_what_takes_most_of_what_a_surer_effect_leaves_is_named_beside_it() -> None:
    """A quarter of a warm-up, smooth in time: what its law is off by, or another warm-up's."""
    session = simulate(SimulationSpec(plan=PRESETS["tracking_2d"], seed=4)).session
    pool = Pool(fit_models([build_model(session)[0]]))
    effects = [c for c in effect_candidates(pool, find_effects(["warmup_y", "warmup_x"]))[0]]
    warm = 1e-5 * effects[0].shapes[0].columns[0]
    for share, named in ((0.6, 1), (0.4, 2)):
        squares = {1: 1.0, 2: share}
        kept = without_laws(effects, pool, [warm, 0.3 * warm], lambda some, of=squares: of[len(some)])
        assert len(kept) == named


def test_of_a_quick_wave_the_periods_that_explain_most_are_searched() -> None:
    """The readings tell its period to some thousandths: hundreds of others lie between its limits."""
    period = {"tau": {"unit": "s", "low": 30.0, "high": 3000.0}}
    coefficients = {"a": {"unit": "m", "low": -2e-5, "high": 2e-5}}
    formula = {"id": "swing", "enters": "y", "formula": "a * cos(2 * pi * time / tau)"}
    wave = FormulaEffect(formula | {"coefficients": coefficients, "shapes": period})
    still = session(None)
    pool = Pool(fit_models([build_model(still, None)[0]]))
    moved = 3e-6 * wave.columns(pool.observations[0], (97.0,))[0]
    swinging = still.with_readings(replace(still.readings, displacement=still.readings.displacement + moved))
    pool = Pool(fit_models([build_model(swinging, None)[0]]))
    ((candidate,), _) = effect_candidates(pool, [wave])
    assert len(candidate.shapes) < 100 < candidate.count
    assert min(abs(shaped.shape[0] - 97.0) for shaped in candidate.shapes) < 0.3
