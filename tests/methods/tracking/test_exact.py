# SPDX-License-Identifier: Apache-2.0
"""Without noise the map is the machine's, to the nanometre and better, whatever was declared of the stations.
Many simulated measurements: the stated uncertainties are right, and they are the bound.
"""

import hashlib
import os
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from machine_tool_calibration.methods.identify import identify


@pytest.mark.parametrize("model", ["free", "rigid_body"])
@pytest.mark.parametrize("pointing", ["open_loop", "tracking"])
@pytest.mark.parametrize("dimension", [2, 3])
def test_map_and_stations(dimension, pointing, model, simulated, truth):
    made = simulated(dimension, pointing, noise=0.0)
    result = identify(made.session, model=model)
    true = truth(made)
    # Second order of the machine's own angles, some 1e-5 squared on half a metre; 12 um on a metre times 10 um.
    assert np.abs(result.error_map.content["position_error"] - true.error).max() < 1e-9
    assert np.abs(result.error_map.content["stations"][:, :dimension] - true.stations).max() < 2e-8
    assert result.rms_residual < 1e-9
    assert result.not_determined == ([] if model == "free" else list(result.fit.model.left_out))


@pytest.mark.long(but=("2-open_loop", "3-tracking"))
@pytest.mark.parametrize("pointing", ["open_loop", "tracking"])
@pytest.mark.parametrize("dimension", [2, 3])
def test_stations_wrong_by_a_millimetre(dimension, pointing, simulated, truth):
    """A tracking network then turns by a milliradian, whose square must not stay in the map."""
    for seed in range(5):
        made = simulated(dimension, pointing, seed, noise=0.0, station_uncertainty=1e-3)
        result = identify(made.session)
        assert np.abs(result.error_map.content["position_error"] - truth(made).error).max() < 5e-9


@pytest.mark.parametrize("dimension", [2, 3])
def test_dead_path_is_the_path_at_the_datum(dimension, simulated):
    made = simulated(dimension, "tracking", noise=0.0)
    result = identify(made.session)
    stations = np.array(made.truth.expected["stations"])[:, :dimension]
    first = np.array(made.truth.expected["points"])[0] + made.truth.expected["position_error"][0]
    actual = np.linalg.norm(first[:dimension] - stations, axis=1)
    assert np.abs(result.error_map.content["dead_path"] - actual).max() < 1e-8


def test_rows_in_any_order_and_columns_beside(simulated, edit):
    """The datum is the first reading of the recording; after it the order does not matter."""
    made = simulated(2, seed=3)
    n = len(made.session.readings)
    one = identify(made.session)
    shuffled = np.random.default_rng(0).permutation(n)
    two = identify(edit(made.session, keep=shuffled))
    order = [two.error_map.points.tolist().index(p) for p in one.error_map.points.tolist()]
    assert np.allclose(
        two.error_map.content["position_error"][order], one.error_map.content["position_error"], atol=1e-13
    )
    assert two.fit.joint.p_value == pytest.approx(one.fit.joint.p_value, rel=1e-6)


SCRIPT = """
import hashlib, sys
from machine_tool_calibration.methods.identify import identify
from machine_tool_calibration.simulation import SimulationSpec, TrackingPlan, simulate
out = hashlib.sha256()
for model in ("free", "rigid_body"):
    session = simulate(SimulationSpec(plan=TrackingPlan(dimension=3), seed=1)).session
    result = identify(session, model=model)
    out.update(result.error_map.error.tobytes() + result.fit.solution.covariance.tobytes())
print(out.hexdigest())
"""


@pytest.mark.long
def test_processes_and_threads(capsys):
    """This process has one thread for linear algebra; another has two, and calculates twice."""
    exec(SCRIPT, {})
    here = capsys.readouterr().out.split()
    environment = os.environ | {"OPENBLAS_NUM_THREADS": "2", "OMP_NUM_THREADS": "2"}
    twice = [sys.executable, "-c", f"for _ in range(2): exec({SCRIPT!r})"]
    done = subprocess.run(twice, env=environment, capture_output=True, text=True, timeout=900, check=True)
    assert done.stdout.split() == 2 * here
    assert len(here) == 1 and len(here[0]) == hashlib.sha256().digest_size * 2


# A smaller volume than usual: 27 targets say as much about uncertainties as 125.
SMALL = {"x": (0.0, 0.15, 0.4), "y": (0.0, 0.2, 0.4), "z": (0.0, 0.25, 0.4)}
PLANS = {2: {"repeats": 2}, 3: {"repeats": 1, **SMALL}}


