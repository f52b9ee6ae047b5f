# SPDX-License-Identifier: Apache-2.0
"""Which of the effects that were found a model takes."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from machine_tool_calibration.diagnosis import adding
from machine_tool_calibration.diagnosis.adding import add_probable, explain_nearly_all
from machine_tool_calibration.diagnosis.consequence import consequences
from machine_tool_calibration.diagnosis.diagnose import diagnose
from machine_tool_calibration.errors import ModelError
from machine_tool_calibration.model.model import Kind, Parameter
from machine_tool_calibration.simulation import PRESETS, FlawSpec, SimulationSpec, simulate


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

    for name, answer in {"_hold": None, "_changes_nothing": None}.items():
        monkeypatch.setattr(adding, name, lambda *_, answer=answer: answer)
    monkeypatch.setattr(adding, "_spurious", spurious)
    search: Any = SimpleNamespace(of=lambda name: SimpleNamespace(plausible=True, p_value=0.0), memory=1.0)
    model: Any = SimpleNamespace(joint=None, error_map=None)
    added = add_probable(("a", "b", "c"), search, {}, model, lambda names: model)
    assert added.accepted == accepted
    assert len(added.fitted) == len(accepted) + 1
    assert added.refused == ({} if "a" in accepted else {"a": "no size"})


@pytest.mark.long
def test_a_look_alike_is_told_in_the_place_of_what_was_added() -> None:
    """A servo lag of Y is minus one of X; by itself, without both backlashes, neither has the size that it has."""
    hidden = {"backlash_x": 3e-6, "backlash_y": -2e-6, "servo_mismatch_y": 2e-4}
    flaws = tuple(FlawSpec(id=name, size=size) for name, size in hidden.items())
    found = diagnose(simulate(SimulationSpec(plan=PRESETS["ball_bar"], seed=4, effects=flaws)).session)
    assert set(found.accepted[:2]) == {"backlash_x", "backlash_y"}
    told = consequences(found, most=1)
    one, other = told["servo_mismatch_x"], told["servo_mismatch_y"]
    (lag,), (opposite,) = one.parameters, other.parameters
    assert lag.value == pytest.approx(-opposite.value, rel=1e-6)
    assert opposite.value == pytest.approx(2e-4, abs=3 * opposite.standard_uncertainty)
    assert (one.rms_before, one.rms_after) == pytest.approx((other.rms_before, other.rms_after))
    assert found.search.of(found.accepted[2]).probability >= 0.999 * max(
        found.search.of(name).probability for name in ("servo_mismatch_x", "servo_mismatch_y")
    )


@pytest.mark.parametrize(
    ("value", "u", "occurs"), [(8e-5, 1e-6, True), (1e-3, 1e-5, False), (-1e-3, 1e-5, False), (1.1e-4, 1e-5, True)]
)
def test_a_size_beside_others_is_one_that_occurs(value: float, u: float, occurs: bool) -> None:
    parameter = Parameter("wave.s", "m", low=-5e-5, high=5e-5, kind=Kind.EFFECT, owner="wave")
    published = SimpleNamespace(determined=[True], theta=[value], covariance=np.array([[u**2]]))
    fit: Any = SimpleNamespace(published=published, assembly=SimpleNamespace(parameters=[parameter]))
    assert adding._occurs(fit, "wave") is occurs
