# SPDX-License-Identifier: Apache-2.0
"""One vector of all that is published: what is where in it, and that it is what the documents hold.
After which setup a measurement would have been enough.
"""

from functools import cache
from pathlib import Path

import numpy as np
import pytest

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.budget import complete
from machine_tool_calibration.budget.complete import completed
from machine_tool_calibration.budget.conformity import conformity
from machine_tool_calibration.budget.contributor import Contributor
from machine_tool_calibration.budget.enough import Until, after_each_setup, parts, reached
from machine_tool_calibration.budget.propagate import propagate
from machine_tool_calibration.budget.published import (
    Numbers,
    everything,
    figure_of,
    iso_numbers,
    numbers,
    of_document,
    unit_of,
)
from machine_tool_calibration.errors import ModelError
from machine_tool_calibration.methods.fitted import FitRequest, FittedSessions, fit_sessions
from machine_tool_calibration.methods.identify import identify
from machine_tool_calibration.progress import untold
from machine_tool_calibration.session.folder import read_session
from machine_tool_calibration.session.session import Session
from machine_tool_calibration.simulation import PRESETS, DirectPlan, FlawSpec, RotaryPlan, SimulationSpec, simulate


@cache
def fitted(plan: str) -> FittedSessions:
    plans = {"iso230_2": DirectPlan(repeats=3, count=4), "rotary": RotaryPlan()}
    return fit_sessions(simulate(SimulationSpec(plan=plans[plan], seed=1)).session)


def of(published: Numbers, name: str) -> tuple[Array, Array]:
    members = published.quantity(name).members
    return published.value[members], published.u[members]


def test_an_axis_with_its_figures() -> None:
    own = fitted("iso230_2")
    published = everything(own)
    content = identify(own.joint.assembly.models[0].observations.session).error_map.content
    assert [q.name for q in published.quantities[:3]] == ["position_error", "EXX", "EXX(0)"]
    np.testing.assert_array_equal(of(published, "EXX"), [content["tables"]["EXX"][k] for k in ("value", "value_u")])
    for k, x in enumerate(("0", "0.133333", "0.266667", "0.4")):
        np.testing.assert_array_equal(of(published, f"EXX({x})"), np.array(of(published, "EXX"))[:, k : k + 1])
    (run,) = content["iso230_2"]
    for figure in ("B", "B_mean", "R", "E", "M", "A"):
        assert of(published, f"{figure}_X") == (run[figure], run[f"{figure}_U"] / 2)
        assert figure_of(f"{figure}_X") == figure_of(f"{figure}_X.second") == figure
    assert published.quantity("B_X").figure == "B" and published.quantity("EXX").figure is None
    assert figure_of("EXX") is None and figure_of("B_C") is None
    exx, place = published.quantity("EXX"), published.quantity("position_error")
    assert [exx.where(k) for k in (0, 3)] == ["at 0 mm", "at 400 mm"]
    np.testing.assert_allclose(exx.at, np.linspace(0.0, 0.4, 4))
    assert [place.where(k) for k in (0, 4, 11)] == [
        "along x at (0, 0, 0) mm",
        "along y at (133.333, 0, 0) mm",
        "along z at (400, 0, 0) mm",
    ]
    assert published.quantity("B_X").where(0) == published.quantity("EXX(0)").where(0) == ""
    # What no reading senses has no uncertainty either.
    assert np.isnan(np.array(of(published, "position_error")).reshape(2, 4, 3)[:, :, 1:]).all()
    with pytest.raises(ModelError, match=r"'nothing' is not published .*; there are position_error, EXX …"):
        published.quantity("nothing")


def test_figures_follow_what_is_added_to_the_readings() -> None:
    own = fitted("iso230_2")
    x = own.joint.assembly.models[0].observations.readings.columns["x"]
    before, after = iso_numbers(own, [0.0 * x]), iso_numbers(own, [1e-3 * x])
    # In both directions: the range of the means changes, the reversal does not.
    assert of(after, "B_X")[0] == pytest.approx(of(before, "B_X")[0])
    means = of(everything(own), "EXX")[0]
    grown = np.ptp(means + 1e-3 * np.linspace(0.0, 0.4, 4)) - np.ptp(means)
    assert of(after, "M_X")[0] - of(before, "M_X")[0] == pytest.approx(grown, abs=1e-12)
    assert np.isnan(after.u).all()
    session = own.joint.assembly.models[0].observations.session
    several = fit_sessions(FitRequest((session, session), ("a", "b")))
    assert not any(figure_of(q.name) for q in everything(several).quantities)


