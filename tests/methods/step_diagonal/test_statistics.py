"""Uncertainties are right, and as small as the readings allow."""

from dataclasses import replace

import numpy as np
import pytest

from machine_tool_calibration.methods.step_diagonal import build
from machine_tool_calibration.methods.step_diagonal.compare import identify_by_formulation
from machine_tool_calibration.model.fit import fit_models

SETS = 200
SESSIONS = 40


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
def fitted(exact):
    """A simulated session and fits to it with 200 draws of noise."""
    simulated = exact(11, repeats=2)
    model = build(simulated.session, "translations")
    rng = np.random.default_rng(1)
    return simulated, model, [_refitted(model, rng) for _ in range(SETS)]


def test_translations_reach_the_bound_with_right_uncertainties(fitted, truth):
    simulated, model, fits = fitted
    free = _turn_free(model.blocks)
    true = truth(simulated, model.blocks)
    profiles = [model.profiles(fit) for fit in fits]
    error = np.array([free @ (each.value - true) for each in profiles])
    variance = np.diag(free @ profiles[0].covariance @ free.T)
    known = variance > 1e-20
    assert np.sqrt(np.mean(error**2)) < 1.1 * np.sqrt(np.mean(variance))
    assert 0.9 < np.mean(error[:, known] ** 2 / variance[known]) < 1.1
    chi = [fit.joint.reduced_chi_square for fit in fits]
    dof = fits[0].solution.degrees_of_freedom
    assert np.mean(chi) == pytest.approx(1.0, abs=4 * np.sqrt(2 / dof / SETS))


@pytest.mark.parametrize(
    ("angular", "plan", "low", "high"),
    [
        (2e-6, {"repeats": 2}, 0.8, 1.1),
        (2e-6, {"orders": ("xyz", "yzx", "zxy")}, 0.8, 1.15),
        (0.0, {"repeats": 2}, 0.7, 1.0),
    ],
)
def test_small_angles_keep_the_uncertainties_honest(exact, truth, angular, plan, low, high):
    """A machine whose angular errors are a few microradians, as none is without, and one without any."""
    squared, stated, normalised, plain = [], [], [], []
    for seed in range(1000, 1000 + SESSIONS):  # others than the size's expectation was chosen with
        simulated = exact(seed, noise=1.0, angular=angular, **plan)
        for name, out in (("small_angles", normalised), ("translations", plain)):
            model = build(simulated.session, name)
            profiles = model.profiles(fit_models([model]).fits[0])
            free = _turn_free(profiles.blocks)
            error = free @ (profiles.value - truth(simulated, profiles.blocks))
            variance = np.diag(free @ profiles.covariance @ free.T)
            known = variance > 1e-20
            out.append(np.mean(error[known] ** 2 / variance[known]))
            if name == "small_angles":
                squared.append(np.mean(error**2))
                stated.append(np.mean(variance))
    assert low < np.mean(normalised) < high
    assert np.mean(squared) < 1.1**2 * np.mean(stated)
    if angular:
        assert np.mean(plain) > 1.15
        assert abs(np.log(np.mean(normalised))) < abs(np.log(np.mean(plain)))


def test_least_squares_is_more_precise_than_the_new_formulation(exact, truth):
    clean = exact(12, repeats=2)
    rng = np.random.default_rng(2)
    errors = {"new": [], "least_squares": []}
    stated = {}
    for _ in range(40):
        session = _noisy(clean.session, rng)
        for name, out in errors.items():
            profiles = identify_by_formulation(session, name)
            out.append(np.mean((profiles.value - truth(clean, profiles.blocks)) ** 2))
            stated[name] = np.mean(np.diag(profiles.covariance))
    for name, out in errors.items():
        assert np.sqrt(np.mean(out) / stated[name]) == pytest.approx(1.0, abs=0.15)
    assert stated["least_squares"] < 0.7 * stated["new"]
    assert np.mean(errors["least_squares"]) < 0.8 * np.mean(errors["new"])


def test_figures_scatter_as_stated(fitted):
    _, model, fits = fitted
    found = [{f.name + f.kind: f for f in model.profiles(fit).figures()} for fit in fits]
    for key, figure in found[0].items():
        values = np.array([each[key].value for each in found])
        # The extent of a noisy profile is not linear in it: its uncertainty is linearised.
        limit = 0.4 if figure.kind == "straightness" else 0.2
        assert values.std(ddof=1) == pytest.approx(figure.uncertainty, rel=limit)
