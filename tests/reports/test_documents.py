# SPDX-License-Identifier: Apache-2.0
import json
from dataclasses import dataclass
from datetime import UTC, datetime
from enum import Enum
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import BaseModel

from machine_tool_calibration.reports.documents import plain, to_json


class Colour(Enum):
    RED = "red"


@dataclass(frozen=True)
class Point:
    x: float
    name: str


class Record(BaseModel):
    value: float


def refuse(constant: str) -> None:
    raise AssertionError(f"{constant} is no JSON")


@pytest.mark.parametrize(
    ("value", "expected"),
    [
        (float("nan"), None),
        (-float("inf"), None),
        (np.float64("nan"), None),
        (np.float32(0.5), 0.5),
        (np.int64(3), 3),
        (np.bool_(True), True),
        (np.array([[1.0, np.nan], [np.inf, 2.0]]), [[1.0, None], [None, 2.0]]),
        (np.array(["a", "b"]), ["a", "b"]),
        (np.array([], dtype=float), []),
        ((1, {"k": (float("nan"),)}), [1, {"k": [None]}]),
        ({"b", "a"}, ["a", "b"]),
        (Point(float("inf"), "p"), {"x": None, "name": "p"}),
        (Record(value=float("nan")), {"value": None}),
        (Colour.RED, "red"),
        (Path("a/b"), "a/b"),
        (datetime(2025, 1, 2, tzinfo=UTC), "2025-01-02T00:00:00+00:00"),
        ({1: True, "µ": None}, {"1": True, "µ": None}),
    ],
)
def test_plain_types(value: object, expected: object) -> None:
    assert plain(value) == expected
    assert json.loads(to_json(value), parse_constant=refuse) == expected


def test_booleans_stay_booleans() -> None:
    assert plain(True) is True
    assert plain(np.True_) is True


def test_an_unknown_type_is_an_error_and_not_text() -> None:
    with pytest.raises(TypeError, match="object"):
        to_json({"a": object()})


def trees() -> st.SearchStrategy[object]:
    leaves = st.none() | st.booleans() | st.integers() | st.floats() | st.text()
    return st.recursive(leaves, lambda inner: st.lists(inner) | st.dictionaries(st.text(), inner), max_leaves=20)


@given(trees())
def test_whatever_is_written_is_strict_json(tree: object) -> None:
    json.loads(to_json(tree), parse_constant=refuse)


@given(st.floats(allow_nan=False, allow_infinity=False))
def test_numbers_come_back_to_the_last_bit(number: float) -> None:
    assert json.loads(to_json([number, np.float64(number)])) == [number, number]
