"""Two effects that hide each other."""

from __future__ import annotations

import numpy as np
import pytest
from machine_tool_calibration.diagnosis.likelihood import observed, reduce
from machine_tool_calibration.diagnosis.pairs import best_pair
from machine_tool_calibration.diagnosis.ranking import rank_candidates
from machine_tool_calibration.diagnosis.significance import search
from machine_tool_calibration.diagnosis.spread import run_spreads

from machine_tool_calibration.diagnosis.candidates import effect_candidates, stack
from machine_tool_calibration.diagnosis.diagnose import diagnose
from machine_tool_calibration.diagnosis.look import look_at
from machine_tool_calibration.effects.catalogue import catalogue
from machine_tool_calibration.methods.identify import build_model
from machine_tool_calibration.model.fit import Fit, fit_models, screen
from machine_tool_calibration.session.session import Session
from machine_tool_calibration.simulation import PRESETS, FlawSpec, SimulationSpec, simulate

# Two of similar strength: each leaves slopes in the runs which look like a spread between them.
BOTH = (
    FlawSpec(id="thermal_expansion_z", amplitude=8.0e-7),
    FlawSpec(id="thermal_expansion_y", amplitude=6.6e-7),
)


def step_diagonal(seed: int, *flaws: FlawSpec) -> Session:
    return simulate(SimulationSpec(plan=PRESETS["step_diagonal"], seed=seed, effects=flaws)).session


def fitted(session: Session) -> Fit:
    return fit_models([build_model(session)[0]]).fits[0]


def test_two_effects_that_hide_each_other_are_found_together() -> None:
    found = diagnose(step_diagonal(756865, *BOTH), seed=1)
    first = found.looks[0]
    assert first.pair is not None
    assert set(first.pair.names) == {flaw.id for flaw in BOTH} == set(found.accepted)
    assert found.verdict == "missing_effect"
    assert 0.7 < found.looks[-1].fit.joint.reduced_chi_square < 1.3
    # What is said of each is said of it beside the other.
    assert all(r.family_p_value < 0.03 for r in found.ranked[:2])


def test_without_the_search_for_pairs_neither_would_have_been_found() -> None:
    session = step_diagonal(756865, *BOTH)
    fit = fitted(session)
    candidates, _ = effect_candidates(fit.model.observations, list(catalogue().values()))
    alone = look_at(fit, candidates, [], np.random.default_rng(1), 399, pairs=False)
    assert alone.winner() is None


def test_one_effect_is_not_taken_for_two() -> None:
    found = diagnose(step_diagonal(11, FlawSpec(id="backlash_y", amplitude=1.5e-6)), seed=1)
    assert found.accepted == ("backlash_y",)


def test_pairs_are_rarely_significant_where_nothing_is_missing() -> None:
    alarms = 0
    for seed in range(12):
        fit = fitted(step_diagonal(9000 + seed))
        candidates, _ = effect_candidates(fit.model.observations, list(catalogue().values()))
        pair = look_at(fit, candidates, [], np.random.default_rng(seed), 199, pairs=True).pair
        assert pair is not None
        alarms += pair.family_p_value < 0.05
    assert alarms <= 12 * 0.05 + 2 * np.sqrt(12 * 0.05 * 0.95)


def test_the_gain_of_a_pair_is_that_of_both_in_the_model() -> None:
    """Without a spread between the runs the screening is exact: a fit with both columns explains as much."""
    fit = fitted(step_diagonal(5, *BOTH))
    observations = fit.model.observations
    wanted = [catalogue()[flaw.id] for flaw in BOTH]
    candidates, _ = effect_candidates(observations, wanted)
    columns, places = stack(candidates, len(observations))
    spread = run_spreads(observations)
    none = spread.columns[:0]
    projected = screen(fit, np.concatenate([columns, none]))
    reduced = reduce(projected, spread.family[:0], fit.solution.degrees_of_freedom, 0.1)
    data = observed(projected.gram)
    rng = np.random.default_rng(1)
    found = search(reduced, places, data, rng, sets=199)
    ranked = rank_candidates(candidates, places, found, reduced, data, observations, len(observations))
    pair = best_pair(ranked, reduced, data, found.likelihoods, rng, 199)
    assert pair is not None
    inner, right, squares = projected.gram[:-1, :-1], projected.gram[:-1, -1], projected.gram[-1, -1]
    left = squares - right @ np.linalg.solve(inner, right)
    n = fit.solution.degrees_of_freedom
    expected = n * np.log(squares / left) - sum(np.log(max(c.sample, 2)) for c in candidates)
    assert pair.gain == pytest.approx(expected, rel=1e-9)
