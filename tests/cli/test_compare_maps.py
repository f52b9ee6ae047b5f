# SPDX-License-Identifier: Apache-2.0
"""`mtcal compare-maps` with effects and a history: a corrected map can be compared."""

import json

import numpy as np
import pytest

from machine_tool_calibration.cli.main import run
from machine_tool_calibration.session.folder import write_session
from machine_tool_calibration.simulation import PRESETS, FlawSpec, SimulationSpec, simulate


@pytest.fixture(scope="module")
def pair(tmp_path_factory: pytest.TempPathFactory) -> tuple[str, str]:
    """One machine measured with a backlash of Y, and by another instrument after it was taken out."""
    folder = tmp_path_factory.mktemp("maps")
    plan = PRESETS["tracking_2d"]
    effects = (FlawSpec(id="backlash_y", size=4e-6),)
    for name, spec in (
        ("before", SimulationSpec(plan=plan, seed=3, effects=effects)),
        ("after", SimulationSpec(plan=plan, seed=3)),
    ):
        write_session(simulate(spec).session, folder / name)
    return str(folder / "before"), str(folder / "after")


def test_an_effect_in_the_model_takes_its_part_out_of_the_difference(
    pair: tuple[str, str], capsys: pytest.CaptureFixture[str]
) -> None:
    found = []
    for more in ([], ["--effect", "backlash_y"]):
        assert run(["compare-maps", *pair, "--json", *more]) == 0
        found.append(json.loads(capsys.readouterr().out))
    assert "backlash_y" in found[1]["provenance"][0]["effects"]
    raw, corrected = (float(np.nanstd(np.array(one["difference"], dtype=float))) for one in found)
    assert corrected < 0.5 * raw and found[1]["agree"]


def test_the_history_of_one_is_taken_and_the_other_named(
    pair: tuple[str, str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(["compare-maps", *pair, "--from-history"]) == 1
    assert "no model was tried yet" in capsys.readouterr().err
    assert run(["improve", pair[0]]) == 0
    capsys.readouterr()
    assert run(["compare-maps", *pair, "--from-history", "--json"]) == 0
    shown = capsys.readouterr()
    assert json.loads(shown.out)["provenance"][0]["effects"] == ["backlash_y"]
    assert f"{pair[1]}: no model was tried yet; its method's own is compared" in shown.err


def test_an_effect_that_neither_can_have_is_refused(pair: tuple[str, str], capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["compare-maps", *pair, "--effect", "backlash_c"]) == 1
    assert "neither measurement can have the effect backlash_c" in capsys.readouterr().err
