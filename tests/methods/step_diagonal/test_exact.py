# SPDX-License-Identifier: Apache-2.0
"""Against exact geometry, without noise: what each estimator leaves."""

import numpy as np
import pytest
from papers.formulations import identify_by_formulation

from machine_tool_calibration.methods.step_diagonal.build import build, second_order
from machine_tool_calibration.model.fit import fit_models

NANOMETRE = 1e-9


def test_a_tilt_of_1_mrad_ruins_the_conventional_formulation_only(exact, worst):
    left = {name: [] for name in ("conventional", "new", "least_squares")}
    for seed in range(5):
        simulated = exact(seed)
        for name, values in left.items():
            values.append(worst(simulated, identify_by_formulation(simulated.session, name)))
    assert np.median(left["conventional"]) > 50e-6
    assert max(left["conventional"]) < 400e-6
    assert max(left["new"]) < 5 * NANOMETRE
    assert max(left["least_squares"]) < 3 * NANOMETRE


def test_without_a_tilt_the_conventional_formulation_is_right_to_the_nominal_beam(exact, worst):
    simulated = exact(3, tilt=0.0)
    assert worst(simulated, identify_by_formulation(simulated.session, "conventional")) < 50e-6
    assert worst(simulated, identify_by_formulation(simulated.session, "new")) < NANOMETRE


@pytest.mark.parametrize("model", ["small_angles", "translations"])
@pytest.mark.parametrize(
    "plan",
    [
        {"step": (0.03, 0.01, 0.02), "corner": (-0.1, 0.2, -0.3), "blocks": 8},
        {"diagonals": ("ppn", "npp", "nnn")},
        {"diagonals": ("ppp", "npp", "pnp", "ppn")},
        {"orders": ("xyz", "yzx", "zxy")},
        {"missing": 0.08, "repeats": 2},
    ],
)
def test_other_plans(exact, worst, plan, model):
    simulated = exact(5, **plan)
    fitted = build(simulated.session, model)
    assert worst(simulated, fitted.profiles(fit_models([fitted]).fits[0])) < 5 * NANOMETRE


def test_squareness_alone_is_exact_even_with_a_large_tilt(exact, worst):
    simulated = exact(2, position=0.0, squareness=1e-4, tilt=5e-3)
    model = build(simulated.session, "translations")
    fit = fit_models([model]).fits[0]
    assert worst(simulated, model.profiles(fit)) < 1e-3 * NANOMETRE
    assert np.abs(fit.residuals).max() < 1e-3 * NANOMETRE


def test_second_order_is_what_the_first_order_reading_leaves_out(exact):
    simulated = exact(4, position=3e-5, squareness=1e-4, tilt=5e-3)
    model = build(simulated.session, "translations")
    machine, observations, setup = simulated.truth.machine, model.observations, model.observations.readings.setup
    start = np.array([run.start for run in model.runs])
    motion = np.array([run.motion for run in model.runs])
    at_start = machine.position_error(start)
    error = machine.position_error(observations.position) - at_start[setup]
    end_error = machine.position_error(start + motion) - at_start
    actual = motion + end_error
    beam = actual / np.linalg.norm(actual, axis=1)[:, None]
    tilt = np.array([0.003, -0.004, 0.002])
    normal = beam + tilt
    g = normal / np.einsum("rj,rj->r", normal, beam)[:, None]
    nominal = np.array([run.beam for run in model.runs])
    t = g - np.einsum("rj,rj->r", g, nominal)[:, None] * nominal
    displacement = observations.position - start[setup]
    exactly = np.einsum("nj,nj->n", g[setup], displacement + error)
    first = np.einsum("nj,nj->n", nominal[setup], displacement + error) + np.einsum("nj,nj->n", t[setup], displacement)
    diagonal = np.array([run.diagonal for run in model.runs])[setup]
    left = exactly - first - second_order(model.runs, setup, displacement, error, end_error, t)
    assert np.abs(exactly - first)[diagonal].max() > 100 * NANOMETRE
    assert np.abs(left)[diagonal].max() < 1e-4 * NANOMETRE
