# SPDX-License-Identifier: Apache-2.0
"""Common mistakes are named in one line; a bad fit alone is no mistake."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from machine_tool_calibration.errors import ModelError
from machine_tool_calibration.methods.rotary_axis.model import build
from machine_tool_calibration.session.session import Session


def _scaled(factor: float) -> Callable[[Session], Session]:
    return lambda s: s.with_readings(replace(s.readings, displacement=factor * s.readings.displacement))


def _degrees(session: Session) -> Session:
    columns = {**session.readings.columns, "c": np.degrees(session.readings.columns["c"])}
    return session.with_readings(replace(session.readings, columns=columns))


def _other_way(session: Session) -> Session:
    return replace(session, description=session.description.model_copy(update={"rotation_sign": -1}))


def _exchanged(values: np.ndarray, one: object, other: object) -> np.ndarray:
    return np.where(values == one, other, np.where(values == other, one, values))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (_degrees, "the column c looks like degrees"),
        (_scaled(1e3), "displacement looks like millimetres"),
        (_scaled(1e6), "displacement looks like micrometres"),
        (_scaled(-1.0), "opposite sign"),
        (_scaled(2.0), "twice the change of path"),
        (_other_way, "turned the other way"),
    ],
)
def test_wrong_units_and_signs(rotary: SimpleNamespace, change: Callable[[Session], Session], message: str) -> None:
    with pytest.raises(ModelError, match=message) as caught:
        build(change(rotary.measured(1).session))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(("one", "other"), ["AB", "BD", "CD"])
def test_two_stations_exchanged(rotary: SimpleNamespace, one: str, other: str) -> None:
    session = rotary.measured(2).session
    setup = _exchanged(session.readings.setup, "ABCD".index(one), "ABCD".index(other))
    with pytest.raises(ModelError, match=f"setups '{one}' and '{other}' look exchanged"):
        build(session.with_readings(replace(session.readings, setup=setup)))


@pytest.mark.parametrize(("one", "other"), ["PQ", "PK", "QK"])
def test_two_targets_exchanged(rotary: SimpleNamespace, one: str, other: str) -> None:
    session = rotary.measured(2).session
    target = _exchanged(session.readings.labels["target"].astype(str), one, other)
    with pytest.raises(ModelError, match="look exchanged") as caught:
        build(session.with_readings(replace(session.readings, labels={"target": target})))
    assert f"'{one}'" in str(caught.value) and f"'{other}'" in str(caught.value)


@pytest.mark.parametrize("seed", range(3))
def test_a_bad_axis_is_no_mistake(rotary: SimpleNamespace, seed: int) -> None:
    machine = {"random": {"rotary_translation": 1e-4, "rotary_tilt": 3e-4, "rotary_angle": 5e-4}}
    build(rotary.measured(seed, machine).session)


def test_no_rotary_axis(rotary: SimpleNamespace) -> None:
    session = rotary.measured(1).session
    machine = session.description.machine.model_copy(update={"axis": "X"})
    wrong = replace(session, description=session.description.model_copy(update={"machine": machine}))
    with pytest.raises(ModelError, match=r"machine.axis is 'X'"):
        build(wrong)
