# SPDX-License-Identifier: Apache-2.0
"""The JSON document of a diagnosis: the contract's keys, honest numbers, and no cause where none is known.
Plain values of every type as strict JSON.
"""

import json
import math
from dataclasses import dataclass
from datetime import UTC, datetime
from enum import Enum
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import BaseModel

from machine_tool_calibration.diagnosis.diagnose import Diagnosis
from machine_tool_calibration.json_types import plain
from machine_tool_calibration.methods.identify import identify
from machine_tool_calibration.reports.diagnosis_document import diagnosis_document
from machine_tool_calibration.reports.documents import to_json
from machine_tool_calibration.simulation import simulate

from .measured import SPECS, concluded

VERDICTS = ("adequate", "missing_effect", "unexplained", "look-alike", "outliers")
KEYS = {
    "format": str,
    "verdict": str,
    "noise": dict,
    "candidates": list,
    "alias_groups": list,
    "separate_by": list,
    "absorbed": list,
    "structure": list,
    "outliers": list,
}
CANDIDATE = {
    "effect", "probability", "p_value", "delta_bic", "rms_before", "rms_after", "cross_validated_gain", "parameters",
    "map_change_rms",
}  # fmt: skip


@cache
def found(verdict: str) -> tuple[Diagnosis, dict[str, Any]]:
    diagnosis, then = concluded(verdict)
    return diagnosis, diagnosis_document(diagnosis, then.advice, then.changes)


def numbers(value: Any) -> list[float]:
    if isinstance(value, dict):
        return [n for entry in value.values() for n in numbers(entry)]
    if isinstance(value, list):
        return [n for entry in value for n in numbers(entry)]
    return [float(value)] if isinstance(value, int | float) else []


@pytest.mark.parametrize("verdict", VERDICTS)
def test_the_contract(verdict: str) -> None:
    _, document = found(verdict)
    text = json.dumps(document, allow_nan=False)
    assert json.loads(text) == document
    assert document["format"] == "mtcal-diagnosis/1"
    assert document["verdict"] == {"look-alike": "missing_effect"}.get(verdict, verdict)
    for key, kind in KEYS.items():
        assert isinstance(document[key], kind), key
    assert document["noise"]["declared"] > 0
    assert document["noise"]["from_repeats"] is None or document["noise"]["from_repeats"] > 0
    assert all(math.isfinite(n) for n in numbers(document))
    assert document["candidates"]
    for candidate in document["candidates"]:
        assert set(candidate) >= CANDIDATE
        assert 0.0 <= candidate["probability"] <= 1.0
        assert 0.0 <= candidate["p_value"] <= 1.0
        assert candidate["rms_after"] <= candidate["rms_before"] * 1.001
        for parameter in candidate["parameters"]:
            assert set(parameter) == {"name", "value", "standard_uncertainty", "unit"}
            assert parameter["name"].startswith(f"{candidate['effect']}.")
    told = document["sets"]
    assert sum(entry["probability"] for entry in told) <= 1.0 + 1e-9
    for candidate in document["candidates"]:
        # An effect is missing in every set that holds it, told or not.
        with_it = sum(entry["probability"] for entry in told if candidate["effect"] in entry["effects"])
        assert with_it <= candidate["probability"] + 1e-9
        assert candidate["probability"] + document["probabilities"]["nothing"] <= 1.0 + 1e-9
    names = {c["effect"] for c in document["candidates"]}
    for group in document["alias_groups"]:
        assert len(group) > 1
        assert set(group) <= names
    for entry in document["separate_by"]:
        assert len(entry["effects"]) > 1
        assert entry["measure"]
    for entry in document["absorbed"]:
        assert set(entry) == {"effect", "by"}
        assert entry["by"]
        assert entry["effect"] not in names
    for entry in [*document["structure"], *document["structure_left"]]:
        assert {"covariate", "shape", "p_value"} <= set(entry)
    looked_for = names | {a["effect"] for a in document["absorbed"]}
    assert not looked_for & {e["effect"] for e in document["excluded"]}


@pytest.mark.parametrize("verdict", VERDICTS)
def test_candidates_come_best_first_after_those_accepted(verdict: str) -> None:
    _, document = found(verdict)
    names = [c["effect"] for c in document["candidates"]]
    accepted = document["accepted"]
    assert names[: len(accepted)] == accepted
    assert len(set(names)) == len(names)
    rest = [c["probability"] for c in document["candidates"][len(accepted) :]]
    assert rest == pytest.approx(sorted(rest, reverse=True), rel=1e-6)


