"""Every verb that takes several sessions of one machine: in text and as JSON, with effects."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from machine_tool_calibration.cli.main import run
from machine_tool_calibration.session.writer import write_session
from machine_tool_calibration.simulation import FlawSpec, SimulationSpec, TrackingPlan, simulate


@pytest.fixture(scope="module")
def sessions(tmp_path_factory: pytest.TempPathFactory) -> list[str]:
    """One machine with backlash of Y, measured on two days."""
    folder = tmp_path_factory.mktemp("days")
    spec = SimulationSpec(plan=TrackingPlan(dimension=2), seed=4, effects=(FlawSpec(id="backlash_y", size=2e-6),))
    whole = simulate(spec).session
    for repeat, name in enumerate(("monday", "tuesday")):
        readings = whole.readings.select(whole.readings.repeat == repeat)
        write_session(whole.with_readings(readings), folder / name)
    return [str(folder / "monday"), str(folder / "tuesday")]


def said(capsys: pytest.CaptureFixture[str], *words: object) -> str:
    """What a command says to people, in one line."""
    capsys.readouterr()
    assert run([str(word) for word in words]) == 0
    return " ".join(capsys.readouterr().out.split())


@pytest.mark.parametrize("effect", ["backlash_y", "linear_drift", "warmup_x"])
def test_identify_with_an_effect(sessions: list[str], effect: str, capsys: pytest.CaptureFixture[str]) -> None:
    text = said(capsys, "identify", *sessions, "--effect", effect)
    assert f"model: rigid_body (monday), rigid_body (tuesday) with {effect}" in text
    if effect == "backlash_y":
        assert "backlash_y.b" in text and "half width" in text
        assert text.index("backlash_y.b") < text.index("monday/A.x")
    if effect == "linear_drift":
        assert "monday/linear_drift.r" in text and "tuesday/linear_drift.r" in text
        assert text.index("tuesday/linear_drift.r") < text.index("monday/A.x")
    document = json.loads(said(capsys, "identify", *sessions, "--effect", effect, "--json"))
    assert document["effects"] == [effect]


def test_export_with_an_effect(sessions: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    text = said(capsys, "export", *sessions, "--effect", "backlash_y", "--format", "isg", "-o", tmp_path / "tables")
    assert "RMS compensated" in text and "backlash_y" in text
