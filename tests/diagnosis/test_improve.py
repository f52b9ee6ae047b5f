# SPDX-License-Identifier: Apache-2.0
"""The loop on simulated machines: the hidden effect is added, the error falls, the map comes nearer to the truth."""

from dataclasses import replace
from functools import cache
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from machine_tool_calibration.arrays import Array, rms
from machine_tool_calibration.diagnosis import improve as improve_module
from machine_tool_calibration.diagnosis.compare import Comparison, compare
from machine_tool_calibration.diagnosis.consequence import consequences
from machine_tool_calibration.diagnosis.history import Entry
from machine_tool_calibration.diagnosis.improve import Improvement, Step, entry_of, improve
from machine_tool_calibration.errors import ModelError
from machine_tool_calibration.methods.fitted import FitRequest
from machine_tool_calibration.methods.identify import identify
from machine_tool_calibration.model.widening import BESIDE
from machine_tool_calibration.reports.comparison import in_words
from machine_tool_calibration.reports.improvement import improvement_document, improvement_words
from machine_tool_calibration.reports.verdict import headline
from machine_tool_calibration.simulation import PRESETS, Chips, FlawSpec, SimulationSpec, simulate
from machine_tool_calibration.words import say

from .. import plates
from ..diagnosed import diagnosed
from ..told import keys


@cache
def improved(seed: int, backlash: float = 0.0) -> tuple[Improvement, list[float]]:
    """The loop on a tracking interferometer's session, with backlash of Y, and the shares of progress that it told."""
    shares: list[float] = []
    effects = (FlawSpec(id="backlash_y", size=backlash),) if backlash else ()
    session = simulate(SimulationSpec(plan=PRESETS["tracking_2d"], seed=seed, effects=effects)).session
    return improve(session, progress=lambda what, share: shares.append(share)), shares


def map_error(done: Improvement, step: int, truth: dict[str, list[list[float]]]) -> float:
    """RMS distance from the true errors once the best shift and turn is taken out, m."""
    error_map = done.steps[step].result.error_map
    points, true = np.array(truth["points"])[:, :2], np.array(truth["position_error"])[:, :2]
    assert error_map.points[:, :2] == pytest.approx(points)
    difference: Array = error_map.error[:, :2] - true
    n = len(points)
    rigid = np.zeros((n, 2, 3))
    rigid[:, 0, 0] = rigid[:, 1, 1] = 1.0
    rigid[:, 0, 2], rigid[:, 1, 2] = -points[:, 1], points[:, 0]
    flat = rigid.reshape(2 * n, 3)
    left = difference.ravel() - flat @ np.linalg.lstsq(flat, difference.ravel(), rcond=None)[0]
    return float(np.sqrt(np.sum(left**2) / n))


def test_the_hidden_effect_is_added_and_everything_falls() -> None:
    spec = SimulationSpec(plan=PRESETS["tracking_2d"], seed=77, effects=(FlawSpec(id="backlash_y", size=2e-6),))
    simulated = simulate(spec)
    done, _ = improved(77, 2e-6)
    assert [s.change for s in done.steps] == ["", "backlash_y"]
    assert [s.label for s in done.steps] == ["first model", "+ backlash_y"]
    first, last = done.steps
    assert last.result.rms_residual < 0.4 * first.result.rms_residual
    assert last.reduced_chi_square == pytest.approx(1.0, abs=0.3)
    assert first.left_at_tool is not None
    assert last.left_at_tool is not None
    assert last.left_at_tool < 0.4 * first.left_at_tool
    assert last.map_uncertainty is not None
    assert last.map_uncertainty <= last.left_at_tool < 1.2 * last.map_uncertainty
    assert last.map_change is not None
    truth = simulated.truth.document()
    before, after = map_error(done, 0, truth), map_error(done, 1, truth)
    assert after < 0.6 * before
    # What the table calls left at the tool point is of the size of what is really left.
    assert after < 2 * last.left_at_tool
    (size,) = last.parameters
    assert abs(size.value - 2e-6) < 4 * size.standard_uncertainty