def test_the_effect_that_was_hidden_stands_first_with_its_size() -> None:
    _, document = found("missing_effect")
    assert document["accepted"] == ["backlash_y"]
    first = document["candidates"][0]
    assert first["probability"] > 0.9
    # The same with a part that varies along the axis contains it, and is no alternative to it.
    assert not any({"backlash_y", "lost_motion_y"} <= set(group) for group in document["alias_groups"])
    assert first["p_value"] < 1e-6
    assert first["delta_bic"] < -50
    # Every way of leaving readings out tells for it, by far more than any chance, and so does each of its parts.
    assert {"setups", "blocks of places"} <= {entry["left_out"] for entry in first["predicts"]}
    for entry in first["predicts"]:
        assert sum(entry["parts"]) > 20.0
        assert min(entry["parts"]) > 0.0
        assert entry["not_left_out"] == 0 and not entry["speaks_against"]
    assert 0.0 < first["cross_validated_gain"] == min(entry["gain"] for entry in first["predicts"])
    assert first["rms_after"] < 0.5 * first["rms_before"]
    (size,) = first["parameters"]
    assert size["unit"] == "m"
    true = simulate(SPECS["missing_effect"]).truth.effects[0].size
    assert abs(size["value"] - true) < 4 * size["standard_uncertainty"]


def test_parameters_and_map_change_are_those_of_an_identification() -> None:
    diagnosis, document = found("missing_effect")
    first = document["candidates"][0]
    without = identify(diagnosis.chosen.sessions[0])
    with_it = identify(diagnosis.chosen.sessions[0], effects=["backlash_y"])
    expected = {p.name: p for p in with_it.parameters}
    for parameter in first["parameters"]:
        assert parameter["value"] == pytest.approx(expected[parameter["name"]].value, rel=1e-6)
        assert parameter["standard_uncertainty"] == pytest.approx(
            expected[parameter["name"]].standard_uncertainty, rel=1e-6
        )
    change = with_it.error_map.error[:, :2] - without.error_map.error[:, :2]
    assert first["map_change_rms"] == pytest.approx(np.sqrt(np.mean(np.sum(change**2, axis=1))), rel=1e-4)
    assert first["rms_after"] == pytest.approx(with_it.rms_residual, rel=1e-6)
    assert first["rms_before"] == pytest.approx(without.rms_residual, rel=1e-6)


def test_a_look_alike_of_the_effect_found_is_in_its_group_and_not_called_absorbed() -> None:
    _, document = found("look-alike")
    pair = {"pointer_radial_error", "retroreflector_form"}
    assert document["accepted"][0] in pair
    assert any(pair <= set(group) for group in document["alias_groups"])
    assert not pair & {a["effect"] for a in document["absorbed"]}
    # Their columns are the same: nothing but the sizes that occur distinguishes them, and by these how many waves there
    # are, so that neither is ruled out.
    one, other = (next(c for c in document["candidates"] if c["effect"] == name) for name in sorted(pair))
    assert max(one["delta_bic"], other["delta_bic"]) < -50.0
    assert one["rms_after"] == pytest.approx(other["rms_after"], rel=0.02)
    assert min(one["probability"], other["probability"]) > 0.3
    assert one["probability"] + other["probability"] > 0.95


def test_unexplained_names_no_cause() -> None:
    diagnosis, document = found("unexplained")
    assert document["accepted"] == []
    assert document["structure"]
    assert document["structure"][0]["p_value"] < 0.02
    assert document["structure"][0]["covariate"]
    assert max(c["probability"] for c in document["candidates"]) < 0.2
    assert diagnosis.verdict == "unexplained"


def test_smallest_detectable_sizes_are_sizes_that_occur_or_null() -> None:
    diagnosis, document = found("adequate")
    entries = {entry["effect"]: entry["smallest"] for entry in document["detectable"]}
    assert entries["backlash_y"][0]["value"] < 5e-7
    for sizes in entries.values():
        for size in sizes:
            assert size["value"] is None or size["value"] > 0
    assert set(entries) == {f.name for f in diagnosis.search.findings if f.rank}


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
