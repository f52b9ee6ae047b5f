# SPDX-License-Identifier: Apache-2.0
"""`mtcal diagnose` as it is called."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

import pytest

from machine_tool_calibration.cli.main import run
from machine_tool_calibration.session.folder import write_session
from machine_tool_calibration.simulation import PRESETS, FlawSpec, SimulationSpec, simulate

pytestmark = pytest.mark.usefixtures("found_once")


@pytest.fixture(scope="module")
def hidden(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    folder = tmp_path_factory.mktemp("diagnose") / "hidden"
    spec = SimulationSpec(plan=PRESETS["tracking_2d"], seed=77, effects=(FlawSpec(id="backlash_y", size=1.5e-6),))
    write_session(simulate(spec).session, folder)
    yield str(folder)


def test_one_document(hidden: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["diagnose", hidden, "--json"]) == 0
    shown = capsys.readouterr()
    document = json.loads(shown.out)
    assert document["format"] == "mtcal-diagnosis/1"
    assert document["accepted"] == ["backlash_y"]
    assert shown.err == ""


def test_people_read_the_verdict_first(hidden: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["diagnose", hidden]) == 0
    out = capsys.readouterr().out
    assert out.splitlines()[0] == "The model lacks backlash of Y (backlash_y)."
    assert len(out.splitlines()) <= 24  # one screen: the verdict, the effects, the next step
    assert "b = 1.5" in out and "Next: `mtcal improve` adds backlash_y" in out
    assert run(["diagnose", hidden, "--details"]) == 0
    out = capsys.readouterr().out
    assert out.splitlines()[0] == "The model lacks backlash of Y (backlash_y)."
    for title in (
        "Effects looked for",
        "Confounded effects",
        "Smallest size",
        "not looked for",
        "the map holds already",
        "taken for",
    ):
        assert title in out
    assert max(map(len, out.splitlines())) <= 120
    assert "\x1b" not in out


def test_pictures_and_numbers_on_request(hidden: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = tmp_path / "new" / "pictures"
    assert run(["diagnose", hidden, "-o", str(folder)]) == 0
    assert (folder / "diagnosis.png").read_bytes().startswith(b"\x89PNG")
    lines = (folder / "candidates.csv").read_text().splitlines()
    lines = [line for line in lines if not line.startswith("#")]
    assert lines[0].startswith("effect,probability,p_value,delta_bic")
    assert lines[1].startswith("backlash_y,")
    assert "wrote" in capsys.readouterr().err


def test_an_effect_that_is_in_the_model(hidden: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["diagnose", hidden, "--effect", "backlash_y", "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert document["verdict"] == "adequate"
    assert document["fit"]["before"]["effects"] == ["backlash_y"]


def test_an_effect_of_ones_own_is_looked_for(hidden: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    own = tmp_path / "own.yaml"
    own.write_text(
        "effects:\n- id: my_lag\n  enters: reading\n  formula: b * dir_y * sin(azimuth)\n"
        "  coefficients: {b: {unit: m, low: 0, high: 5.0e-5}}\n"
    )
    status = run(["diagnose", hidden, "--effects-file", str(own), "--json"])
    shown = capsys.readouterr()
    assert status == 0, shown.err
    document = json.loads(shown.out)
    assert "my_lag" in {c["effect"] for c in document["candidates"]}


@pytest.mark.parametrize(
    ("words", "part"),
    [
        (["no/such/session"], "no such file"),
        (["SESSION", "--effect", "backlash_q"], "unknown effect 'backlash_q'"),
        (["SESSION", "--model", "magic"], "no model 'magic'"),
        (["SESSION", "--effects-file", "no/such.yaml"], "no/such.yaml"),
    ],
)
def test_a_wrong_request_is_one_line(
    hidden: str, words: list[str], part: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(["diagnose", *(hidden if word == "SESSION" else word for word in words)]) == 1
    shown = capsys.readouterr()
    assert shown.out == ""
    assert shown.err.count("\n") == 1
    assert part in shown.err
