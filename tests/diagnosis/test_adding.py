# SPDX-License-Identifier: Apache-2.0
"""Which of the effects that were found a model takes."""

from types import SimpleNamespace
from typing import Any

import pytest

from machine_tool_calibration.diagnosis.adding import explain_nearly_all
from machine_tool_calibration.errors import ModelError


def fitted(chi_square: float) -> Any:
    return SimpleNamespace(joint=SimpleNamespace(solution=SimpleNamespace(chi_square=chi_square)))


@pytest.mark.parametrize(("left", "enough"), [(14.0, True), (16.0, False), (100.0, False)])
def test_what_is_ruled_out_is_needless_where_the_others_explain_nearly_as_much(left: float, enough: bool) -> None:
    """Together they take 90 of 100: 95 % of that are 85.5."""
    assert explain_nearly_all(("a", "b"), (fitted(100.0), fitted(left)), lambda names: fitted(10.0)) is enough


def test_effects_that_no_model_takes_together_are_looked_for_anew() -> None:
    def refuse(names: tuple[str, ...]) -> Any:
        raise ModelError("together they are not determined")

    assert not explain_nearly_all(("a", "b"), (fitted(100.0), fitted(1.0)), refuse)
