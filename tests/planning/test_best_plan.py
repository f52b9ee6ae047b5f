# SPDX-License-Identifier: Apache-2.0
"""The best plan: judged as a fit judges it, never worse than what is there, and never below its bound."""

from dataclasses import replace
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from machine_tool_calibration.budget.patterns import shared_errors
from machine_tool_calibration.budget.propagate import propagate
from machine_tool_calibration.errors import ModelError, SessionError
from machine_tool_calibration.methods.build import build_model, error_map
from machine_tool_calibration.methods.identify import fitted_sessions, identify
from machine_tool_calibration.model.fit import declared, fit_models
from machine_tool_calibration.model.observations import Observations
from machine_tool_calibration.nodes.shared import procedure_file
from machine_tool_calibration.planning.best_plan import BestPlan, all_candidates, best_plan, quickest_plan
from machine_tool_calibration.planning.design import Candidates, SharedErrors
from machine_tool_calibration.planning.dominant import expecting
from machine_tool_calibration.planning.forecast import Assumed, planned_session
from machine_tool_calibration.planning.offer import Choice, Offer, offer
from machine_tool_calibration.planning.optimise import _Relaxed, _relaxed, bound, quickest, search
from machine_tool_calibration.procedure import parse_procedure, plan
from machine_tool_calibration.procedure.description import expanded

PLANE = """
format: mtcal-procedure/1
name: plane
session:
  method: tracking_interferometer
  dimension: 2
  pointing: open_loop
  machine: {chain: w-C-b-Y-X-Z-t, travel: {x: [0.0, 0.4], y: [0.0, 0.4], z: [0.0, 0.05]}}
  repeats: 1
  setups:
  - {id: A, position: [-0.35, 0.05, 0.0], position_uncertainty: 2.0e-5}
  - {id: B, position: [-0.40, 0.15, 0.0], position_uncertainty: 2.0e-5}
  - {id: C, position: [-0.30, 0.25, 0.0], position_uncertainty: 2.0e-5}
  standard_uncertainty: {displacement: 3.0e-7}
path:
  grid: {x: {first: 0.0, last: 0.4, count: 3}, y: {first: 0.0, last: 0.4, count: 3}, z: [0.0]}
choices:
  mounting: 100.0
  repeats: [1, 2]
  most_setups: 4
  setups:
  - {position: [{any: [-0.4, 0.8]}, {first: -0.2, last: 0.6, count: 3}, 0.0], position_uncertainty: 2.0e-5}
"""


def _changed(**changes: Any) -> str:
    content = yaml.safe_load(PLANE)
    content["session"] |= changes.pop("session", {})
    content["choices"] |= changes
    return yaml.safe_dump(content)


def _candidates(offered: Offer) -> Candidates:
    return all_candidates(offered, Assumed(), ())[0]


@pytest.fixture(scope="module")
def found() -> BestPlan:
    return best_plan(PLANE, "plane.yaml", Assumed())


def test_templates_stand_for_every_combination() -> None:
    entries = list(expanded({"id": "S", "position": [{"any": [1, 2]}, {"first": 0.0, "last": 1.0, "count": 3}, 0.5]}))
    assert len(entries) == 6
    assert {tuple(entry["position"]) for entry in entries} == {(a, b, 0.5) for a in (1, 2) for b in (0.0, 0.5, 1.0)}
    assert {entry["id"] for entry in entries} == {"S"}


_METHODS = ["tracking_2d", "tracking_3d", "rotary_axis_one_way", "probing_cross", "step_diagonal"]


@pytest.mark.long
@pytest.mark.parametrize("name", _METHODS)
def test_a_part_of_the_candidates_is_judged_as_its_own_fit(name: str) -> None:
    content = yaml.safe_load(procedure_file(name).read_text())
    content.pop("choices", None)
    content["session"]["repeats"] = 1
    offered = offer(yaml.safe_dump(content), name)
    repeats = 2 if name == "tracking_3d" else 1  # three stations for three unknowns of each point
    chosen = Choice(tuple(range(len(offered.setups) - 1)), offered.present.targets, repeats)
    candidates = _candidates(offered)
    u = np.sqrt(candidates.variances(offered.weights(chosen)))

    alone = fit_models([expecting(build_model(planned_session(offered.procedure_of(chosen)))[0])])
    published = error_map(declared(alone).fits[0])
    own = published.uncertainty.reshape(-1)
    whole = error_map(declared(fit_models([expecting(build_model(planned_session(offered.procedure))[0])])).fits[0])
    told = np.isfinite(whole.uncertainty.reshape(-1)) & (whole.uncertainty.reshape(-1) > 0)
    wanted = np.where(np.isfinite(own), own, np.inf)[told]
    # the two are linearised where their own readings, which scatter, put stations and points
    np.testing.assert_allclose(u, wanted, rtol=5e-3)


