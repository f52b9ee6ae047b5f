# SPDX-License-Identifier: Apache-2.0
"""Common mistakes are named in one line; a bad fit alone is no mistake."""

from collections.abc import Callable
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from machine_tool_calibration.errors import ModelError
from machine_tool_calibration.methods.identify import identify
from machine_tool_calibration.methods.rotary_axis.model import build
from machine_tool_calibration.methods.rotary_axis.start import suppositions
from machine_tool_calibration.session.session import Session

# Enough to tell a mistake.
FEW = tuple(np.radians(np.arange(0.0, 360.0, 40.0)))


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
        (_scaled(-1.0), "opposite sign"),
        (_other_way, "turned the other way"),
    ],
)
def test_wrong_units_and_signs(rotary: SimpleNamespace, change: Callable[[Session], Session], message: str) -> None:
    with pytest.raises(ModelError, match=message) as caught:
        build(change(rotary.measured(1, angles=FEW).session))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("factor", "message"),
    [
        (1e3, "displacement looks like millimetres"),
        (1e6, "displacement looks like micrometres"),
        (-1.0, "displacement has the opposite sign"),
        (2.0, "displacement looks like twice the change of path"),
    ],
)
def test_what_is_suspected_undoes_the_mistake(rotary: SimpleNamespace, factor: float, message: str) -> None:
    session = rotary.measured(1, angles=FEW).session
    undone = {one.what: one.session for one in suppositions(_scaled(factor)(session))}
    (what,) = (what for what in undone if what.startswith(message))
    np.testing.assert_allclose(undone[what].readings.displacement, session.readings.displacement, rtol=1e-15)


def test_two_targets_exchanged(rotary: SimpleNamespace) -> None:
    session = rotary.measured(2, angles=FEW).session
    target = _exchanged(session.readings.labels["target"].astype(str), "P", "K")
    with pytest.raises(ModelError, match="the targets 'K' and 'P' look exchanged"):
        build(session.with_readings(replace(session.readings, labels={"target": target})))


def test_a_bad_axis_is_no_mistake(rotary: SimpleNamespace) -> None:
    machine = {"random": {"rotary_translation": 1e-4, "rotary_tilt": 3e-4, "rotary_angle": 5e-4}}
    build(rotary.measured(0, machine).session)


def test_repeats_that_number_the_readings(rotary: SimpleNamespace) -> None:
    """Every run has a single reading, which says nothing: there are too few of them, and no other fault."""
    session = rotary.measured(2, angles=FEW).session
    numbered = session.with_readings(replace(session.readings, repeat=np.arange(len(session.readings))))
    with pytest.raises(ModelError, match="too few readings"):
        identify(numbered)
