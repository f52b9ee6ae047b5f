# SPDX-License-Identifier: Apache-2.0
"""Uncertainties are right, and as small as the readings allow."""

from dataclasses import replace

import numpy as np
import pytest
from papers.formulations import identify_by_formulation

from machine_tool_calibration.methods.step_diagonal.build import build
from machine_tool_calibration.model.fit import fit_models


def _noisy(session, rng):
    """The session with noise of the declared size; the datum reading has some too, and all count from it."""
    readings = session.readings
    noise = session.sigma * rng.normal(size=len(readings))
    run = readings.setup * 1000 + readings.repeat
    first = {r: noise[np.argmax(run == r)] for r in np.unique(run)}
    displacement = readings.displacement + noise - np.array([first[r] for r in run])
    return session.with_readings(replace(readings, displacement=displacement))


def _refitted(model, rng):
    """Fit of a model to readings with noise."""
    observations = model.observations
    readings = _noisy(observations.session.with_readings(observations.readings), rng).readings
    return fit_models([replace(model, observations=replace(observations, readings=readings))]).fits[0]


def _turn_free(blocks):
    """Projector off common rotations of all profiles."""
    turns = [
        np.concatenate([np.outer(b - b[0], np.cross(w, np.eye(3)[a])).ravel() for a, b in enumerate(blocks)])
        for w in np.eye(3)
    ]
    columns = np.array(turns).T
    return np.eye(len(columns)) - columns @ np.linalg.pinv(columns)


@pytest.fixture(scope="module")
def fitted(exact, many):
    """A simulated session and fits to it with many draws of noise."""
    simulated = exact(11, repeats=2)
    model = build(simulated.session, "translations")
    rng = np.random.default_rng(1)
    return simulated, model, [_refitted(model, rng) for _ in range(many.part(2.0).count)]


def test_translations_reach_the_bound_with_right_uncertainties(reproducible, fitted, truth, many):
    simulated, model, fits = fitted
    free = _turn_free(model.blocks)
    true = truth(simulated, model.blocks)
    profiles = [model.profiles(fit) for fit in fits]
    error = np.array([free @ (each.value - true) for each in profiles])
    variance = np.diag(free @ profiles[0].covariance @ free.T)
    known = variance > 1e-20
    more = many.part(2.0)
    assert np.sqrt(np.mean(error**2)) < (1.0 + more.off(0.1)) * np.sqrt(np.mean(variance))
    assert np.mean(error[:, known] ** 2 / variance[known]) == pytest.approx(1.0, abs=more.off(0.1))
    chi = [fit.joint.reduced_chi_square for fit in fits]
    dof = fits[0].solution.degrees_of_freedom
    assert np.mean(chi) == pytest.approx(1.0, abs=4 * np.sqrt(2 / dof / more.count))


# Of the cases of benchmarks/step_diagonal_uncertainty.py: angular errors, plan, and what it finds with 200 sessions as
# the mean squared normalised error of the map, with what the mean of 200 may be off.
CASES = {
    "none": (0.0, {"repeats": 2}, 0.8, 0.06),
    "2 urad, three orders": (2e-6, {"orders": ("xyz", "yzx", "zxy")}, 1.0, 0.1),
    "5 urad away from zero": (5e-6, {"step": (0.05, 0.03, 0.02), "blocks": 10, "corner": (-0.2, 0.1, -0.15)}, 1.0, 0.2),
    "10 urad, 600 mm": (1e-5, {"step": (0.05, 0.05, 0.05), "repeats": 2}, 1.0, 0.1),
}


@pytest.mark.long
@pytest.mark.parametrize("case", CASES)
def test_small_angles_keep_the_uncertainties_honest(exact, truth, many, case):
    """From machines without any angular errors to those of a common machining centre."""
    angular, plan, expected, off = CASES[case]
    some = many.part(0.4)
    normalised, covered, square = [], [], []
    for seed in range(1000, 1000 + some.count):  # others than those with which the expectations were chosen
        simulated = exact(seed, noise=1.0, angular=angular, **plan)
        model = build(simulated.session)
        profiles = model.profiles(fit_models([model]).fits[0])
        free = _turn_free(profiles.blocks)
        error = free @ (profiles.value - truth(simulated, profiles.blocks))
        variance = np.diag(free @ profiles.covariance @ free.T)
        known = variance > 1e-20
        normalised.append(np.mean(error[known] ** 2 / variance[known]))
        covered.append(np.mean(error[known] ** 2 < 4 * variance[known]))
        square.append(np.sum(error**2))
    assert np.mean(normalised) == pytest.approx(expected, abs=some.off(off))
    assert np.mean(covered) > 0.95 - some.off(0.022)
    if not angular:  # they cost little where there are none
        plain = build(simulated.session, "translations")
        bound = np.trace(free @ plain.profiles(fit_models([plain]).fits[0]).covariance @ free.T)
        assert np.sqrt(np.mean(square) / bound) < 1.0 + some.off(0.045)


def test_least_squares_is_more_precise_than_the_new_formulation(reproducible, exact, truth, many):
    clean = exact(12, repeats=2)
    rng = np.random.default_rng(2)
    errors = {"new": [], "least_squares": []}
    stated = {}
    for _ in range(many.count):
        session = _noisy(clean.session, rng)
        for name, out in errors.items():
            profiles = identify_by_formulation(session, name)
            out.append(np.mean((profiles.value - truth(clean, profiles.blocks)) ** 2))
            stated[name] = np.mean(np.diag(profiles.covariance))
    for name, out in errors.items():
        assert np.sqrt(np.mean(out) / stated[name]) == pytest.approx(1.0, abs=many.off(0.067))
    assert stated["least_squares"] < 0.7 * stated["new"]
    assert np.mean(errors["least_squares"]) < 0.8 * np.mean(errors["new"])


def test_figures_scatter_as_stated(fitted, many):
    _, model, fits = fitted
    found = [{f.name + f.kind: f for f in model.profiles(fit).figures()} for fit in fits]
    for key, figure in found[0].items():
        values = np.array([each[key].value for each in found])
        # The extent of a noisy profile is not linear in it: its uncertainty is linearised.
        limit = many.part(2.0).off(0.2) + (0.2 if figure.kind == "straightness" else 0.0)
        assert values.std(ddof=1) == pytest.approx(figure.uncertainty, rel=limit)
