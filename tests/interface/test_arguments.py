# SPDX-License-Identifier: Apache-2.0
"""Arguments that cannot be are refused in one line, whichever function they are given to."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import machine_tool_calibration as mtcal

COEFFICIENT = {"b": ("1", -1.0, 1.0)}
WRONG: list[tuple[Callable[[Any], object], str]] = [
    (lambda fit: fit.budget(draws=-5), "draws must be a whole number"),
    (lambda fit: fit.budget(["reading"]), "contributor 1: the content must be a mapping of keys"),
    (lambda fit: fit.features(draws="many"), "draws must be a whole number from 0 to 100000, not 'many'"),
    (lambda fit: fit.compare_map("other_session"), "the other map must be that of a fit"),
    (lambda fit: fit.compare_map(fit, seed=-1), "seed must be a whole number from 0 to"),
    (lambda fit: fit.compare_map(fit, seed=1.5), "seed must be a whole number"),
    (lambda fit: fit.conformity(["EXX"]), "tolerances must be a mapping"),
    (lambda fit: fit.conformity({}), "no tolerance is given"),
    (lambda fit: fit.conformity({"EXX": None}), "the tolerance of EXX must be"),
    (lambda fit: fit.conformity({"EXX": 1e-5}, budget="mine.yaml"), "budget must be one, as Fit.budget gives it"),
    (lambda fit: fit.error_at("here"), "positions must be numbers"),
    (lambda fit: fit.error_at([[0.0, 0.0, 0.0], [0.0]]), "positions must be numbers"),
    (lambda fit: mtcal.Effect("e", "b * x", enters="x", coefficients=["b"]), "coefficients must be a mapping"),
    (
        lambda fit: mtcal.Effect("e", "b * x * k", enters="x", coefficients=COEFFICIENT, constants={"k": 2.0}),
        "constants.k must be a mapping of keys, not 2.0",
    ),
]


@pytest.fixture(scope="module")
def fit() -> mtcal.Fit:
    return mtcal.identify(mtcal.simulate("iso230_2", repeats=2, seed=3))


@pytest.mark.parametrize(("call", "message"), WRONG)
def test_what_cannot_be_is_named(fit: mtcal.Fit, call: Callable[[Any], object], message: str) -> None:
    with pytest.raises(mtcal.CalibrationError) as caught:
        call(fit)
    assert message in str(caught.value) and "\n" not in str(caught.value)


def test_numbers_of_numpy_are_numbers(fit: mtcal.Fit) -> None:
    assert fit.compare_map(fit, seed=np.int64(3)).agree


def test_far_beyond_what_was_measured_there_is_no_error(fit: mtcal.Fit) -> None:
    error, u = fit.error_at([np.inf, 0.0, 0.0])
    assert np.isnan(error).all() and np.isnan(u).all()
