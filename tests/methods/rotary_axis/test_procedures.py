# SPDX-License-Identifier: Apache-2.0
"""The procedures that come with the package say what the method needs."""

from pathlib import Path

import numpy as np
import pytest

from machine_tool_calibration.machine.chain import Chain
from machine_tool_calibration.procedure.description import Path as Targets
from machine_tool_calibration.procedure.description import Spread, read_procedure
from machine_tool_calibration.session.description import Direct, RotaryAxis

CONFIG = Path(__file__).parents[3] / "config" / "procedures"


def _positions(path: Targets, axis: str) -> np.ndarray:
    if path.points is not None:
        return np.array([point[axis] for point in path.points])
    entry = (path.grid or {})[axis]
    return np.array(entry.values() if isinstance(entry, Spread) else entry)


@pytest.mark.parametrize("name", ["rotary_axis", "rotary_axis_one_way"])
def test_rotary_axis(name: str) -> None:
    procedure = read_procedure(CONFIG / f"{name}.yaml")
    session = procedure.session
    assert procedure.name == name
    assert isinstance(session, RotaryAxis)
    angles = _positions(procedure.path, "c")
    low, high = session.machine.travel["c"]
    assert low <= angles.min() - procedure.motion.approach and angles.max() + procedure.motion.approach <= high
    assert len(session.setups) == 4 and len(session.targets) == 3
    distinct = len(np.unique(np.round(angles, 9)))
    # six motions an angle, stations, targets and zeros of the runs, less the twelve that the datum fixes
    assert distinct * 12 > 6 * distinct + 12 + 9 + 12 - 12
    np.testing.assert_allclose(np.diff(angles), np.radians(20.0))
    assert procedure.path.both_ways == (name == "rotary_axis")


def test_iso230_2() -> None:
    procedure = read_procedure(CONFIG / "direct_iso230_2.yaml")
    session = procedure.session
    assert isinstance(session, Direct)
    assert session.terms == ("EXX",) and session.repeats == 5
    assert "X" in Chain.parse(session.machine.chain).linear
    positions = _positions(procedure.path, "x")
    low, high = session.machine.travel["x"]
    assert low <= positions.min() - procedure.motion.approach and positions.max() + procedure.motion.approach <= high
    # Not all intervals are alike: a periodic error of the scale would go unseen.
    assert np.ptp(np.diff(positions)) > 1e-4
