# SPDX-License-Identifier: Apache-2.0
"""The verdict on simulated sessions: nothing missing, one effect, two, one that nobody knows, chips."""

import re
from contextlib import nullcontext
from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from machine_tool_calibration.diagnosis.adding import _changes_nothing, _hold, _sized, _spurious, better_special_cases
from machine_tool_calibration.diagnosis.diagnose import Diagnosis, _verdict, diagnose
from machine_tool_calibration.diagnosis.improve import improve
from machine_tool_calibration.diagnosis.search.candidates import effect_candidates
from machine_tool_calibration.diagnosis.search.effect_search import search_effects
from machine_tool_calibration.effects.catalogue import catalogue, find_effects
from machine_tool_calibration.errors import ModelError
from machine_tool_calibration.methods.build import build_model
from machine_tool_calibration.methods.fitted import FitRequest, fit_sessions
from machine_tool_calibration.methods.identify import identify
from machine_tool_calibration.model.fit import JointFit, fit_models, screen
from machine_tool_calibration.model.model import Kind, Parameter
from machine_tool_calibration.residuals.leverage import leverage
from machine_tool_calibration.residuals.pool import Pool
from machine_tool_calibration.simulation import PRESETS, FlawSpec, SimulationSpec, Spread, simulate
from machine_tool_calibration.words import say

from ..cube import CUBE
from ..diagnosed import diagnosed
from ..told import keys

SIGMA = 3e-7


def look(plan: str, seed: int, *flaws: FlawSpec, **changes: object) -> Diagnosis:
    chosen = CUBE if plan == "tracking_3d" else PRESETS[plan]
    return diagnosed(SimulationSpec(plan=chosen, seed=seed, effects=flaws, **changes))  # type: ignore[arg-type]


@pytest.mark.long
@pytest.mark.parametrize("plan", ["tracking_2d", "tracking_3d", "rotary_axis", "probing_cross"])
def test_nothing_missing_is_called_adequate(plan: str) -> None:
    assert look(plan, 101).verdict == "adequate"


@pytest.mark.parametrize(
    ("name", "after", "message"),
    [
        ("position_error_u", [2.0, 2.0, np.nan], ""),
        ("position_error_u", [2.0, 2.0, 1e4], ""),  # what the map did not have is no loss, however badly it is known
        ("position_error_u", [2.0, np.nan, np.nan], "together with it 1 values of the map would no longer"),
        ("EXX_u", [70.0, 70.0, np.nan], "35 times worse"),
        ("EXX_u", [70.0] * 6, "35 times worse"),  # with a value for either direction of approach
        ("dead_path_u", [70.0, np.nan, np.nan], ""),  # none of the machine's
    ],
)
def test_an_effect_may_cost_the_map_neither_values_nor_all_use(name: str, after: list[float], message: str) -> None:
    maps: Any = [SimpleNamespace(content={name: 1e-6 * np.array(u)}) for u in ([2.0, 2.0, np.nan], after)]
    with pytest.raises(ModelError, match=message) if message else nullcontext():
        _hold(*maps)


@pytest.mark.parametrize(
    ("probabilities", "chi_squares", "accepted", "good_enough", "verdict"),
    [
        # What has no known cause takes 600 of what is left: the story where that is more than the effect took.
        ((0.99, 0.001), (1000.0, 800.0), True, False, "unexplained"),
        ((0.99, 0.001), (1000.0, 100.0), True, False, "missing_effect"),
        ((0.30, 0.001), (1000.0, 800.0), True, False, "missing_effect"),
        ((0.99, 0.900), (1000.0, 800.0), True, False, "missing_effect"),
        ((0.99, 0.001), (1000.0, 800.0), True, True, "missing_effect"),
        # Where no effect is accepted: that something is missing must be sure, and must matter.
        ((0.99, 0.001), (1000.0, 1000.0), False, False, "unexplained"),
        ((0.30, 0.001), (1000.0, 1000.0), False, False, "unexplained"),
        ((0.30, 0.001), (1000.0, 1000.0), False, True, "adequate"),
        ((0.05, 0.900), (1000.0, 1000.0), False, False, "adequate"),
    ],
)
@pytest.mark.parametrize("named", [True, False])
def test_the_verdict_by_what_is_unknown_and_what_effects_explain(
    monkeypatch: pytest.MonkeyPatch,
    named: bool,
    probabilities: tuple[float, float],
    chi_squares: tuple[float, float],
    accepted: bool,
    good_enough: bool,
    verdict: str,
) -> None:
    """Probabilities that something unknown is missing, and nothing; sums of squares without and with the effect.

    What is unknown is named as a pattern of what is left, or only in the most probable set.
    """
    module = "machine_tool_calibration.diagnosis.diagnose"
    monkeypatch.setattr(f"{module}._good_enough", lambda found: good_enough)
    monkeypatch.setattr(f"{module}._without_cause", lambda found: 0.0 if named else 600.0)
    fits = [SimpleNamespace(solution=SimpleNamespace(chi_square=size)) for size in chi_squares]
    left = (SimpleNamespace(share=600.0 / chi_squares[1]),) * named
    found = SimpleNamespace(
        contradicted=False,
        unknown=probabilities[0],
        nothing=probabilities[1],
        fits=fits,
        accepted=("backlash_y",) * accepted,
        gross_errors=(),
        left=left,
        refused={},
    )
    assert _verdict(cast(Diagnosis, found)) == verdict


