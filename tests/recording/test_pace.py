# SPDX-License-Identifier: Apache-2.0
from machine_tool_calibration.nodes.player import Pace

SECOND = 1_000_000_000


def test_runs_at_its_rate_and_stands() -> None:
    pace = Pace(2.0, 100, 7 * SECOND)
    assert pace.position(8 * SECOND) == 100 + 2 * SECOND
    assert pace.is_due(100 + 2 * SECOND, 8 * SECOND) and not pace.is_due(101 + 2 * SECOND, 8 * SECOND)
    pace.pause(8 * SECOND)
    assert pace.position(50 * SECOND) == 100 + 2 * SECOND and not pace.is_due(0, 50 * SECOND)
    pace.resume(50 * SECOND)
    pace.resume(51 * SECOND)  # once more changes nothing
    assert pace.position(52 * SECOND) == 100 + 6 * SECOND


def test_can_be_set_while_it_stands() -> None:
    pace = Pace(0.5, 0, 0, paused=True)
    pace.set(3 * SECOND, SECOND)
    pace.resume(10 * SECOND)
    assert pace.position(12 * SECOND) == 4 * SECOND


def test_without_a_rate_everything_is_due() -> None:
    pace = Pace(0.0, 5, 0)
    assert pace.is_due(10**18, 1) and pace.position(10**12) == 5
    pace.pause(2)
    assert not pace.is_due(0, 3)


def test_nothing_is_due_before_it_begins() -> None:
    for rate in (0.0, 2.0):
        pace = Pace(rate, 100, 10 * SECOND)
        assert pace.position(9 * SECOND) == 100 and not pace.is_due(100, 9 * SECOND)
        assert pace.is_due(100, 10 * SECOND)
