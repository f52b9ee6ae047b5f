# SPDX-License-Identifier: Apache-2.0
from collections.abc import Callable

import numpy as np
import pytest

from machine_tool_calibration.effects.catalogue import catalogue
from machine_tool_calibration.methods.build import build_model
from machine_tool_calibration.model.fit import fit_models, screen
from machine_tool_calibration.planning.options import further_options
from machine_tool_calibration.planning.sensing import SizedEffect, sense
from machine_tool_calibration.session.session import Session

Simulated = Callable[..., Session]
EFFECTS = catalogue()


def assumed(name: str, shape: tuple[float, ...] = (), **size: float) -> SizedEffect:
    return SizedEffect(EFFECTS[name], shape, size)


def test_the_same_as_plain_algebra_on_the_whole_matrix(simulated: Simulated) -> None:
    """Probing: one unknown a point and the model's columns, projected off by a dense least-squares fit."""
    session = simulated("probing_cross")
    model = build_model(session)[0]
    sigma = session.sigma
    names = ("backlash_x", "backlash_y", "workpiece_thermal")
    label = session.readings.labels["point"]
    points = (np.unique(label)[:, None] == label[None, :]).astype(float)
    dense = np.concatenate([points, model.dense()]).T / sigma
    columns = {name: EFFECTS[name].columns(model.observations)[0] / sigma for name in names}
    basis = np.linalg.svd(dense / np.maximum(np.linalg.norm(dense, axis=0), 1e-300), full_matrices=False)
    basis = basis[0][:, basis[1] > 1e-7]
    left = {name: column - basis @ (basis.T @ column) for name, column in columns.items()}
    sensed = sense(session, [assumed(name, **{c.name: 1.0 for c in EFFECTS[name].coefficients}) for name in names])
    for one in names:
        assert sensed.information(one)[0] == pytest.approx(left[one] @ left[one], rel=1e-6)
        for other in names:
            cosine = abs(left[one] @ left[other]) / np.linalg.norm(left[one]) / np.linalg.norm(left[other])
            assert sensed.cosine(one, other) == pytest.approx(cosine, abs=1e-6)
            if one == other:
                assert sensed.apart(one, other) < 1e-3 * np.linalg.norm(left[one])
                continue
            apart = np.linalg.norm(left[one]) * np.sqrt(max(1 - cosine**2, 0.0))
            assert sensed.apart(one, other) == pytest.approx(apart, rel=1e-4)
    a, b = left["backlash_x"], left["backlash_y"]
    beside = a - b * (a @ b) / (b @ b)
    assert sensed.beside(["backlash_y"]).information("backlash_x")[0] == pytest.approx(beside @ beside, rel=1e-5)


@pytest.mark.parametrize("plan", ["tracking_2d", "rotary_axis", "step_diagonal"])
def test_nominal_geometry_senses_what_the_fit_senses(simulated: Simulated, plan: str) -> None:
    session = simulated(plan)
    fit = fit_models([build_model(session)[0]]).fits[0]
    name = {"tracking_2d": "backlash_y", "rotary_axis": "backlash_c", "step_diagonal": "dead_path"}[plan]
    columns = EFFECTS[name].columns(fit.model.observations)
    expected = screen(fit, columns).gram[0, 0]
    assert sense(session, [assumed(name, b=1.0)]).information(name)[0] == pytest.approx(expected, rel=0.02)


def test_an_effect_in_the_model_takes_its_share(simulated: Simulated) -> None:
    session = simulated("tracking_2d")
    drift = assumed("linear_drift", r=1e-9)
    alone = sense(session, [drift]).information("linear_drift")[0]
    beside = sense(session, [drift], present=[assumed("dead_path", D=1.0)]).information("linear_drift")[0]
    both = sense(session, [drift, assumed("dead_path", D=1.0)]).beside(["dead_path"])
    assert beside < 0.9 * alone
    assert beside == pytest.approx(both.information("linear_drift")[0], rel=1e-6)


def test_what_the_model_absorbs_has_no_information(simulated: Simulated) -> None:
    session = simulated("tracking_2d")
    sensed = sense(session, [assumed("scale", s=1.0), assumed("backlash_y", b=1.0)])
    assert sensed.information("scale").tolist() == [0.0]
    assert sensed.share("scale") < 0.01 < sensed.share("backlash_y")


def test_a_part_that_is_turned_turns_its_effect_only(simulated: Simulated) -> None:
    session = simulated("tracking_2d")
    option = next(o for o in further_options(session) if o.kind == "turned")
    form = assumed("retroreflector_form", (3.0,), s2=1e-6, c3=1e-6)
    radial = assumed("pointer_radial_error", (3.0,), s2=1e-6, c3=1e-6)
    plain = sense(option.session, [form, radial], first_row=option.first_row)
    turned = sense(option.session, [form, radial], first_row=option.first_row, turned=option.turned)
    assert plain.cosine("retroreflector_form", "pointer_radial_error") == pytest.approx(1.0, abs=1e-6)
    assert turned.cosine("retroreflector_form", "pointer_radial_error") < 0.9
    assert turned.information("pointer_radial_error") == pytest.approx(plain.information("pointer_radial_error"))


def test_setups_that_are_new_get_coefficients_of_the_usual_size(simulated: Simulated) -> None:
    session = simulated("tracking_2d")
    option = next(o for o in further_options(session) if o.kind == "again")
    size = {f"{station}.v{axis}": 2e-9 for station in "ABCD" for axis in "xy"}
    sensed = sense(option.session, [assumed("station_drift", **size)], first_row=option.first_row)
    assert sensed.signal["station_drift"] == pytest.approx(np.full(16, 2e-9))