@pytest.mark.parametrize(
    ("probability", "why", "verdict"),
    [
        (0.97, say("undetermined.not_predicted", what="x"), "unexplained"),
        (0.90, say("undetermined.not_predicted", what="x"), "adequate"),
        (0.97, say("undetermined.explains_nothing"), "adequate"),
    ],
)
def test_a_sure_cause_that_is_refused_leaves_the_model_unexplained(probability: float, why: str, verdict: str) -> None:
    """Beside it nothing is looked for any longer that it would explain, so that nothing seems to be missing."""
    search = SimpleNamespace(of=lambda name: SimpleNamespace(probability=probability))
    fits = [SimpleNamespace(solution=SimpleNamespace(chi_square=1000.0))]
    known = {"contradicted": False, "unknown": 0.0, "nothing": 0.9, "accepted": (), "gross_errors": (), "left": ()}
    found = SimpleNamespace(**known, fits=fits, search=search, refused={"backlash_y": why})
    assert _verdict(cast(Diagnosis, found)) == verdict


@pytest.mark.parametrize(("left", "noisy"), [(0, True), (1, True), (0, False)])
def test_a_structure_that_repeats_have_as_well_is_none(left: int, noisy: bool) -> None:
    """However probable it is beside the others, unless its p-value says that it is no chance."""
    unknown = 0.0 if noisy and not left else 0.9
    search = SimpleNamespace(unknown=0.9, nothing=0.06)
    found = SimpleNamespace(search=search, left=left * (SimpleNamespace(share=0.5),), noisy=noisy, unknown=unknown)
    assert Diagnosis.unknown.fget(found) == unknown  # type: ignore[attr-defined]
    assert Diagnosis.nothing.fget(found) == pytest.approx(0.96 - unknown)  # type: ignore[attr-defined]


def test_what_identify_refuses_is_not_called_adequate() -> None:
    session = simulate(SimulationSpec(plan=PRESETS["tracking_2d"], seed=1)).session
    columns = {**session.readings.columns, "x": 1.1 * session.readings.columns["x"]}
    stretched = session.with_readings(replace(session.readings, columns=columns))
    with pytest.raises(ModelError, match=f"^{re.escape(stretched.source)}: the position error .* which no machine has"):
        identify(stretched)
    with pytest.raises(ModelError, match="which no machine has"):
        diagnose(stretched)


@pytest.mark.long
def test_false_alarms_stay_rare_with_and_without_a_spread_between_setups(many: Any) -> None:
    spreads = (Spread(), Spread(slope=0.4 * SIGMA, bow=0.4 * SIGMA))
    seeds = range(500, 500 + many.part(1 / 5).count)
    alarms = [look("tracking_2d", seed, spread=one).verdict != "adequate" for one in spreads for seed in seeds]
    assert sum(alarms) <= many.part(2 / 5).at_most(0.05)


@pytest.mark.long(but=("tracking_3d-thermal_expansion_x-6e-06",))
@pytest.mark.parametrize(
    ("plan", "effect", "amplitude"),
    [
        ("tracking_3d", "thermal_expansion_x", 6e-6),
        ("rotary_axis", "backlash_c", 2e-6),
        ("probing_cam", "workpiece_thermal", 6e-6),
    ],
)
def test_a_hidden_effect_is_named_and_the_error_falls(plan: str, effect: str, amplitude: float) -> None:
    found = look(plan, 77, FlawSpec(id=effect, amplitude=amplitude))
    assert found.verdict == "missing_effect"
    alike = {effect}.union(*(group for group in found.search.groups if effect in group))
    assert found.accepted[0] in alike
    before, after = (fit.reduced_chi_square for fit in (found.fits[0], found.fits[-1]))
    assert after < before
    assert 0.7 < after < 1.3


