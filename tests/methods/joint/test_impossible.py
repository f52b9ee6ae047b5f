# SPDX-License-Identifier: Apache-2.0
"""Several sessions are refused as one is where what comes out cannot be."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from machine_tool_calibration.errors import ModelError
from machine_tool_calibration.methods.fitted import FitRequest
from machine_tool_calibration.methods.identify import identify_sessions
from machine_tool_calibration.session.session import Session


def _with(session: Session, **said: object) -> Session:
    return replace(session, description=session.description.model_copy(update=said))


def test_a_station_stated_wrong_by_centimetres(several: SimpleNamespace) -> None:
    tracker, run = (several.measured(name, 1, several.machine(1)).session for name in ("tracker", "run"))
    first, *rest = tracker.description.setups
    wrong = first.model_copy(update={"position": tuple(np.add(first.position, (0.05, 0.0, 0.0)))})
    moved = _with(tracker, setups=[wrong, *rest])
    with pytest.raises(ModelError, match=f"station '{first.id}' is found 50 mm off") as caught:
        identify_sessions(FitRequest([moved, run], ["tracker", "run"], keep_all=True))
    assert "trust_units: true" in str(caught.value)
    identify_sessions(FitRequest([_with(moved, trust_units=True), run], ["tracker", "run"], keep_all=True))


def test_positions_that_are_a_tenth_too_large(several: SimpleNamespace) -> None:
    tracker, run = (several.measured(name, 1, several.machine(1)).session for name in ("tracker", "run"))
    columns = {**tracker.readings.columns, "x": 1.1 * tracker.readings.columns["x"]}
    stretched = tracker.with_readings(replace(tracker.readings, columns=columns))
    with pytest.raises(ModelError, match=r"tracker, run: the position error along x .* which no machine has"):
        identify_sessions(FitRequest([stretched, run], ["tracker", "run"], keep_all=True))