@pytest.fixture(scope="module", params=[(2, "open_loop"), (3, "open_loop"), (2, "tracking"), (3, "tracking")], ids=str)
def runs(request, simulated, truth, scores, many):
    """Of each run: errors and uncertainties of the map and of the stations, and the p-value."""
    dimension, pointing = request.param
    out = []
    for seed in range(many.count):
        made = simulated(dimension, pointing, seed, **PLANS[dimension])
        result = identify(made.session)
        true, content = truth(made), result.error_map.content
        stations = content["stations"][:, :dimension] - true.stations
        out.append((*scores(result, true), stations, content["stations_u"][:, :dimension], result.fit.joint.p_value))
    return tuple(np.array(values) for values in zip(*out, strict=True))


def test_map(runs, many):
    error, uncertainty = runs[:2]
    assert np.mean((error / uncertainty) ** 2) == pytest.approx(1.0, abs=many.off(0.1))
    assert np.sqrt(np.mean(error**2)) < (1.0 + many.off(0.1)) * np.sqrt(np.mean(uncertainty**2))


def test_every_target_by_itself(runs, many):
    """Not only on the average: no target's error is off its uncertainty by more than so many runs allow."""
    error, uncertainty = runs[:2]
    square = np.mean((error / uncertainty) ** 2, axis=0)
    low, high = stats.chi2.ppf([1e-6, 1 - 1e-6], many.count) / many.count
    assert low < square.min()
    assert square.max() < high


def test_stations(runs, many):
    error, uncertainty = runs[2:4]
    assert np.mean((error / uncertainty) ** 2) == pytest.approx(1.0, abs=many.off(0.1))


def test_p_values_are_uniform(runs):
    assert stats.kstest(runs[4], "uniform").pvalue > 0.01


@pytest.mark.long
@pytest.mark.parametrize("dimension", [2, 3])
def test_rigid_body(dimension, simulated, truth, scores, many):
    errors, uncertainties, p = [], [], []
    for seed in range(many.count):
        made = simulated(dimension, "open_loop", seed, **PLANS[dimension])
        result = identify(made.session, model="rigid_body")
        error, uncertainty = scores(result, truth(made))
        errors.append(error)
        uncertainties.append(uncertainty)
        p.append(result.fit.joint.p_value)
    assert np.mean((np.array(errors) / uncertainties) ** 2) == pytest.approx(1.0, abs=many.off(0.1))
    assert np.sqrt(np.mean(np.square(errors))) < (1.0 + many.off(0.1)) * np.sqrt(np.mean(np.square(uncertainties)))
    assert stats.kstest(p, "uniform").pvalue > 0.01


def test_fewer_unknowns_less_uncertainty(simulated):
    session = simulated(3).session
    free, rigid = identify(session), identify(session, model="rigid_body")
    assert np.mean(rigid.error_map.uncertainty**2) < 0.5 * np.mean(free.error_map.uncertainty**2)


@pytest.mark.parametrize(("effect", "size"), [("backlash_x", 2e-6), ("dead_path", 0.3)])
def test_parameters_of_effects(effect, size, simulated, many, reproducible):
    """An effect's coefficient within its uncertainty, over runs; the uncertainty is neither too large nor too small."""
    scores = []
    count = many.count
    for seed in range(count):
        made = simulated(2, "open_loop", seed, effects={effect: size})
        result = identify(made.session, effects=[effect])
        (estimate,) = [e for e in result.parameters if e.name.startswith(effect)]
        scores.append((estimate.value - size) / estimate.standard_uncertainty)
    low, high = stats.chi2.ppf([0.01, 0.99], count) / count
    assert low < np.mean(np.square(scores)) < high
    assert abs(np.mean(scores)) < 4 / np.sqrt(count)


@pytest.mark.long
def test_a_missing_tenth_costs_uncertainty_but_no_honesty(simulated, truth, many):
    squares, wider = [], []
    some = many.part(0.5)
    for seed in range(some.count):
        made = simulated(2, "open_loop", seed, missing=0.1)
        result = identify(made.session)
        good = np.isfinite(result.error_map.content["position_error"]).all(axis=1)
        error = (result.error_map.content["position_error"] - truth(made, good).error)[good]
        squares.append(np.mean((error / result.error_map.content["position_error_u"][good]) ** 2))
        whole = identify(simulated(2, "open_loop", seed).session)
        wider.append(result.error_map.uncertainty[good, :2].mean() / whole.error_map.uncertainty[good, :2].mean())
    assert np.mean(squares) == pytest.approx(1.0, abs=some.off(0.1))
    assert min(wider) > 1.0


def test_a_plane_above_the_guideways_has_the_same_error_motions(simulated):
    """A roll of X with the height as its arm is its straightness, and with a slope a turn of the whole frame."""
    session = simulated(2).session
    height = session.readings.columns["z"] + 0.1
    raised = session.with_readings(replace(session.readings, columns=session.readings.columns | {"z": height}))
    low, high = (identify(one, model="rigid_body") for one in (session, raised))
    determined = [{p.name for p in found.parameters if np.isfinite(p.value)} for found in (low, high)]
    assert "C0Y" in determined[0] and determined[0] == determined[1]
    assert "EAX" in [left.name for left in high.not_determined]