def test_slopes_are_those_of_the_variances() -> None:
    offered = offer(PLANE, "plane")
    candidates = _candidates(offered)
    weights = np.linspace(0.5, 1.5, candidates.count)
    variances, slopes = candidates.slopes(weights)
    np.testing.assert_allclose(variances, candidates.variances(weights))
    for unit in (0, candidates.count - 1):
        step = 1e-4 * np.eye(candidates.count)[unit]
        change = candidates.variances(weights + step) - candidates.variances(weights - step)
        np.testing.assert_allclose(change / 2e-4, slopes[:, unit], rtol=1e-4)


def test_stations_on_one_side_are_spread_and_the_plan_is_a_procedure(found: BestPlan) -> None:
    assert found.best.largest < 0.5 * found.present.largest
    assert found.best.seconds <= 1.01 * found.present.seconds
    made = parse_procedure(found.text, "best")
    assert plan(made).duration + 100.0 * len(found.best.setups) == pytest.approx(found.best.seconds)
    # one number for one quantity: as `mtcal plan` foretells it for the file that was written
    own = error_map(identify(planned_session(made)).joint.fits[0]).uncertainty
    assert float(own[np.isfinite(own)].max()) == pytest.approx(found.best.largest, rel=1e-6)


@pytest.mark.long
def test_the_bound_holds_for_every_plan_of_a_small_offer() -> None:
    offered = offer(PLANE, "plane")
    candidates = _candidates(offered)
    best = search(offered, candidates)
    lowest = bound(offered, candidates, best)
    exact = min(
        float(np.sqrt(candidates.variances(offered.weights(choice)).max()))
        for repeats in (1, 2)
        for mask in range(1, 2 ** len(offered.setups))
        for choice in [Choice(tuple(k for k in range(len(offered.setups)) if mask >> k & 1), (0,), repeats)]
        if len(choice.setups) <= 4 and offered.rough_duration(choice) <= offered.seconds
    )
    assert 0.3 * exact < lowest <= exact * (1 + 1e-9)
    assert np.sqrt(best.variances.max()) == pytest.approx(exact, rel=1e-9)


@pytest.mark.long
def test_the_bound_is_raised_until_it_is_close_or_above_the_plan() -> None:
    """From round to round; one that is above the plan's variance says no more than that at once."""
    offered = offer(PLANE, "plane")
    candidates = _candidates(offered)
    largest = float(search(offered, candidates).variances.max())
    found, rounds = {}, {}
    for share in (1.0, 1e-3):
        told: list[float] = []
        found[share] = _relaxed(_Relaxed(offered, 2), candidates, share * largest, told.append)
        rounds[share] = len(told)
    assert rounds[1e-3] == 1 < rounds[1.0] < 60
    assert 1e-3 < 1e-3 * found[1e-3] < found[1.0] < 1.0


@pytest.mark.parametrize("name", ["plane", "rotary_axis_one_way"])
def test_every_plan_that_is_allowed_keeps_the_rules_of_the_bound_and_one_with_too_many_setups_does_not(
    name: str,
) -> None:
    """A setup is there as soon as one of its targets is measured, and is mounted then."""
    offered = offer(PLANE if name == "plane" else procedure_file(name).read_text(), name)
    rules, targets = _Relaxed(offered, 1), len(offered.targets)

    def kept(setups: list[int], there: list[int]) -> bool:
        measured = np.isin(np.arange(len(offered.setups)), setups).repeat(targets)
        mounted = np.isin(np.arange(len(offered.setups)), there)
        told = rules.rows @ np.concatenate([measured, mounted, [0.0]])
        return bool(((rules.left - 1e-9 <= told) & (told <= rules.right + 1e-9)).all())

    assert kept(list(range(2)), list(range(2)))
    assert not kept(list(range(2)), [0])
    every = list(range(len(offered.setups)))
    assert not kept(every, every)


