# SPDX-License-Identifier: Apache-2.0
"""What `mtcal workbench` says before it serves anything."""

import sys
from pathlib import Path

import pytest

from machine_tool_calibration.cli.main import run


def test_without_its_libraries_it_says_what_to_install(
    hidden: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for name in [name for name in sys.modules if name.startswith("machine_tool_calibration.workbench")]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "panel", None)
    assert run(["workbench", "--no-browser", str(hidden)]) == 1
    said = capsys.readouterr().err
    assert said.count("\n") == 1 and "pip install 'machine_tool_calibration[workbench]'" in said


def test_a_measurement_that_is_not_there_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["workbench", "--no-browser", str(tmp_path / "nothing")]) == 1
    assert "no such file or folder" in capsys.readouterr().err


def test_beside_a_graph_no_measurement_is_needed(monkeypatch: pytest.MonkeyPatch) -> None:
    from machine_tool_calibration.workbench import server

    asked: list[tuple[object, dict[str, object]]] = []
    monkeypatch.setattr(server, "serve", lambda targets, *more, **named: asked.append((targets, named)))
    assert run(["workbench", "--live", "--namespace", "cell_1", "--domain-id", "7", "--no-browser"]) == 0
    ((targets, named),) = asked
    assert targets == ()
    assert {name: named[name] for name in ("live", "namespace", "domain")} == {
        "live": True, "namespace": "cell_1", "domain": 7,
    }  # fmt: skip
