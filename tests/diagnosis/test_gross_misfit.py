# SPDX-License-Identifier: Apache-2.0
"""Readings that scatter far more than declared: what does not reproduce, a wrong declaration, or a wrong model."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from machine_tool_calibration.diagnosis.consequence import consequences
from machine_tool_calibration.diagnosis.diagnose import Diagnosis, diagnose
from machine_tool_calibration.methods.identify import identify
from machine_tool_calibration.planning.what_to_measure import what_to_measure
from machine_tool_calibration.reports.diagnosis_document import diagnosis_document
from machine_tool_calibration.reports.quantities import quantity
from machine_tool_calibration.reports.verdict import verdict_words
from machine_tool_calibration.session.session import Session
from machine_tool_calibration.simulation import PRESETS, FlawSpec, SimulationSpec, simulate


def with_added(session: Session, change: np.ndarray) -> Session:
    readings = session.readings
    return session.with_readings(replace(readings, displacement=readings.displacement + change))


def bent_by_the_path(seed: int) -> Session:
    """A bow over the path, of another size in each setup: as setups that reproduce badly leave it."""
    session = simulate(SimulationSpec(plan=PRESETS["tracking_2d"], seed=seed)).session
    rng = np.random.default_rng(seed)
    time = session.readings.columns["time"]
    change = np.zeros(len(time))
    for setup in np.unique(session.readings.setup):
        mine = session.readings.setup == setup
        u = 2.0 * (time[mine] - time[mine].min()) / np.ptp(time[mine]) - 1.0
        change[mine] = session.sigma * (5.0 * rng.normal() * u + 5.0 * rng.normal() * (u**2 - 1 / 3))
    return with_added(session, change)


def each_place_apart(seed: int) -> Session:
    """Every setup sees every place off by an amount of its own, the same in every repeat: no smooth function does."""
    plan = PRESETS["tracking_2d"].model_copy(update={"order": "same"})
    session = simulate(SimulationSpec(plan=plan, seed=seed)).session
    readings = session.readings
    where = np.column_stack([readings.position().round(9), readings.setup])
    place = np.unique(where, axis=0, return_inverse=True)[1].reshape(-1)
    off = 4.0 * session.sigma * np.random.default_rng(seed).normal(size=place.max() + 1)
    return with_added(session, off[place])


@pytest.fixture(scope="module")
def bent() -> Diagnosis:
    return diagnose(bent_by_the_path(3))


@pytest.mark.long
def test_setups_that_differ_grossly_are_spread_and_no_effect(bent: Diagnosis) -> None:
    """A slope and a bow of five standard uncertainties in every setup: they do not reproduce, and the map says so."""
    assert bent.fits[0].reduced_chi_square > 2
    assert bent.accepted == ()
    assert bent.verdict == "adequate"
    undisturbed = simulate(SimulationSpec(plan=PRESETS["tracking_2d"], seed=3)).session
    assert max(size.probability for size in bent.fits[-1].marginal.sizes) > 0.99
    clean, moved = identify(undisturbed).error_map, identify(bent.chosen.sessions[0]).error_map
    shift = np.sqrt(np.nanmean((moved.error - clean.error) ** 2))
    uncertainty = [np.sqrt(np.nanmean(one.uncertainty**2)) for one in (clean, moved)]
    assert uncertainty[1] > 1.5 * uncertainty[0]
    assert 0.3 < shift / uncertainty[1] < 2.0


@pytest.mark.long
def test_the_words_say_by_how_much_setups_differ(bent: Diagnosis) -> None:
    changes, advice = consequences(bent), what_to_measure(bent)
    text = " ".join(verdict_words(bent, changes, advice))
    surest = max(bent.fits[-1].marginal.sizes, key=lambda size: size.probability)
    assert quantity(surest.size, "m") in text
    document = diagnosis_document(bent, advice, changes)
    told = {entry["family"]: entry for entry in document["spread"]}
    assert told[surest.name]["probability"] > 0.99
    assert not document["accepted"]


@pytest.mark.long
def test_places_that_differ_without_any_pattern_are_unexplained() -> None:
    found = diagnose(each_place_apart(3))
    assert found.fits[0].reduced_chi_square > 2
    assert found.contradicted and not found.noisy
    assert found.verdict == "unexplained"
    assert found.accepted == ()
    text = " ".join(verdict_words(found, consequences(found), what_to_measure(found)))
    assert found.noise.from_repeats is not None
    assert quantity(found.noise.from_repeats, "m") in text
    assert f"{np.sqrt(found.fits[-1].reduced_chi_square):.3g}" in text


@pytest.mark.parametrize(
    ("variance", "left", "noisy", "nothing", "contradicted"),
    [
        (9.0, 520.0, False, 0.1, True),  # of 800 beyond what noise leaves, 380 are explained
        (9.0, 480.0, False, 0.1, False),  # more than half
        (1.9, 190.0, False, 0.1, False),  # hardly more than declared
        (9.0, 900.0, True, 0.1, False),  # repeats scatter as much
        (9.0, 900.0, False, 0.9, False),  # nothing was repeated, and nothing has a pattern
    ],
)
def test_what_explains_half_of_the_excess_is_no_contradiction(
    variance: float, left: float, noisy: bool, nothing: float, contradicted: bool
) -> None:
    """A hundred degrees of freedom: sums of squares without and with what was found."""
    session = simulate(SimulationSpec(plan=PRESETS["tracking_2d"], seed=12)).session
    solutions = [SimpleNamespace(chi_square=size, degrees_of_freedom=100) for size in (100.0 * variance, left)]
    found = SimpleNamespace(
        fits=[SimpleNamespace(solution=one) for one in solutions],
        chosen=SimpleNamespace(sessions=[session]),
        search=SimpleNamespace(variance=variance, memory=1.0),
        nothing=nothing,
        noise=SimpleNamespace(from_repeats=None),
        noisy=noisy,
    )
    assert Diagnosis.contradicted.fget(found) is contradicted  # type: ignore[attr-defined]


@pytest.mark.long
def test_a_declared_uncertainty_that_is_too_small_is_no_misfit() -> None:
    """The repeats scatter as much: then it is the declaration."""
    session = simulate(SimulationSpec(plan=PRESETS["tracking_2d"], seed=12)).session
    noise = 2.0 * session.sigma * np.random.default_rng(0).normal(size=len(session.readings))
    found = diagnose(with_added(session, noise))
    assert found.fits[0].reduced_chi_square > 2
    assert found.verdict == "adequate"


@pytest.mark.long
def test_a_gross_error_that_was_lost_in_what_an_effect_leaves_is_set_aside_once_it_is_known() -> None:
    spec = SimulationSpec(plan=PRESETS["tracking_2d"], seed=0, effects=(FlawSpec(id="backlash_y", size=2e-6),))
    session = simulate(spec).session
    displacement = session.readings.displacement.copy()
    displacement[30] += 6e-5
    found = diagnose(session.with_readings(replace(session.readings, displacement=displacement)))
    assert found.accepted == ("backlash_y",)
    assert [outlier.row for outlier in found.gross_errors] == [30]


@pytest.mark.long
def test_an_effect_that_gross_errors_hid_while_it_hid_them_is_found_with_them() -> None:
    """Errors of all sizes from 15 to 100 standard uncertainties leave no gap after what a reversal leaves."""
    spec = SimulationSpec(plan=PRESETS["tracking_2d"], seed=2, effects=(FlawSpec(id="reversal_ECY", amplitude=3e-6),))
    session = simulate(spec).session
    rng = np.random.default_rng(2)
    hit = np.sort(1 + rng.permutation(len(session.readings) - 1)[:11])
    change = np.zeros(len(session.readings))
    change[hit] = session.sigma * np.linspace(15.0, 100.0, len(hit)) * rng.choice([-1.0, 1.0], len(hit))
    found = diagnose(with_added(session, change))
    assert found.verdict == "missing_effect"
    assert found.accepted == ("reversal_ECY",)
    assert sorted(outlier.row for outlier in found.gross_errors) == hit.tolist()


@pytest.mark.parametrize(("variance", "contradicted"), [(16.0, True), (7.0, False)])
def test_what_is_read_directly_contradicts_beside_what_repeats_scatter(variance: float, contradicted: bool) -> None:
    """By twice what was declared: then a variance of sixteen is one of four, and one of seven less than two."""
    session = simulate(SimulationSpec(plan=PRESETS["iso230_2"], seed=12)).session
    solutions = [SimpleNamespace(chi_square=100.0 * size, degrees_of_freedom=100) for size in (variance, variance - 1)]
    found = SimpleNamespace(
        fits=[SimpleNamespace(solution=one) for one in solutions],
        chosen=SimpleNamespace(sessions=[session]),
        search=SimpleNamespace(variance=variance, memory=1.0, accepted=("backlash_x",)),
        nothing=0.1,
        noise=SimpleNamespace(from_repeats=6e-7, counted=3e-7, repeats=1000.0),
        noisy=False,
    )
    assert Diagnosis.contradicted.fget(found) is contradicted  # type: ignore[attr-defined]