@pytest.mark.long
@pytest.mark.parametrize(("angle", "seed"), [("EBX", 52), ("EAZ", 52)])
def test_one_angular_error_larger_than_the_others_is_no_lost_motion(angle: str, seed: int) -> None:
    # In a diagonal an axis moves one way: what comes from its angles is then much like a reversal.
    found = look("step_diagonal", seed, FlawSpec(id=angle, amplitude=2e-6))
    assert (found.verdict, found.accepted) == ("adequate", ())


@pytest.mark.long
def test_what_free_angles_took_up_leaves_the_tool_point() -> None:
    hidden = FlawSpec(id="backlash_y", amplitude=3e-6)
    session = simulate(SimulationSpec(plan=PRESETS["step_diagonal"], seed=77, effects=(hidden,))).session
    done = improve(session)
    assert done.diagnosis.verdict == "missing_effect"
    assert done.diagnosis.accepted == ("backlash_y",)
    assert 0.7 < done.diagnosis.fits[-1].reduced_chi_square < 1.3
    before, after = (step.residual_volumetric_error(done.steps[-1]) for step in (done.steps[0], done.steps[-1]))
    assert before is not None
    assert after is not None
    assert after < 0.5 * before


@pytest.mark.long
def test_an_effect_that_nobody_knows_is_unexplained_and_its_covariate_named() -> None:
    found = look("tracking_2d", 12, FlawSpec(id="unlisted_cubic_path", amplitude=1.5e-5))
    assert found.verdict == "unexplained"
    assert found.accepted == ()
    assert found.search.structure[0].covariate in ("path", "path within the setup", "displacement")


@pytest.mark.long
def test_the_same_seed_gives_the_same_answer_to_the_last_bit() -> None:
    spec = SimulationSpec(plan=PRESETS["iso230_2"], seed=9, effects=(FlawSpec(id="backlash_x", amplitude=1e-6),))
    one, two = (diagnose(simulate(spec).session) for _ in range(2))
    assert [r.candidate.name for r in one.ranked] == [r.candidate.name for r in two.ranked]
    assert [r.p_value for r in one.ranked] == [r.p_value for r in two.ranked]


@pytest.mark.long
def test_an_effect_in_the_model_is_not_looked_for_again() -> None:
    session = simulate(
        SimulationSpec(plan=PRESETS["tracking_2d"], seed=77, effects=(FlawSpec(id="backlash_y", amplitude=1.5e-6),))
    ).session
    found = diagnose(FitRequest((session,), effects=("backlash_y",)))
    assert found.verdict == "adequate"
    assert "backlash_y" not in {r.candidate.name for r in found.ranked}


@pytest.mark.parametrize("plan", ["tracking_2d", "rotary_axis", "probing_cross", "step_diagonal"])
def test_leverages_add_up_to_the_unknowns(plan: str) -> None:
    session = simulate(SimulationSpec(plan=PRESETS[plan], seed=2)).session
    fit = fit_models([build_model(session)[0]]).fits[0]
    free = len(fit.model.observations) - float(leverage(fit).sum())
    n_priors = 0 if fit.joint.assembly.problem.priors is None else len(fit.joint.assembly.problem.priors.value)
    assert free == pytest.approx(fit.solution.degrees_of_freedom, abs=n_priors + 1e-6)


def test_screening_an_effect_says_what_adding_it_gives() -> None:
    """The score of one pass equals the fall of the sum of squares when the effect is really added (linear model)."""
    spec = SimulationSpec(plan=PRESETS["tracking_2d"], seed=8, effects=(FlawSpec(id="backlash_y", amplitude=1.5e-6),))
    session = simulate(spec).session
    before, after = identify(session), identify(session, effects=["backlash_y"])
    fit = before.fit
    projected = screen(fit, catalogue()["backlash_y"].columns(fit.model.observations)).gram
    fall = before.fit.solution.chi_square - after.fit.solution.chi_square
    assert projected[0, 1] ** 2 / projected[0, 0] == pytest.approx(fall, rel=1e-6)


def test_rounding_is_no_structure() -> None:
    plan = PRESETS["tracking_2d"].model_copy(update={"station_uncertainty": 0.0})
    found = diagnose(simulate(SimulationSpec(plan=plan, seed=4, noise_factor=0.0)).session)
    assert found.verdict == "adequate"
    assert found.accepted == ()
    assert not found.search.structure