def test_setups_that_read_the_same_axis_have_figures_of_their_own() -> None:
    plan = DirectPlan(repeats=3, count=4, mountings=2)
    own = fit_sessions(simulate(SimulationSpec(plan=plan, seed=1)).session)
    names = [q.name for q in everything(own).quantities if figure_of(q.name) == "A"]
    assert names == ["A_X.X1", "A_X.X2"]
    # A tolerance of the axis is one of each of them.
    verdicts = conformity(own, {"A_X": 1.0}).each
    assert [one.name for one in verdicts] == names and not any(np.isnan(one.value) for one in verdicts)


@pytest.mark.parametrize("axis", ["A", "C"])
def test_error_motions_of_a_rotary_axis_have_their_angles(axis: str) -> None:
    plan = RotaryPlan.model_validate({"axis": axis})
    known = everything(fit_sessions(simulate(SimulationSpec(plan=plan, seed=1)).session)).by_name
    for name in (f"E{component}{axis}" for component in "XYZABC"):
        np.testing.assert_allclose(known[name].at, np.radians(np.arange(0.0, 360.0, 20.0)), atol=1e-9)
        assert known[name].where(1).endswith("20°")


def test_a_table_with_its_targets_stations_and_axis() -> None:
    own = fitted("rotary")
    published, content = everything(own), own.error_map.content
    ecc, targets = published.quantity("ECC"), published.quantity("targets")
    assert [ecc.where(k) for k in (0, 1, 17)] == ["at 0°", "at 20°", "at 340°"]
    np.testing.assert_allclose(ecc.at, np.radians(np.arange(0, 360, 20)))
    assert [targets.where(k) for k in (0, 5)] == ["entry 0, component 0", "entry 1, component 2"]
    assert targets.at is None and targets.unit == "m"
    for name in ("EXC", "ECC", "targets", "stations"):
        expected = [np.ravel(content[key]) for key in (name, f"{name}_u")]
        np.testing.assert_array_equal(of(published, name), expected)
    assert [unit_of(name) for name in ("ECC", "A0C", "C0Y", "x_angular")] == ["rad"] * 4
    assert [unit_of(name) for name in ("EXC", "X0C", "targets")] == ["m"] * 3
    # Stations are unknowns, too, counted from where they are stated.
    a = np.ravel(of(published, "stations")[0])[:3]
    assert a == pytest.approx([of(published, f"A.{axis}")[0][0] for axis in "xyz"], abs=1e-12)
    assert [q.first for q in published.quantities[1:]] == [q.members.stop for q in published.quantities[:-1]]
    np.testing.assert_array_equal(numbers(own, own.joint).value, published.value)


@pytest.mark.long
def test_a_complete_result_has_uncertainties_and_covariances_that_belong_together() -> None:
    """What instrument and temperature add is in both."""
    session = fitted("rotary").joint.assembly.models[0].observations.session
    found = identify(session)
    line = Contributor(name="l", type="B", standard_uncertainty=3e-6, enters="reading", varies="place")
    budget = propagate(fitted("rotary"), [line])
    whole = completed(found, budget).error_map
    assert whole.covariance is not None
    np.testing.assert_allclose(np.sqrt(np.einsum("nii->ni", whole.covariance)), whole.uncertainty, rtol=1e-9)
    more = np.sqrt(whole.uncertainty**2 - found.error_map.uncertainty**2)
    assert more.min() > 0.0
    expanded = budget.expanded[budget.numbers.quantity("position_error").members].reshape(-1, 3)
    np.testing.assert_allclose(whole.uncertainty, np.maximum(expanded / 2.0, found.error_map.uncertainty), rtol=1e-6)
    # And of the error motion values: half of each U is the budget's, where that is the larger.
    before, after = (one.content["iso230_7"] for one in (found.error_map, whole))
    assert len(before) == len(after) >= 4
    for own, one in zip(before, after, strict=True):
        (wide,) = budget.expanded[budget.numbers.quantity(f"{own['motion']}_range").members]
        assert one["U"] == pytest.approx(max(wide, own["U"]), rel=1e-6)
    assert any(one["U"] > 1.01 * own["U"] for own, one in zip(before, after, strict=True))


