# SPDX-License-Identifier: Apache-2.0
"""What is wrong with a probing session is said in one line."""

import numpy as np
import pytest

from machine_tool_calibration.errors import CalibrationError
from machine_tool_calibration.methods.identify import identify
from machine_tool_calibration.session.checks import check_session
from machine_tool_calibration.session.session import Readings


def change(session, **columns):
    readings = session.readings
    content = {**vars(readings)}
    content["columns"] = {**readings.columns, **columns}
    return session.with_readings(Readings(**content))


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


def test_unknown_point(make):
    session = make().session
    labels = {"point": np.where(session.readings.row == 5, "nowhere", session.readings.labels["point"])}
    readings = Readings(**{**vars(session.readings), "labels": labels})
    with pytest.raises(CalibrationError, match="reading 5: the workpiece has no point 'nowhere'"):
        identify(session.with_readings(readings))


def test_too_few_touches(make):
    session = make().session
    few = session.readings.select((np.arange(len(session.readings)) % 92 < 4) & (session.readings.setup < 2))
    with pytest.raises(CalibrationError, match="too few readings"):
        identify(session.with_readings(few))


@pytest.mark.parametrize(
    ("what", "columns", "message"),
    [
        ("degrees", lambda c: {"c": np.degrees(c["c"])}, "degrees"),
        ("millimetres", lambda c: {"x": 1e3 * c["x"], "y": 1e3 * c["y"]}, "millimetres"),
        ("sense of rotation", lambda c: {"y": -c["y"]}, "rotation_sign"),
    ],
)
def test_suspected_mistakes(make, what, columns, message):
    session = make(part="cam").session
    if what == "sense of rotation":
        # positions as on a table that turns the other way
        other = make(part="cam", sign=1).session
        changed = change(session, x=other.readings.columns["x"], y=other.readings.columns["y"])
    else:
        changed = change(session, **columns(session.readings.columns))
    with pytest.raises(CalibrationError, match=message) as caught:
        check_session(changed)
    assert "\n" not in str(caught.value)


def test_normal_that_is_no_unit_vector(make):
    def longer(document):
        document["workpiece"][3]["normal"] = [0.0, 2.0]

    with pytest.raises(CalibrationError, match=r"normal of point '3' has length 2, not 1"):
        check_session(make(longer).session)
