"""`mtcal export` as it is called."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from machine_tool_calibration.cli.main import run

SESSION = Path(__file__).parents[1] / "data" / "tracking_2d"


def test_json_names_files_and_preview(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = tmp_path / "new" / "tables"
    assert run(["export", str(SESSION), "--format", "isg", "-o", str(folder), "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert document["files"] == ["compensation.csv"] and (folder / "compensation.csv").is_file()
    assert document["model"] == "rigid_body" and "EXX" in document["tables"] and document["worse"] is False
    length = document["preview"][-1]
    assert length["name"] == "length" and length["rms_after"] < 0.01 * length["rms_before"]


def test_people_see_before_and_after(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["export", str(SESSION), "--format", "linuxcnc", "-o", str(tmp_path)]) == 0
    shown = capsys.readouterr()
    assert "RMS compensated" in shown.out and "x.comp" in shown.out
    assert "not determined: EZX" in shown.err


def test_nothing_is_overwritten(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "compensation.json").write_text("mine")
    assert run(["export", str(SESSION), "--format", "json", "-o", str(tmp_path)]) == 1
    assert "is there already" in capsys.readouterr().err
    assert (tmp_path / "compensation.json").read_text() == "mine"


def test_what_has_no_tables_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = tmp_path / "none"
    assert run(["export", str(SESSION), "--format", "csv", "--model", "free", "-o", str(folder)]) == 1
    assert capsys.readouterr().err.count("\n") == 1
    assert not folder.exists()