@pytest.mark.parametrize("plan", ["iso230_2", "rotary"])
def test_a_document_says_the_same_of_the_map_and_the_unknowns(plan: str) -> None:
    own = fitted(plan)
    published = numbers(own, own.joint)
    told = of_document(identify(own.joint.assembly.models[0].observations.session).document())
    assert {"iso230_2": {"position_error", "EXX"}, "rotary": {"ECC", "EXC", "A.x"}}[plan] <= {
        q.name for q in told.quantities
    }
    for one in told.quantities:
        same = published.quantity(one.name)
        np.testing.assert_allclose(of(told, one.name), of(published, one.name), rtol=1e-12)
        if one.name != "position_error":  # of which the document does not say where
            assert [one.where(k) for k in range(one.count)] == [same.where(k) for k in range(one.count)]
            assert (one.at is None) == (same.at is None)
            np.testing.assert_allclose(one.at if one.at is not None else [], same.at if same.at is not None else [])


@pytest.fixture
def session() -> Session:
    return read_session(Path(__file__).parents[1] / "data" / "tracking_2d")


def test_u_falls_from_setup_to_setup_to_that_of_the_whole(session: Session) -> None:
    chosen = FitRequest((session,))
    found = list(after_each_setup(chosen, Until(u=1e-9)))
    assert [one.setup for one in found] == list(session.setup_ids)
    u = np.array([one.u for one in found])
    assert np.isinf(u[0])
    assert np.all(np.diff(u[np.isfinite(u)]) < 0.0)
    whole = complete.identify(chosen).error_map.uncertainty
    assert u[-1] == pytest.approx(2.0 * np.nanmax(whole))
    assert not any(one.enough for one in found)
    assert [one.enough for one in after_each_setup(chosen, Until(u=1.01 * u[-1]))] == [False] * (len(u) - 1) + [True]


def test_no_effect_is_told_by_what_cannot_be_identified(session: Session) -> None:
    """By one station."""
    found = reached(FitRequest((next(parts(session)),)), Until(told=("backlash_y",)))
    assert not found.enough and not found.probabilities


@pytest.mark.long
@pytest.mark.parametrize("size", [0.0, 4e-6])
def test_an_effect_is_told_whether_it_is_there_or_not(size: float) -> None:
    hidden = (FlawSpec(id="backlash_x", size=size),) if size else ()
    measured = simulate(SimulationSpec(seed=4, plan=PRESETS["iso230_2"], effects=hidden)).session
    (only,) = after_each_setup(FitRequest((measured,)), Until.parse("told=backlash_x"))
    assert only.enough
    assert (only.probabilities["backlash_x"] > 0.5) == bool(size)


def test_what_comes_slowly_is_called_absent_by_a_whole_measurement_only(monkeypatch: pytest.MonkeyPatch) -> None:
    measured = FitRequest((simulate(SimulationSpec(seed=4, plan=DirectPlan(repeats=2, count=6))).session,))
    nothing = complete.diagnose(measured, progress=untold)
    monkeypatch.setattr(complete, "diagnose", lambda *_, **__: nothing)
    drift, backlash = Until(told=("linear_drift",)), Until(told=("backlash_x",))
    assert reached(measured, drift).enough and reached(measured, backlash).enough
    assert not reached(measured, drift, whole=False).enough
    assert reached(measured, backlash, whole=False).enough


def test_parts_hold_whole_setups_in_the_order_of_the_readings(session: Session) -> None:
    sizes = [len(part.readings) for part in parts(session)]
    assert sizes == np.cumsum(np.bincount(session.readings.setup)).tolist()


@pytest.mark.parametrize(
    ("model", "until", "why"),
    [
        (None, "told=backlash_y,probe_pretravel", "^effect probe_pretravel: does not occur with tracking interfero"),
        ("fre", "U=2um", "has no model 'fre'"),
        ("fre", "told=backlash_y", "has no model 'fre'"),
    ],
)
def test_what_cannot_be_in_the_model_is_no_matter_of_too_few_readings(
    session: Session, model: str | None, until: str, why: str
) -> None:
    with pytest.raises(ModelError, match=why):
        next(after_each_setup(FitRequest((session,), model=model), Until.parse(until)))