@pytest.mark.long
@pytest.mark.parametrize(("seconds", "goal"), [(700.0, 1.2e-6), (400.0, 2.5e-6)])
def test_the_quickest_plan_comes_to_what_is_wanted_as_soon_as_any(seconds: float, goal: float) -> None:
    """By trying all; what follows it is allowed as well."""
    offered = offer(_changed(seconds=seconds), "plane")
    candidates = _candidates(offered)

    def largest(choice: Choice) -> float:
        return float(np.sqrt(candidates.variances(offered.weights(choice)).max()))

    found = quickest(offered, candidates, goal, lambda what, share: None)
    assert offered.rough_duration(found) <= 1.001 * seconds
    begun = (replace(found, setups=tuple(sorted(found.setups[: n + 1]))) for n in range(len(found.setups)))
    enough = next(choice for choice in begun if largest(choice) <= goal)
    every = [
        Choice(setups, (0,), repeats)
        for repeats in (1, 2)
        for count in range(1, 5)
        for setups in combinations(range(len(offered.setups)), count)
    ]
    soonest = min(offered.rough_duration(choice) for choice in every if largest(choice) <= goal)
    assert offered.rough_duration(enough) == pytest.approx(soonest, rel=0.01)  # it sets out from a few starts
    as_long = [choice for choice in every if offered.rough_duration(choice) <= 1.001 * offered.rough_duration(enough)]
    assert largest(enough) == pytest.approx(min(map(largest, as_long)))


@pytest.mark.long
@pytest.mark.parametrize(("repeats", "kept"), [(1, True), (2, False)])
def test_the_procedure_as_it_stands_is_kept_unless_another_is_much_quicker(repeats: int, kept: bool) -> None:
    """Three stations are needed, so that only repeats are saved, of which others need one where these need two."""
    offered = offer(_changed(mounting=0.0, session={"repeats": repeats}), "plane")
    candidates = _candidates(offered)
    u = float(np.sqrt(candidates.variances(offered.weights(offered.present)).max()))
    found = quickest(offered, candidates, 0.9 * u, lambda what, share: None, kept_up_to=1.1 * u)
    assert (found.setups[:3] == (0, 1, 2)) == kept
    assert quickest(offered, candidates, 0.9 * u, lambda what, share: None).setups[:3] != (0, 1, 2)


@pytest.mark.long
def test_a_plan_has_readings_that_check_each_other() -> None:
    content = yaml.safe_load(procedure_file("tracking_3d").read_text())
    for axis in "xyz":
        content["path"]["grid"][axis]["count"] = 3
    offered = offer(yaml.safe_dump(content), "tracking_3d")
    candidates = _candidates(offered)
    three, four = (candidates.judged(offered.weights(Choice(tuple(range(n)), (0,), 3)))[1] for n in (3, 4))
    assert three < 0.1 < four


def test_of_targets_read_one_after_another_each_takes_its_own_time() -> None:
    file = Path(__file__).parents[2] / "config" / "procedures" / "rotary_axis.yaml"
    offered = offer(file.read_text(), "rotary_axis")
    for targets in ((0,), (1, 5)):
        choice = Choice((0, 1, 2, 3), targets, 1)
        assert offered.rough_duration(choice) == pytest.approx(offered.duration(choice), rel=0.02)


@pytest.mark.long
def test_the_file_of_the_quickest_plan_has_its_setups_in_their_order() -> None:
    """With a margin for what does not reproduce between setups, which no plan can know of."""
    text = _changed(seconds=700.0)
    offered = offer(text, "plane")
    wanted = quickest(offered, _candidates(offered), 0.85 * 1.4e-6, lambda what, share: None)
    assert quickest_plan(text, "plane", Assumed(), u=1.4e-6, told=()) == offered.text(wanted)


