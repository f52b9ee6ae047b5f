# SPDX-License-Identifier: Apache-2.0
"""The courses of a machine's numbers from its entries: dates, instruments, limits."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from machine_tool_calibration.errors import ModelError
from machine_tool_calibration.trends.logbook import Entry
from machine_tool_calibration.trends.statement import Size
from machine_tool_calibration.trends.trend import trend

U = 0.2e-6


def entries(
    count: int, value: Callable[[int], float], name: str = "EXX", **more: Callable[[int], object]
) -> list[Entry]:
    """A session a month; `instrument` and `model` may change."""
    instrument, model = more.get("instrument", lambda k: "L7"), more.get("model", lambda k: "free")
    rng = np.random.default_rng(3)
    return [
        Entry(
            number=k + 1,
            machine="mill",
            date=f"{2024 + k // 12}-{k % 12 + 1:02d}-05" + ("T08:00:00+02:00" if k % 2 else ""),
            instrument=str(instrument(k)),
            label=str(k),
            sha256=str(k),
            software="",
            result={"model": str(model(k)), "effects": []},
            sizes=(Size(name, value(k) + U * rng.standard_normal(), U, "m"),),
            description="",
            readings="",
        )
        for k in range(count)
    ]


def test_a_jump_has_its_dates() -> None:
    (course,) = trend(entries(20, lambda k: 5e-6 + 4e-6 * (k >= 12))).courses
    assert course.kind == "jump" and course.alarm
    assert course.began == ("2024-12-05T08:00:00+02:00", "2025-01-05")
    assert course.explanation is not None and abs(course.explanation.change - 4e-6) < 4 * course.explanation.u


def test_another_instrument_or_model_is_no_alarm() -> None:
    def step(k: int) -> float:
        return 5e-6 + 4e-6 * (k >= 12)

    found = trend(entries(20, step, instrument=lambda k: "L7" if k < 12 else "L9"))
    (course,) = found.courses
    assert course.kind == "instrument" and not found.alarms and course.ways == ("L7", "L9")
    assert course.explanation is not None and abs(course.explanation.step - 4e-6) < 4 * course.explanation.u_step
    (course,) = trend(entries(20, step, model=lambda k: "free" if k < 12 else "rigid_body")).courses
    assert course.kind == "instrument" and course.ways == ("L7 (free)", "L7 (rigid_body)")


@pytest.mark.parametrize(
    ("name", "value", "limit", "state"),
    [
        ("EXX", 5e-6, 4e-6, "exceeded"),
        ("EXX", 5e-6, 5e-6, "open"),
        ("EXX", 5e-6, 6e-6, "kept"),
        ("B_mean_X", -5e-6, 4e-6, "exceeded"),
        ("B_mean_X", -5e-6, 6e-6, "kept"),
    ],
)
def test_a_limit_is_exceeded_where_the_uncertainty_does_not_explain_it(
    name: str, value: float, limit: float, state: str
) -> None:
    found = trend(entries(6, lambda k: value, name), {name: limit})
    (course,) = found.courses
    assert course.against_limit == state
    assert bool(found.alarms) == (state == "exceeded")


def test_few_sessions_say_nothing_and_an_unknown_limit_is_refused() -> None:
    found = trend(entries(3, lambda k: 1e-6 * 10**k))
    assert found.courses[0].kind == "few" and not found.alarms
    with pytest.raises(ModelError, match="did you mean 'EXX'"):
        trend(entries(3, lambda k: 5e-6), {"EXY": 1e-6})
    with pytest.raises(ModelError, match="EAX is in m: limits are for errors in m and squareness in rad"):
        trend(entries(3, lambda k: 5e-6, "EAX"), {"EAX": 1e-6})


def test_alarms_come_first_and_a_suspicion_is_none() -> None:
    one, two, three = (
        entries(20, lambda k: 5e-6, "EXX"),
        entries(20, lambda k: 5e-6 + 0.35e-6 * (k >= 10), "EYY"),
        entries(20, lambda k: 5e-6 + 3e-6 * (k >= 10), "EZZ"),
    )
    joined = [replace(a, sizes=(*a.sizes, *b.sizes, *c.sizes)) for a, b, c in zip(one, two, three, strict=True)]
    found = trend(joined, {"EXX": 1e-6})
    assert [c.name for c in found.courses][2] == "EYY" and {c.name for c in found.alarms} == {"EXX", "EZZ"}
    suspected = found.courses[2]
    assert suspected.suspected and suspected.kind == "jump" and not suspected.alarm
    assert not any(c.suspected for c in found.alarms)
