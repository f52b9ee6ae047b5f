# SPDX-License-Identifier: Apache-2.0
"""Small files are read without pandas, large ones by it: what comes out is the same."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from machine_tool_calibration.errors import SessionError
from machine_tool_calibration.session import table

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
    for many in (table._MANY, 0):
        monkeypatch.setattr(table, "_MANY", many)
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
