# SPDX-License-Identifier: Apache-2.0
"""Steps of probing procedures."""

from pathlib import Path

import numpy as np
import pytest
import yaml

from machine_tool_calibration.errors import SessionError
from machine_tool_calibration.procedure import parse_procedure, plan, read_procedure
from machine_tool_calibration.procedure.workpiece import read_workpiece

CONFIG = Path(__file__).parents[2] / "config"


def document(**changes):
    points = [(0.05, 0.01, 1.0, 0.0), (0.0, 0.03, 0.0, -1.0), (-0.05, 0.0, -0.6, 0.8)]
    content = {
        "format": "mtcal-procedure/1",
        "session": {
            "method": "probing",
            "machine": {
                "chain": "w-C-b-Y-X-Z-t",
                "rotation_sign": -1,
                "travel": {"x": [-0.1, 0.1], "y": [-0.1, 0.1], "z": [-0.05, 0.05]},
            },
            "repeats": 2,
            "probe": {"stylus_diameter": 0.006},
            "workpiece": [{"id": k, "position": p[:2], "normal": p[2:]} for k, p in enumerate(points)],
            "setups": [{"id": "C1", "c": 0.0}, {"id": "C2", "c": 1.2}, {"id": "C3", "c": 0.4}],
            "standard_uncertainty": {"displacement": 1e-6},
        },
        "path": {"points": [{"z": -0.01}]},
        "motion": {"approach": 0.004},
    }
    content["session"].update(changes.pop("session", {}))
    content.update(changes)
    return content


def steps(**changes):
    return plan(parse_procedure(yaml.safe_dump(document(**changes)), "procedure")).steps


def test_every_point_at_every_angle():
    found = steps()
    assert len(found) == 3 * 2 * 3
    assert [s.setup for s in found] == ["C1"] * 6 + ["C2"] * 6 + ["C3"] * 6
    # every second repetition runs backwards
    assert [s.target for s in found[:6]] == [0, 1, 2, 2, 1, 0]
    assert not any(s.datum or s.aim for s in found)


def test_touches_begin_off_the_surface_and_come_from_above():
    found = steps()
    first = found[0]
    assert first.position == pytest.approx({"x": 0.057, "y": 0.01, "c": 0.0, "z": -0.01})
    assert first.via == ({**first.position, "z": 0.05},)
    second = found[1]
    assert second.via == ({**first.position, "z": 0.05}, {**second.position, "z": 0.05})


def test_direction_is_that_of_the_approach():
    found = steps()
    for step in found:
        x, y = [(1.0, 0.0), (0.0, -1.0), (-0.6, 0.8)][step.target]
        c, s = np.cos(step.position["c"]), np.sin(step.position["c"])
        normal = np.array([c * x + s * y, -s * x + c * y])  # clockwise
        for axis, component in zip("xy", normal, strict=True):
            if abs(component) > 1e-6:
                assert step.direction[axis] == -np.sign(component)
    # point 1 faces -Y at C = 0: X last moved from point 0's place to the left
    assert found[1].direction["x"] == -1
    assert [found[k].direction["c"] for k in (0, 6, 12)] == [1, 1, -1]


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"path": {"points": [{"x": 0.0}]}}, "says only where the other axes stand"),
        ({"path": {"grid": {"z": [0.0, 0.1]}}}, "says only where the other axes stand"),
        ({"motion": {"approach": 0.0}}, "must be positive"),
        ({"motion": {"approach": 0.06}}, "point '0' is touched from x = 0.113, outside the travel -0.1 to 0.1"),
    ],
)
def test_refused(changes, message):
    with pytest.raises(SessionError, match=message):
        steps(**changes)


@pytest.mark.parametrize(("name", "part", "count"), [("cross", "cross_pocket", 92), ("pins", "pins", 88)])
def test_case_studies(name, part, count):
    procedure = read_procedure(CONFIG / "procedures" / f"probing_{name}.yaml")
    assert procedure.session.workpiece == read_workpiece(CONFIG / "workpieces" / f"{part}.yaml")
    angles = np.degrees([setup.c for setup in procedure.session.setups])
    expected = {"cross": [0, 75, 130, 210], "pins": [0, 31, 83, 137, 191, 227, 257, 313]}[name]
    np.testing.assert_allclose(angles, expected)
    planned = plan(procedure)
    assert len(planned.steps) == count * len(angles)
    # the paper: about 15 minutes at each angle
    assert 1 < planned.duration / len(angles) / 60 < 20
