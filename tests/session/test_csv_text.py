# SPDX-License-Identifier: Apache-2.0
"""Tables as CSV text hold the fields that pandas writes, and numbers come back to the last bit."""

import csv
import io
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st

from machine_tool_calibration.errors import SessionError
from machine_tool_calibration.session import csv_text, table
from machine_tool_calibration.session.csv_text import write_csv


def written(frame: pd.DataFrame, *, header: bool = True) -> str:
    stream = io.StringIO()
    write_csv(frame, stream, header=header)
    return stream.getvalue()


def same_fields(frame: pd.DataFrame, *, header: bool = True) -> bool:
    """Whether every field is what pandas writes: the same number to the last bit, or the same text."""
    text = written(frame, header=header)
    by_pandas = frame.to_csv(index=False, header=header, lineterminator="\n")
    assert not text or text.endswith("\n")
    ours, theirs = (list(csv.reader(io.StringIO(one, newline=""))) for one in (text, by_pandas))
    assert len(ours) == len(theirs)
    numeric = [column.dtype.kind in "fiu" for _, column in frame.items()]
    return all(
        bits(a) == bits(b) if number and a and b and (row or not header) else a == b
        for row, (mine, other) in enumerate(zip(ours, theirs, strict=True))
        for number, a, b in zip(numeric, mine, other, strict=True)
    )


def bits(field: str) -> bytes:
    return np.float64(field).tobytes()


def numbers(count: int, seed: int) -> dict[str, np.ndarray]:
    """Numbers of every size and form."""
    rng = np.random.default_rng(seed)
    anything = rng.integers(0, 2**64, count, dtype=np.uint64).view(np.float64)
    return {
        "any": np.where(np.isnan(anything), 0.0, anything),
        "size": 10 ** rng.uniform(-12, 20, count) * rng.choice([-1, 1], count),
        "short": np.round(rng.normal(size=count), 3),
        "half": rng.integers(-5, 5, count) * 0.5,
        "zero": np.where(rng.random(count) < 0.5, -0.0, 0.0),
        "binary": np.ldexp(rng.integers(1, 2**53, count).astype(float), rng.integers(-70, 5, count)),
        "missing": np.where(rng.random(count) < 0.5, np.nan, rng.normal(size=count)),
        "infinite": rng.choice([np.inf, -np.inf, 0.1], count),
        "none": np.full(count, np.nan),
        "whole": rng.integers(-9, 9, count),
    }


@pytest.mark.long
def test_the_fields_of_pandas() -> None:
    rng = np.random.default_rng(1)
    count = 7_000
    columns = numbers(count, 0) | {
        "text": rng.choice(["a", "b,c", 'd"e', "", "line\nfeed", "é x", " lead", "1.5"], count),
        "object": np.array(rng.choice(["x", None, "y z"], count), dtype=object),
        "truth": rng.random(count) < 0.5,
    }
    frame = pd.DataFrame(columns)
    assert same_fields(frame)


def test_small_tables() -> None:
    for frame in (
        pd.DataFrame({"a": [], "b": []}),
        pd.DataFrame({"a": [1.5, np.nan]}),
        pd.DataFrame({"a": ["", "x"]}),
        pd.DataFrame({"a,b": [1e-7], 'c"d': [""]}),
        pd.DataFrame({"a": [None, None], "b": [1, 2]}),
    ):
        assert same_fields(frame)
        assert same_fields(frame, header=False)


def test_without_arrow(monkeypatch: pytest.MonkeyPatch) -> None:
    frame = pd.DataFrame({"a": [1e-7, np.nan], "b": ["x", "y,z"]})
    monkeypatch.setattr(csv_text, "arrow", None)
    assert written(frame) == 'a,b\n1e-7,x\n,"y,z"\n'


def test_numbers_have_the_same_text_without_arrow(monkeypatch: pytest.MonkeyPatch) -> None:
    """The sum of a measurement's data is of its text, and must not depend on what is installed."""
    rng, sizes = np.random.default_rng(0), 10.0 ** np.random.default_rng(1).integers(-12, 13, 500)
    edges = [0.0, -0.0, 1.0, -1.0, 1e-6, 9.999e-7, 1e-7, 9999999999.5, 1e10, 1e15, 1e22, 5e-324, 1.7e308, np.nan]
    values = np.array([*edges, *(rng.normal(size=500) * sizes)])
    frame = pd.DataFrame({"a": values, "n": np.arange(len(values)), "t": ["x"] * len(values)})
    by_arrow = written(frame)
    monkeypatch.setattr(csv_text, "arrow", None)
    assert written(frame) == by_arrow


# Not a carriage return, which pandas leaves without quotes, so that a reader would end the line there.
TEXT = st.text(st.characters(exclude_characters="\r", codec="utf-8"), max_size=5)


@pytest.mark.long
@given(st.lists(st.tuples(st.floats(allow_nan=False), TEXT), min_size=1, max_size=8))
def test_any_row(rows: list[tuple[float, str]]) -> None:
    frame = pd.DataFrame(rows, columns=["number", "text"])
    assert same_fields(frame)


ROWS = (
    '0, A ,1e-3,"a, b",+.5,1',
    "",
    "1,B,,nan,NaN,",
    '2,"C ""q""", 5.,fine,-1e-9,3',
    "3,nan,123456789012345678901,,0.1,Nan",
)
HEAD = "time,setup,x,note,displacement,own"


def read_both(path: Path, text: str, monkeypatch: pytest.MonkeyPatch) -> list[table.Table | str]:
    path.write_bytes(text.encode())
    out: list[table.Table | str] = []
    for many in (table._PANDAS_ROWS, 0):
        monkeypatch.setattr(table, "_PANDAS_ROWS", many)
        try:
            out.append(table.read_table(path))
        except SessionError as error:
            out.append(str(error))
    return out


@pytest.mark.parametrize("start", ["", "\ufeff", "\n"])
@pytest.mark.parametrize("end", ["\n", "\r\n"])
def test_the_same_columns(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, start: str, end: str) -> None:
    text = start + end.join((HEAD, *ROWS)) + end
    small, large = read_both(tmp_path / "observations.csv", text, monkeypatch)
    assert isinstance(small, table.Table) and isinstance(large, table.Table)
    assert list(small.numbers) == list(large.numbers) == ["time", "x", "displacement", "own"]
    assert list(small.labels) == list(large.labels) == ["setup", "note"]
    for name, values in small.numbers.items():
        assert np.array_equal(values, large.numbers[name], equal_nan=True)
    for name, labels in small.labels.items():
        assert labels.tolist() == large.labels[name].tolist()
    assert small.labels["setup"].tolist() == ["A", "B", 'C "q"', ""]


@pytest.mark.parametrize("field", ["1_000", "0x10", "'1'", '"1,5"', "inf", "-Infinity", "1e400", "True", "nan 1", "١"])
def test_the_same_refusals(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, field: str) -> None:
    text = "\n".join((HEAD, *ROWS, f"4,A,{field},x,0.1,5")) + "\n"
    small, large = read_both(tmp_path / "observations.csv", text, monkeypatch)
    assert isinstance(small, str)
    assert small == large
