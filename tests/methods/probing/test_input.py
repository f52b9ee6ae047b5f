# SPDX-License-Identifier: Apache-2.0
"""What is wrong with a probing session is said in one line."""

from dataclasses import replace

import numpy as np
import pytest

from machine_tool_calibration.errors import CalibrationError
from machine_tool_calibration.methods.identify import identify
from machine_tool_calibration.session.checks import check_session


def test_known_length_of_what_is_no_length(make):
    def straightness(document):
        document["known"]["EYX"] = document["known"].pop("EXX")

    with pytest.raises(CalibrationError, match=r"known: 'EYX' is not the positioning error"):
        make(straightness).identified()


def test_machine_without_x(make):
    def flat(document):
        document["machine"] |= {"chain": "w-C-b-Y-Z-t", "travel": {"y": [-0.2, 0.2]}}

    with pytest.raises(CalibrationError, match="probing needs the axes X and Y; the chain has no X"):
        make(flat).identified()


def test_too_few_touches(make):
    session = make().session
    few = session.readings.select((np.arange(len(session.readings)) % 92 < 4) & (session.readings.setup < 2))
    with pytest.raises(CalibrationError, match="too few readings"):
        identify(session.with_readings(few))


def test_x_and_y_exchanged(make):
    session = make().session
    x, y = (session.readings.columns[axis] for axis in "xy")
    readings = replace(session.readings, columns={**session.readings.columns, "x": y, "y": x})
    with pytest.raises(CalibrationError, match="the columns x and y look exchanged"):
        check_session(session.with_readings(readings))


def test_normal_that_is_no_unit_vector(make):
    def longer(document):
        document["workpiece"][3]["normal"] = [0.0, 2.0]

    with pytest.raises(CalibrationError, match=r"normal of point '3' has length 2, not 1"):
        check_session(make(longer).session)
