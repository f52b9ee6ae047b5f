# SPDX-License-Identifier: Apache-2.0
"""What the pages show of a diagnosis and of an effect of the user's own."""

import pickle

import numpy as np
import pytest

from machine_tool_calibration.effects.formula import formula_effect
from machine_tool_calibration.errors import CalibrationError, ModelError
from machine_tool_calibration.workbench.models import Model
from machine_tool_calibration.workbench.state import State


def test_what_the_diagnosis_names_is_added_as_improve_does(state: State) -> None:
    with pytest.raises(CalibrationError, match="no diagnosis"):
        state.improved()
    told: list[float] = []
    # As it goes to another process and comes back.
    job = pickle.loads(pickle.dumps(state.diagnosed().work))
    state.diagnosed().take(pickle.loads(pickle.dumps(job(lambda what, share: told.append(share)))))
    assert state.diagnosis is not None and state.diagnosis.accepted == ("backlash_y",)
    assert told == sorted(told) and told[-1] <= 1.0
    first = state.model.fit.rms_residual
    state.improved()()
    assert state.model.fit.effects == ("backlash_y",) and state.model.fit.rms_residual < 0.5 * first
    assert state.diagnosis is None, "that of the model before is not this one's"


def test_the_pattern_of_an_effect_of_the_users_own_is_that_of_the_same_effect_of_the_catalogue(state: State) -> None:
    from machine_tool_calibration.workbench.own_effect import unknowns_of

    coefficients = {"coefficients": unknowns_of("b m -2e-5 2e-5")}
    state.know(formula_effect({"id": "mine", "enters": "y", "formula": "b * dir_y", **coefficients}))
    looked: list[Model] = []
    for name in ("mine", "backlash_y"):
        state.tried(name, looked.append)()
    ours, theirs = looked
    assert len(state.models) == 1, "to look at an effect puts it into no model"
    np.testing.assert_allclose(ours.comparison.fit.residuals, theirs.comparison.fit.residuals, atol=1e-12)
    assert np.ptp(state.model.comparison.fit.residuals - ours.comparison.fit.residuals) > 2e-6


def test_unknowns_are_read_from_a_line() -> None:
    from machine_tool_calibration.workbench.own_effect import unknowns_of

    assert unknowns_of("b m -2e-5 2e-5, q 1/K -1 1") == {
        "b": {"unit": "m", "low": -2e-5, "high": 2e-5},
        "q": {"unit": "1/K", "low": -1.0, "high": 1.0},
    }
    assert unknowns_of(" ") == {}
    with pytest.raises(ModelError, match="'b m 1': name, unit"):
        unknowns_of("b m 1")


def test_a_map_is_drawn_with_its_expanded_uncertainty(state: State) -> None:
    from machine_tool_calibration.workbench.map_plot import map_arrows

    found = state.model.fit.result.error_map
    drawn = map_arrows(found, 1000.0)
    np.testing.assert_allclose(drawn["x1"] - drawn["x"], 1e3 * 1000.0 * found.error[:, 0])
    np.testing.assert_allclose(drawn["wy"], 1e3 * 1000.0 * 2 * 2 * found.uncertainty[:, 1])
    assert np.isnan(drawn["ez"]).all() and (drawn["wz"] == 0.0).all(), "not determined: said so, and not drawn"
