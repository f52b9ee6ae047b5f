# SPDX-License-Identifier: Apache-2.0
"""Small angular errors: the mean over all sizes and shapes, against plain linear algebra with every one of them."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import block_diag, null_space

from machine_tool_calibration.methods.identify import identify
from machine_tool_calibration.methods.step_diagonal import small_angles as module
from machine_tool_calibration.methods.step_diagonal.build import build
from machine_tool_calibration.methods.step_diagonal.profiles import eq17
from machine_tool_calibration.methods.step_diagonal.small_angles import (
    LARGEST,
    NONE,
    SMALLEST,
    SmallAngles,
    mean_shape,
    own_sizes,
    shape_covariance,
)
from machine_tool_calibration.model.fit import fit_models
from machine_tool_calibration.simulation import TableSpec

ORDERS = ("xyz", "yzx", "zxy")


@pytest.mark.parametrize("share", [0.0, 0.3, 1.0])
def test_random_functions_are_zero_at_first_and_of_size_one(share):
    covariance = shape_covariance(np.linspace(-1.0, 3.0, 7), 0.2, share)
    assert covariance[0] == pytest.approx(np.zeros(7), abs=1e-15)
    assert np.mean(np.diag(covariance)) == pytest.approx(1.0)
    assert np.linalg.eigvalsh(covariance).min() > -1e-12


def test_sizes_of_several_ratios_have_the_mean_of_their_squares():
    nodes = ((np.linspace(0.0, 0.4, 5), 0), (np.linspace(0.0, 0.3, 4), 0))
    one, mixed = SmallAngles((), nodes), SmallAngles((), nodes, (((1.0, 2.0), 0.25), ((3.0, 2.0), 0.75)))
    expected = np.repeat([0.25 * 1.0 + 0.75 * 9.0, 4.0], [5, 4])
    assert np.sum(mixed.root**2, axis=1) == pytest.approx(expected * np.sum(one.root**2, axis=1))


def _by_hand(model):
    """Weights, means and covariances of the map, and what is expected of the angles, for every size and shape.

    The readings' covariance is written out.
    """
    n = len(model.observations)
    offsets = np.zeros((len(model.own), n))
    offsets[model.observations.run, np.arange(n)] = 1.0
    random = {term.name for term in model.spread.terms}
    others = np.concatenate([offsets, *(t.columns for t in model.terms if t.name not in random)])
    names = [p.name for p in model.own] + [p.name for t in model.terms if t.name not in random for p in t.parameters]
    rows = np.array([[c.weights.get(name, 0.0) for name in names] for c in model.constraints])
    design = others.T @ null_space(rows)  # unknowns that obey the datum
    scale = np.linalg.norm(design, axis=0)
    unit, found, _ = np.linalg.svd(design / scale, full_matrices=True)
    rank = int(np.sum(found > 1e-10))
    outside = unit[:, rank:]  # what no other unknown touches
    residual = model.observations.readings.displacement - model.nominal
    angles = np.concatenate([term.columns for term in model.spread.terms])
    logs, means, covariances, priors = [np.log(NONE)], [], [], []
    sizes = np.geomspace(SMALLEST, LARGEST, module._SIZES_TRIED)
    none = (1.0,) * len(model.spread.tables)
    likely = model.spread.posterior.ratios
    each = [(s, shape, *one) for one in likely for shape in module._SHAPES for s in sizes]
    errors, index = model._map_rows()
    mapping = eq17(model.blocks, errors).T
    for size, shape, factors, weight in [(0.0, module._SHAPES[0], none, 1.0), *each]:
        own = zip(factors, model.spread.tables, strict=True)
        prior = size**2 * block_diag(*[f**2 * shape_covariance(table.nodes, *shape) for f, table in own])
        readings = np.diag(model.sigma**2) + angles.T @ prior @ angles
        seen = outside.T @ readings @ outside
        told = outside.T @ residual
        if size:
            logs.append(np.log((1 - NONE) * weight * len(likely) / len(each)))
        logs[-1] += -0.5 * (np.linalg.slogdet(seen)[1] + told @ np.linalg.solve(seen, told))
        # Generalised least squares for the others, regression for the angles.
        inverse = np.linalg.inv(readings)
        scaled = design / scale
        inner = np.linalg.pinv(scaled.T @ inverse @ scaled, rcond=1e-11, hermitian=True)
        estimate = null_space(rows) / scale @ inner @ scaled.T @ inverse
        gain = prior @ angles @ inverse
        back = gain @ (np.eye(n) - others.T @ estimate)
        both = np.concatenate([estimate, back])
        # Error of the estimates: they see angles (by their columns) and noise.
        wrong = both @ angles.T - np.concatenate([np.zeros((len(names), len(angles))), np.eye(len(angles))])
        covariance = wrong @ prior @ wrong.T + both @ np.diag(model.sigma**2) @ both.T
        order = [*names, *(label for labels in model.spread.names for label in labels)]
        place = [order.index(model.parameters[k].name) for k in index]
        means.append(mapping @ (both @ residual)[place])
        priors.append(prior)
        covariances.append(mapping @ covariance[np.ix_(place, place)] @ mapping.T)
    logs = np.array(logs)
    weights = np.exp(logs - logs.max())
    return weights / weights.sum(), np.array(means), np.array(covariances), np.array(priors)


@pytest.mark.long
@pytest.mark.parametrize(("angular", "seed"), [(3e-6, 9), (1.5e-5, 9)])
def test_the_map_is_the_mean_over_sizes_and_shapes(exact, angular, seed, reproducible):
    plan = {"blocks": 4, "step": (0.05, 0.04, 0.03), "corner": (-0.1, 0.2, 0.0)}
    model = build(exact(seed, noise=1.0, angular=angular, **plan).session)
    weights, means, covariances, priors = _by_hand(model)
    assert weights[1:].sum() > 0.02
    mean = weights @ means
    total = np.tensordot(weights, covariances, axes=1) + (means - mean).T @ ((means - mean) * weights[:, None])
    fit = fit_models([model])
    assert fit.marginal.scatter == 1.0  # readings that scatter no more than declared
    profiles = model.profiles(fit.fits[0])
    uncertainty = np.sqrt(np.diag(total))
    assert uncertainty.max() > 1.05 * np.sqrt(np.diag(covariances[0])).max()
    assert profiles.value == pytest.approx(mean, abs=1e-3 * uncertainty.max())
    assert np.sqrt(np.diag(profiles.covariance)) == pytest.approx(uncertainty, rel=2e-3, abs=1e-12)
    found = model.spread.posterior
    assert found.probability == pytest.approx(weights[1:].sum(), rel=1e-3)
    # All that is expected before and after the readings, one error worse than the others where that is probable.
    expected = np.tensordot(weights, priors, axes=1)
    assert block_diag(*found.priors) == pytest.approx(expected, rel=2e-3, abs=1e-3 * expected.max())
    assert found.size**2 == pytest.approx(np.trace(expected) / sum(len(p) for p in found.priors), rel=2e-3)


@pytest.mark.long
def test_a_declaration_that_is_too_small_does_not_turn_scatter_into_angles(exact):
    session = exact(5, noise=1.0, angular=3e-6, repeats=2).session
    declared = session.description.standard_uncertainty
    small = declared.model_copy(update={"displacement": declared.displacement / 3.0})
    other = replace(session, description=session.description.model_copy(update={"standard_uncertainty": small}))
    right, found = (identify(one).error_map.uncertainty for one in (session, other))
    assert np.nanmedian(found[right > 0] / right[right > 0]) == pytest.approx(1.0, abs=0.1)


@pytest.mark.long
def test_the_same_readings_give_the_same_to_the_last_bit(exact):
    session = exact(3, noise=1.0, angular=5e-6).session
    one, other = identify(session), identify(session)
    assert np.array_equal(one.error_map.error, other.error_map.error)
    assert np.array_equal(one.error_map.uncertainty, other.error_map.uncertainty, equal_nan=True)
    assert one.document() == other.document()


@pytest.mark.long
def test_parameters_are_those_of_the_map(exact):
    result = identify(exact(3, noise=1.0, angular=5e-6, repeats=2).session)
    found = {p.name: p for p in result.parameters}
    content = result.error_map.content
    assert found["EXX(0.12)"].value - found["EXX(0)"].value == pytest.approx(content["x"][-1, 0], abs=1e-15)
    assert found["EXX(0.12)"].standard_uncertainty == pytest.approx(content["x_u"][-1, 0], rel=1e-6)
    assert 0.0 < content["angular_probability"] <= 1.0
    assert SMALLEST * content["angular_probability"] ** 0.5 <= content["angular_size"] <= LARGEST


@pytest.mark.parametrize("size", [2e-6, 1e-5])
def test_angles_that_are_expected_have_the_size_that_was_said(exact, size):
    model = build(exact(3, noise=1.0, angular=5e-6).session).expecting(size)
    for labels, where in zip(model.spread.names, model.spread.nodes, strict=True):
        own = [prior for prior in model.priors if set(prior.weights) == set(labels)]
        axes = np.array([[prior.weights[label] for label in labels] for prior in own])
        covariance = axes.T @ np.diag([prior.sigma**2 for prior in own]) @ axes
        assert covariance == pytest.approx(size**2 * mean_shape(*where), abs=1e-4 * size**2)
    assert model.random is None


@pytest.mark.long
@pytest.mark.parametrize("angular", [0.0, 1.5e-5])
def test_what_the_readings_tell_of_the_size(exact, angular):
    found = [build(exact(seed, noise=1.0, angular=angular, repeats=2).session).spread.posterior for seed in range(4)]
    if angular:
        # The largest angle of a random function is 1.7 times its root mean square over the travel, on the average.
        assert 4.5e-6 < np.median([p.size for p in found]) < 1.8e-5
        assert np.median([p.probability for p in found]) > 0.95
    else:
        assert np.median([p.size for p in found]) < 2.5e-6
        assert np.median([p.probability for p in found]) < 0.3


def test_the_map_holds_the_arms_of_the_angles_along_its_own_edges(exact, worst):
    """Away from the machine's zero an angle displaces the edges along which the position errors are published."""
    corner = (-0.2, 0.1, -0.3)
    nodes = tuple(corner[0] + 0.01 * k for k in range(13))
    bow = TableSpec(nodes=nodes, values=tuple(2e-6 * k * (12 - k) / 36 for k in range(13)), interpolation="linear")
    simulated = exact(2, motions={"EAX": bow}, tilt=0.0, orders=ORDERS, corner=corner)
    model = build(simulated.session, "angular_one_mirror")
    assert worst(simulated, model.profiles(fit_models([model]).fits[0])) < 5e-9


def test_an_angular_error_that_stands_out_has_a_size_of_its_own() -> None:
    rng = np.random.default_rng(8)
    roots = [np.linalg.cholesky(mean_shape(np.linspace(0.0, 0.5, 9), 0) + 1e-9 * np.eye(9)) for _ in range(4)]
    columns = rng.normal(size=(36, 400)) / 1e-6  # readings in their uncertainties, of 1 urad each
    sizes = np.array([2e-6, 2e-6, 2e-5, 2e-6])
    angles = np.concatenate([size * root @ rng.normal(size=9) for size, root in zip(sizes, roots, strict=True)])
    alike = np.concatenate([2e-6 * root @ rng.normal(size=9) for root in roots])
    found, none = (
        own_sizes(roots, columns @ columns.T, columns @ (columns.T @ true + rng.normal(size=400)))
        for true in (angles, alike)
    )
    assert all(factors[2] > 1.0 and factors[:2] == (1.0, 1.0) and factors[3] == 1.0 for factors, _ in found)
    assert dict(none)[1.0, 1.0, 1.0, 1.0] > 0.5
