# SPDX-License-Identifier: Apache-2.0
"""`mtcal check` against a logbook, a session and a result document."""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest

from machine_tool_calibration.session.folder import write_session
from machine_tool_calibration.simulation import PRESETS, FlawSpec, SimulationSpec, simulate
from machine_tool_calibration.simulation.machine_file import MachineSpec
from machine_tool_calibration.trends.statement import of_fit

from ..told import Verb


@pytest.fixture(scope="module", autouse=True)
def fewer_draws() -> Iterator[None]:
    """Enough for motions of a few values."""
    assert of_fit.__kwdefaults__ is not None
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(of_fit.__kwdefaults__, "draws", 100)
        yield


@pytest.fixture(scope="module")
def months(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A machine measured in three months, in the last of which its positioning had changed."""
    folder = tmp_path_factory.mktemp("months")
    for month, seed, effects in ((1, 1, ()), (2, 2, ()), (3, 3, (FlawSpec(id="scale", size=4e-5),))):
        spec = SimulationSpec(plan=PRESETS["iso230_2"], seed=seed, machine=MachineSpec(seed=7), effects=effects)
        session = simulate(spec).session
        about = {"machine": "mill", "date": f"2026-0{month}-05"}
        session = replace(session, description=session.description.model_copy(update={"about": about}))
        write_session(session, folder / str(month))
    return folder


def test_the_last_entry_before_the_measurement_counts(months: Path, verb: Verb) -> None:
    book = months / "mill.logbook"
    verb("logbook", "add", book, months / "1", months / "3")
    held = verb("check", book, months / "2", "--json").document
    assert held["holds"] and held["map"] == "1" and held["since"] == "2026-01-05" and held["moved"] == []
    # That it is entered already makes no difference: what was before it counts.
    failed = verb("check", book, months / "3")
    assert "no longer predicts" in failed.text and "between 2026-01-05 and 2026-03-05" in failed.text
    assert "the logbook has no entry before" in verb.refused("check", book, months / "1")


def test_a_session_and_a_result_document_do_as_well(months: Path, verb: Verb, tmp_path: Path) -> None:
    verb("identify", months / "1", "-o", tmp_path / "out")
    for earlier in (months / "1", tmp_path / "out" / "result.json", tmp_path / "out"):
        assert "still predicts" in verb("check", earlier, months / "2").text
        found = verb("check", earlier, months / "3", "--json").document
        assert not found["holds"] and "EXX" in found["moved"]
        assert found["correlated"] == (earlier == months / "1")
    assert "was made from" in verb.refused("check", months / "1", months / "1")
    (tmp_path / "no.json").write_text('{"format": "mtcal-diagnosis/1"}')
    assert "no result document" in verb.refused("check", tmp_path / "no.json", months / "2")


def test_a_history_gives_model_and_effects(months: Path, verb: Verb, tmp_path: Path) -> None:
    folders = [tmp_path / name for name in ("before", "after")]
    for seed, folder in enumerate(folders):
        spec = SimulationSpec(
            plan=PRESETS["iso230_2"], seed=seed + 11, machine=MachineSpec(seed=7),
            effects=(FlawSpec(id="backlash_x", size=4e-6),),
        )  # fmt: skip
        write_session(simulate(spec).session, folder)
    assert "no model was tried yet" in verb.refused("check", *folders, "--from-history")
    verb("improve", folders[0])
    for pair in (folders, folders[::-1]):
        found = verb("check", *pair, "--from-history", "--json").document
        assert found["holds"]
        assert "backlash_x.b" in {one["name"] for one in found["changes"]}
    told = verb("check", *folders, "--from-history", "--effect", "scale_x", status=2)
    assert "--from-history is without" in told.err