@pytest.mark.parametrize(("p_value", "left", "looks"), [(0.5, ("wave",), 3), (1e-5, (), 3), (0.5, (), 1)])
def test_the_model_with_what_was_found_is_looked_at_anew(
    p_value: float, left: tuple[str, ...], looks: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What something larger hid, while the model leaves something; the probability of each is that of its own look."""
    looked: list[tuple[str, ...]] = []
    hidden = {(): ("backlash_y", 0.9), ("backlash_y",): ("backlash_x", 0.8)}

    def look(chosen: FitRequest, **_: object) -> object:
        looked.append(chosen.effects)
        name, probability = hidden.get(chosen.effects, ("", 0.0))
        search = SimpleNamespace(of=lambda effect: SimpleNamespace(probability=probability))
        told = {"fits": (SimpleNamespace(p_value=p_value),), "left": left, "search": search, "alternatives": {}}
        return SimpleNamespace(accepted=(name,) * bool(name), set_aside=((),), gross_errors=(), chosen=chosen, **told)

    monkeypatch.setattr(improve_module, "diagnose", look)
    shares: list[float] = []
    session = simulate(SimulationSpec(plan=PRESETS["tracking_2d"], seed=77)).session
    done = improve(session, progress=lambda what, share: shares.append(share))
    both = ("backlash_y", "backlash_x")
    assert looked == [(), both[:1], both][:looks]
    assert done.accepted == both[: min(looks, 2)]
    assert [step.change for step in done.steps] == ["", *done.accepted]
    assert done.steps[-1].result.effects == done.accepted
    assert [done.probability(name) for name in done.accepted] == [0.9, 0.8][: len(done.accepted)]
    assert shares == sorted(shares) and shares[-1] == 1.0


def test_what_may_be_there_is_in_the_uncertainty_though_nothing_is_added(monkeypatch: pytest.MonkeyPatch) -> None:
    may_be = {BESIDE: {"backlash_y": 0.3}}
    none = {"accepted": (), "set_aside": ((),), "gross_errors": (), "alternatives": may_be}
    monkeypatch.setattr(improve_module, "diagnose", lambda chosen, **_: SimpleNamespace(chosen=chosen, **none))
    effects = (FlawSpec(id="backlash_y", size=2e-6),)
    done = improve(simulate(SimulationSpec(plan=PRESETS["tracking_2d"], seed=77, effects=effects)).session)
    first, last = done.steps
    assert (last.change.key, last.result.effects, last.result.alternatives) == ("step.may_be", (), may_be)
    assert last.result.error_map.error == pytest.approx(first.result.error_map.error, abs=1e-15, nan_ok=True)
    assert last.map_uncertainty > 1.1 * first.map_uncertainty


@pytest.mark.long
def test_what_is_left_can_be_compared_between_models() -> None:
    """A model that lacks something underestimates what it leaves: how far its map is off the last one is counted."""
    effects = (FlawSpec(id="probe_pretravel", amplitude=4e-6),)
    done = improve(simulate(SimulationSpec(plan=PRESETS["probing_cross"], seed=7, effects=effects)).session)
    first, last = done.steps
    assert last.map_change is not None and first.left_at_tool is not None
    before, after = first.residual_volumetric_error(done.steps[-1]), last.residual_volumetric_error(done.steps[-1])
    assert before is not None and after is not None
    assert before >= max(last.map_change, 2 * first.left_at_tool)
    assert after == pytest.approx(2 * last.left_at_tool)  # type: ignore[operator]


@pytest.mark.long
def test_nothing_is_added_where_nothing_is_missing() -> None:
    done, _ = improved(101)
    assert [s.change for s in done.steps] == [""]


@pytest.mark.long
def test_nothing_is_added_for_what_no_effect_explains() -> None:
    effects = (FlawSpec(id="unlisted_cubic_path", amplitude=1.5e-5),)
    done = improve(simulate(SimulationSpec(plan=PRESETS["tracking_2d"], seed=6, effects=effects)).session)
    assert done.diagnosis.verdict == "unexplained"
    assert [s.change for s in done.steps] == [""]


@pytest.mark.long
def test_outliers_are_set_aside_first() -> None:
    spec = SimulationSpec(plan=PRESETS["probing_cross"], seed=9, chips=Chips(fraction=0.02))
    simulated = simulate(spec)
    done = improve(simulated.session)
    n = len(simulated.truth.outliers)
    assert [s.label for s in done.steps] == ["first model", f"{n} readings set aside"]
    assert done.steps[1].set_aside == (tuple(sorted(simulated.truth.outliers)),)
    assert len(done.steps[1].result.fit.model.observations) == len(simulated.session.readings) - n
    assert done.steps[1].result.rms_residual < 0.5 * done.steps[0].result.rms_residual


@pytest.mark.long
def test_effects_that_are_there_already_stay() -> None:
    effects = (FlawSpec(id="backlash_y", size=1.5e-6), FlawSpec(id="backlash_x", size=1.2e-6))
    session = simulate(SimulationSpec(plan=PRESETS["tracking_2d"], seed=31, effects=effects)).session
    done = improve(FitRequest((session,), effects=("backlash_y",)))
    assert [s.result.effects for s in done.steps] == [("backlash_y",), ("backlash_y", "backlash_x")]
    assert {p.name for p in done.steps[-1].parameters} == {"backlash_y.b", "backlash_x.b"}


@pytest.mark.long
def test_direct_readings_see_the_tool_point_itself() -> None:
    effects = (FlawSpec(id="backlash_x", size=2e-6),)
    done = improve(simulate(SimulationSpec(plan=PRESETS["iso230_2"], seed=4, effects=effects)).session)
    first, last = done.steps
    # One axis, both directions of approach: all of the backlash is unexplained first, and nothing of it in the end.
    assert first.unexplained_at_tool == pytest.approx(2e-6, rel=0.1)
    assert last.unexplained_at_tool < 1e-7
    assert first.left_at_tool is not None
    assert first.left_at_tool >= first.unexplained_at_tool
    assert last.map_change == pytest.approx(2e-6, rel=0.1)


def test_steps_become_entries_of_a_history() -> None:
    done, _ = improved(77, 2e-6)

    def entry(step: Step) -> Entry:
        return entry_of(step, "sha256-1", ["sha256-1"], "2026-01-01T00:00:00+00:00", "improve", number=1)

    first, last = map(entry, done.steps)
    assert (first.effects, last.effects) == ((), ("backlash_y",))
    assert last.rms_residual == done.steps[1].result.rms_residual
    assert [p.name for p in last.parameters] == ["backlash_y.b"]
    assert last.map_change_rms == done.steps[1].map_change
    # A record without what a method does not map.
    mapped = done.steps[1].result.error_map
    unknown = np.full_like(mapped.error, np.nan)
    result = replace(done.steps[1].result, error_map=replace(mapped, error=unknown, uncertainty=unknown))
    bare = replace(done.steps[1], result=result)
    assert bare.left_at_tool is None
    assert bare.residual_volumetric_error(done.steps[-1]) is None
    assert entry(bare).map_rms is None


@pytest.mark.long
def test_progress_rises_to_one() -> None:
    _, shares = improved(101)
    assert shares == sorted(shares)
    assert shares[-1] == 1.0


@pytest.mark.long
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


@pytest.mark.long
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


@pytest.mark.long
def test_a_reading_of_the_wrong_sign_keeps_no_model_from_being_improved() -> None:
    """With it the stations are found nowhere, or errors of centimetres: the loop begins without it."""
    effects = (FlawSpec(id="backlash_c", size=1.3e-5),)
    session = simulate(SimulationSpec(plan=PRESETS["rotary_axis"], seed=5, effects=effects)).session
    reading = session.readings.displacement.copy()
    wrong = np.argsort(-np.abs(reading))[[0, 40]]
    reading[wrong] *= -1.0
    session = session.with_readings(replace(session.readings, displacement=reading))
    with pytest.raises(ModelError):
        identify(session, keep_all=True)

    done = improve(session)
    rows = tuple(sorted(session.readings.row[wrong].tolist()))
    assert done.accepted == ("backlash_c",)
    assert [step.label for step in done.steps] == ["2 readings set aside", "+ backlash_c"]
    assert {step.set_aside for step in done.steps} == {(rows,)}
    told = [step.result.document() for step in done.steps]
    assert all(tuple(sorted(one["row"] for one in document["rejected"])) == rows for document in told)
    assert {document["observations"] for document in told} == {len(reading)}
    assert tuple(sorted(row.row for row in identify(session, effects=["backlash_c"]).rejected)) == rows

    compared = compare(session)
    assert isinstance(compared, Comparison)
    assert compared.outliers == rows
    assert not compared.counted and "left out of these figures" in in_words(compared)


def test_where_nothing_is_added_the_diagnosis_is_said() -> None:
    """Six readings that scatter by more than declared: that the side from which they were read is likely, not sure."""
    read, side = np.array([88.0, 49.0, 101.7, 109.6, 56.5, 89.6]) * 1e-9, np.array([2.0, 1.0, 2.0, 2.0, 1.0, 2.0])
    columns = {"x": np.full(6, 0.1), "time": np.array([0.1e3, 21.4e3, 82.0e3, 943.9e3, 971.1e3, 1030.2e3])}
    done = improve(plates.session({**columns, "displacement": read, "side": side}, 1e-8))
    told = improvement_words(done)
    assert not done.accepted and str(headline(done.diagnosis)) in told and "follows_side_x" in told
    assert keys(told)[:2] == ["improved.nothing", "diagnosis.none_sure"]


@pytest.mark.parametrize(
    ("verdict", "headline", "p_value", "said"),
    [
        ("unexplained", "unexplained", 1e-9, ["improved.left", "improved.of_none"]),
        ("unexplained", "misfit_alone", 1e-9, ["improved.left"]),
        ("adequate", "", 1e-9, ["improved.scatters"]),
        ("adequate", "", 0.5, []),
    ],
)
def test_what_was_set_aside_and_what_is_left_are_said_beside_what_was_added(
    verdict: str, headline: str, p_value: float, said: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The residual that fell is that by the effects alone; that no effect is named is not said where one was added."""
    monkeypatch.setattr(
        "machine_tool_calibration.reports.improvement.headline", lambda found: say(f"diagnosis.{headline}")
    )

    def step(change: str, rms: float, before: object) -> SimpleNamespace:
        result = SimpleNamespace(rms_residual=rms)
        sizes = {"map_uncertainty": None, "residual_volumetric_error": lambda last: None}
        return SimpleNamespace(change=change, result=result, before=before, set_aside=((7,),), **sizes)

    first = step("", 9e-6, None)
    aside = step("1 reading set aside", 3e-6, first)
    fit = SimpleNamespace(p_value=p_value, birge_ratio=2.0)
    done: Any = SimpleNamespace(
        accepted=("backlash_x",),
        steps=(first, aside, step("backlash_x", 1e-6, aside)),
        diagnosis=SimpleNamespace(noise=SimpleNamespace(declared=3e-7)),
        last=SimpleNamespace(verdict=verdict, accepted=(), fits=(fit,)),
    )
    told = improvement_words(done)
    assert "from 3.00 µm to 1.00 µm" in told
    assert [key for key in keys(told) if key.startswith("improved.")] == [
        "improved.aside",
        "improved.added",
        "improved.residual",
        *said,
    ]


def test_the_verdict_after_is_that_of_a_look_at_the_last_model_and_none_without_one() -> None:
    effects = (FlawSpec(id="backlash_y", size=2e-6),)
    done = improve(simulate(SimulationSpec(plan=PRESETS["tracking_2d"], seed=77, effects=effects)).session)
    assert done.accepted and not done.further
    told = improvement_document(done)
    assert (told["verdict"], told["verdict_after"]) == ("missing_effect", None)
    looked = replace(done, further=(replace(done.diagnosis, accepted=(), verdict="adequate"),))
    assert improvement_document(looked)["verdict_after"] == "adequate"
