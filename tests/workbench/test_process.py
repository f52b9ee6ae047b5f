# SPDX-License-Identifier: Apache-2.0
"""A calculation beside the page gives its outcome or its error, and is ended wherever it is."""

from functools import partial
from pathlib import Path

import pytest

from machine_tool_calibration.errors import CalibrationError
from machine_tool_calibration.workbench.handed_over import left
from machine_tool_calibration.workbench.models import looked_ahead
from machine_tool_calibration.workbench.process import Calculation, FaultError, warm_up
from machine_tool_calibration.workbench.state import State


def test_a_calculation_is_ended_and_its_errors_come_back(hidden: Path) -> None:
    warm_up()
    state = State()
    state.opened(hidden)()
    told: list[str] = []

    def stop(what: str, share: float) -> None:
        told.append(what)
        ahead.end()

    ahead = Calculation(partial(looked_ahead, state.subject, state.model))
    with pytest.raises(CalibrationError, match="has ended"):
        ahead.outcome(stop)
    assert told == ["what is known now"]
    with pytest.raises(CalibrationError, match="no format 'abacus'"):
        Calculation(partial(left, state.subject, state.model, "abacus")).outcome(lambda what, share: None)
    with pytest.raises(FaultError, match="AttributeError"):
        Calculation(partial(left, state.subject, None, "csv")).outcome(lambda what, share: None)