def test_an_effect_must_lower_the_sum_of_squares() -> None:
    spec = SimulationSpec(plan=PRESETS["iso230_2"], seed=8, effects=(FlawSpec(id="backlash_x", amplitude=1.5e-6),))
    session = simulate(spec).session
    without, with_it = (identify(session, effects=effects).joint for effects in ([], ["backlash_x"]))
    assert _changes_nothing(without, with_it, "backlash_x", 1.0) is None
    assert keys(_changes_nothing(without, without, "backlash_x", 1.0)) == ["undetermined.explains_nothing"]
    assert keys(_changes_nothing(with_it, without, "backlash_x", 1.0)) == ["undetermined.explains_nothing"]
    # Of readings of which a million tell as much as one it is nothing.
    assert keys(_changes_nothing(without, with_it, "backlash_x", 1e6)) == ["undetermined.explains_nothing"]


@pytest.mark.parametrize(
    ("size", "correlation", "sized"),
    [((1.5, 0.1), 0.0, False), ((2.5, 0.0), 0.0, True), ((1.5, 0.1), 0.99, True), ((1.5, 1.5), 0.99, False)],
)
def test_sizes_that_go_together_stand_out_together(size: tuple[float, float], correlation: float, sized: bool) -> None:
    """In standard uncertainties for independent noise; a time constant that is known well says nothing of the size."""
    parameters = [
        Parameter(name, unit, kind=Kind.EFFECT, owner="e") for name, unit in (("s", "1"), ("q", "1"), ("tau", "s"))
    ]
    covariance = np.eye(3)
    covariance[0, 1] = covariance[1, 0] = correlation
    marginal = SimpleNamespace(independent=covariance / 4.0, scatter=2.0)
    widened = covariance + 400.0 * np.eye(3)
    published = SimpleNamespace(theta=np.array([*size, 50.0]), covariance=widened, determined=np.ones(3, dtype=bool))
    fit = SimpleNamespace(published=published, marginal=marginal, assembly=SimpleNamespace(parameters=parameters))
    assert _sized(cast(JointFit, fit), "e") is sized


def test_what_explains_less_than_its_special_case_is_not_itself() -> None:
    """A sensor that is late: the axis is ahead of it, and to lag behind it makes what expansion explains worse."""
    clock = 15.0 * np.arange(300)
    swing = np.sin(2.0 * np.pi * clock / 3000.0)
    late = np.sin(2.0 * np.pi * (clock - 300.0) / 3000.0)
    session = simulate(SimulationSpec(plan=PRESETS["iso230_2"], seed=8)).session
    readings = session.readings
    n = len(readings)
    columns = {"x": np.full(n, 0.4), "time": clock[:n], "temperature_x": 20.0 + late[:n]}
    columns |= {name: readings.columns[name] for name in ("gx", "gy", "gz")}
    noise = 1e-7 * np.random.default_rng(3).normal(size=n)
    session = session.with_readings(replace(readings, displacement=8e-6 * swing[:n] + noise, columns=columns))
    request = FitRequest.of(session)
    first = fit_sessions(request).joint
    pool = Pool(first)
    candidates, _ = effect_candidates(pool, find_effects(["thermal_expansion_x", "thermal_lag_x"]))
    search = search_effects(Pool(first), candidates, [])
    found = _spurious(search, first, ("thermal_lag_x",), lambda ids: fit_sessions(request.adding(ids)))
    assert "thermal_expansion_x" in found["thermal_lag_x"]
    assert not _spurious(search, first, ("thermal_expansion_x",), lambda ids: fit_sessions(request.adding(ids)))
    late = search.of("thermal_lag_x").candidate
    assert better_special_cases(late, lambda ids: fit_sessions(request.adding(ids))) == ("thermal_expansion_x",)


def test_a_size_that_may_be_zero_is_not_added() -> None:
    request = FitRequest.of(simulate(SimulationSpec(plan=PRESETS["iso230_2"], seed=9)).session)
    first = fit_sessions(request).joint
    candidates, _ = effect_candidates(Pool(first), find_effects(["backlash_x"]))
    search = search_effects(Pool(first), candidates, [])
    found = _spurious(search, first, ("backlash_x",), lambda ids: fit_sessions(request.adding(ids)))
    assert "does not stand out" in found["backlash_x"]
    # Where chance does not make it, repeats that leave room for it do not count.
    sure = replace(search, findings=tuple(replace(f, p_value=1e-6) for f in search.findings))
    assert not _spurious(sure, first, ("backlash_x",), lambda ids: fit_sessions(request.adding(ids)))
