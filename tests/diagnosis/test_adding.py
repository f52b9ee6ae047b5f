# SPDX-License-Identifier: Apache-2.0
"""Which of the effects that were found a model takes."""

from types import SimpleNamespace
from typing import Any

import pytest

from machine_tool_calibration.diagnosis import adding
from machine_tool_calibration.diagnosis.adding import add_probable, explain_nearly_all
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


@pytest.mark.parametrize(
    ("hidden_by", "accepted"), [("b", ("b", "c", "a")), ("bc", ("b", "c", "a")), ("bcd", ("b", "c"))]
)
def test_a_size_that_others_hide_is_judged_beside_them(
    hidden_by: str, accepted: tuple[str, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The first has a size once the model has what hides it: what is in no model is none of them."""

    def spurious(_: Any, __: Any, names: tuple[str, ...], ___: Any) -> dict[str, str]:
        return {"a": "no size"} if "a" in names and not set(hidden_by) <= set(names) else {}

    for name, answer in {"_settled": None, "_hold": None, "_changes_nothing": None}.items():
        monkeypatch.setattr(adding, name, lambda *_, answer=answer: answer)
    monkeypatch.setattr(adding, "_spurious", spurious)
    search: Any = SimpleNamespace(of=lambda name: SimpleNamespace(plausible=True, p_value=0.0), memory=1.0)
    model: Any = SimpleNamespace(joint=None, error_map=None)
    added = add_probable(("a", "b", "c"), search, {}, model, lambda names: model)
    assert added.accepted == accepted
    assert len(added.fitted) == len(accepted) + 1
    assert added.refused == ({} if "a" in accepted else {"a": "no size"})