def test_a_procedure_is_kept_where_it_misses_what_is_wanted_by_less_than_the_margin(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    asked: list[tuple[float, float]] = []

    def found(offered: Offer, _: Candidates, goal: float, *__: object, kept_up_to: float) -> Choice:
        asked.append((goal, kept_up_to))
        return offered.present

    monkeypatch.setattr("machine_tool_calibration.planning.best_plan.quickest", found)
    quickest_plan(PLANE, "plane", Assumed(), u=1e-6, told=())
    assert asked == [pytest.approx((0.85e-6, 1e-6 / 0.85))]


@pytest.mark.long
def test_what_a_plan_is_made_of_and_how_far_the_work_is() -> None:
    shares: list[float] = []
    found = best_plan(PLANE, "plane.yaml", Assumed(), progress=lambda what, share: shares.append(share))
    assert shares[0] == 0.0 and shares[-1] <= 1.0
    assert shares == sorted(shares)
    assert any(share > 0.7 for share in shares) and any(0.0 < share < 0.7 for share in shares)
    assert found.best.stations.shape == (len(found.best.setups), 3)
    np.testing.assert_allclose(found.present.stations[0], [-0.35, 0.05, 0.0])
    assert found.present.typical == pytest.approx(np.linalg.norm(found.present.u) / np.sqrt(len(found.present.u)))
    document = found.document()
    assert document["for"] == "position_error" and document["bound"] == found.bound > 0.0
    assert document["candidates"] == {"setups": 9, "targets": 0}


@pytest.mark.long
def test_same_seed_same_plan(found: BestPlan) -> None:
    assert best_plan(PLANE, "plane.yaml", Assumed()).document() == found.document()


def test_a_stopped_search_has_the_best_so_far() -> None:
    def stop(what: str, share: float) -> None:
        if what.startswith("plans tried") and share > 0.001:
            raise KeyboardInterrupt

    stopped = best_plan(PLANE, "plane.yaml", Assumed(), progress=stop)
    assert stopped.stopped
    assert stopped.bound == 0.0
    assert stopped.best.largest <= stopped.present.largest


def test_an_effect_is_told_better_than_now() -> None:
    found = best_plan(PLANE, "plane.yaml", Assumed(), told=["linear_drift"])
    assert found.effects == ("linear_drift",)
    assert found.best.largest < 0.9 * found.present.largest
    assert found.document()["unit"] == "1"


@pytest.mark.long
def test_what_a_budget_says_is_in_it() -> None:
    line = {"name": "wavelength", "type": "B", "standard_uncertainty": 2e-6, "enters": "length", "varies": "setup"}
    zero = {"name": "zero", "type": "B", "standard_uncertainty": 1e-7, "enters": "reading", "varies": "place"}
    text = _changed(session={"budget": [line, zero]})
    found = best_plan(text, "plane.yaml", Assumed(errors=shared_errors))
    assert found.complete
    result = identify(planned_session(parse_procedure(text, "plane")))
    budget = propagate(fitted_sessions(result), planned_session(parse_procedure(text, "plane")).description.budget)
    own = budget.u[budget.numbers.by_name["position_error"].members]
    known = np.sqrt(np.square(own[np.isfinite(own) & (own > 0)]))
    plain = best_plan(PLANE, "plane.yaml", Assumed()).present
    assert found.present.largest > plain.largest
    assert found.present.largest == pytest.approx(max(known.max(), plain.largest), rel=0.02)


@pytest.mark.parametrize("shared", [0, 1])
def test_readings_that_scatter_more_than_declared_make_a_plan_worse(shared: int) -> None:
    """Three times as much, whether or not they share errors too, which are too small here to tell."""

    def scattering(observed: Observations) -> SharedErrors:
        return SharedErrors(3.0, np.full((shared, len(observed)), 1e-12))

    offered = offer(PLANE, "plane")
    found = all_candidates(offered, Assumed(errors=scattering), ())[0]
    weights, plain = offered.weights(offered.present), _candidates(offered)
    np.testing.assert_allclose(found.variances(weights), 9.0 * plain.variances(weights), rtol=1e-6)
    np.testing.assert_allclose(found.by_scatter(weights), plain.variances(weights))


@pytest.mark.parametrize(
    ("changes", "why"),
    [
        ({"seconds": 50.0}, "one setup takes"),
        ({"features": ["work"]}, "choices.features are for a workpiece"),
        ({"targets": [{"position": [0, 0, 0]}]}, "choices.targets are for a session with targets"),
        ({"setups": [{"id": "A", "position": [1.0, 1.0, 0.0]}]}, "the id 'A' is taken"),
        (
            {"setups": [{"position": [{"first": 0.0, "last": 1.0, "count": 5000}, 1.0, 0.0]}]},
            "more than 1000 candidates",
        ),
    ],
)
def test_what_cannot_be_is_said_in_one_line(changes: dict[str, Any], why: str) -> None:
    with pytest.raises((ModelError, SessionError), match=why):
        best_plan(_changed(**changes), "plane.yaml", Assumed())


@pytest.mark.parametrize(("count", "why"), [
    ("abc", "a whole number, not 'abc'"), ("-1", "at least 1, not -1"), ("0", "at least 1, not 0"),
    ("2.5", "a whole number, not 2.5"), (".nan", "a finite number, not nan"), ("1e30", "a whole number, not 1e"),
])  # fmt: skip
def test_equally_spaced_candidates_without_a_number_are_refused_where_they_stand(count: str, why: str) -> None:
    text = PLANE.replace("last: 0.6, count: 3", f"last: 0.6, count: {count}")
    with pytest.raises(SessionError, match=rf"^plane.yaml line 22: count must be {why}"):
        parse_procedure(text, "plane.yaml")


@pytest.mark.long
def test_the_bound_of_an_effect_is_that_of_plans_that_tell_it() -> None:
    # A single repeat goes one way and tells no backlash: that says nothing of plans with two.
    offered = offer(PLANE, "plane", both_senses=True)
    told, _, _ = all_candidates(offered, Assumed(), ["backlash_x"])
    best = search(offered, told)
    assert best.choice.repeats == 2
    largest = float(np.sqrt(best.variances.max()))
    assert 0.9 * largest < bound(offered, told, best) <= largest * (1.0 + 1e-9)


def test_places_seen_along_one_line_take_up_what_their_readings_could_tell() -> None:
    """One station going one way has a reading for each place, which is an unknown: it tells nothing of a backlash."""
    chosen = yaml.safe_load(quickest_plan(PLANE, "plane.yaml", Assumed(), u=None, told=["backlash_x"]))["session"]
    assert chosen["repeats"] == 2
    offered = offer(PLANE, "plane", both_senses=True)
    told, _, _ = all_candidates(offered, Assumed(), ["backlash_x"])
    once, twice = (told.variances(offered.weights(Choice((0,), (0,), repeats))) for repeats in (1, 2))
    assert np.isinf(once).all() and np.isfinite(twice).all()


def test_where_no_effect_is_to_be_told_repeats_are_alike_whichever_way_they_go() -> None:
    procedure = offer(PLANE, "plane").procedure
    assert procedure.path.alternate and procedure.session.repeats == 1
    assert offer(PLANE, "plane", both_senses=True).procedure.session.repeats == 2
    # Nor where none goes back, or there is a single one.
    one_way = yaml.safe_load(PLANE)
    one_way["path"]["alternate"] = False
    for text in (yaml.safe_dump(one_way), _changed(repeats=[1])):
        assert offer(text, "plane", both_senses=True).procedure.session.repeats == 1


def test_an_effect_that_no_plan_tells_is_said() -> None:
    with pytest.raises(ModelError, match="no plan of these candidates tells scale:"):
        best_plan(PLANE, "plane.yaml", Assumed(), told=["scale"])
    with pytest.raises(ModelError, match="backlash_x"):
        best_plan(PLANE, "plane.yaml", Assumed(), told=["backlsh_x"])


def test_files_of_the_package_offer_something() -> None:
    for name in ("tracking_2d", "tracking_3d", "step_diagonal", "rotary_axis", "probing_cross", "probing_pins"):
        file = procedure_file(name)
        assert Path(file).is_file()
        assert len(offer(file.read_text(), name).setups) > 10


@pytest.mark.long
def test_a_plan_that_cannot_be_identified_is_not_chosen(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nor one that determines less of the map than the procedure as it stands, however small its U."""
    offered = offer(PLANE, "plane")
    seen: list[Choice] = []

    def possible(choice: Choice) -> bool:
        seen.append(choice)
        return choice != seen[0]

    others = search(offered, _candidates(offered), possible=possible).finalists
    assert others and seen[0] not in others

    def never(self: object, choice: Choice) -> tuple[float, float]:
        return (1.0, 1.0) if choice == offered.present else (0.5, 1.0)

    monkeypatch.setattr("machine_tool_calibration.planning.best_plan._Forecasts._forecast", never)
    found = best_plan(PLANE, "plane.yaml", Assumed())
    assert found.best is found.present
