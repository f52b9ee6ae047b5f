# SPDX-License-Identifier: Apache-2.0
"""Every verb that takes several sessions of one machine: in text and as JSON, with effects."""

import json
from pathlib import Path

import pandas as pd
import pytest

from machine_tool_calibration.diagnosis.history import Entry, History, Part
from machine_tool_calibration.recording.open import open_measurement
from machine_tool_calibration.reports.history import fingerprint, history_path, update_history
from machine_tool_calibration.session.folder import write_session
from machine_tool_calibration.simulation import FlawSpec, SimulationSpec, TrackingPlan, simulate

from ..told import Verb


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


@pytest.mark.parametrize("effect", ["backlash_y", "linear_drift", "warmup_x"])
def test_identify_with_an_effect(sessions: list[str], effect: str, verb: Verb) -> None:
    text = verb("identify", *sessions, "--effect", effect).text
    assert f"model: rigid_body (monday), rigid_body (tuesday) with {effect}" in text
    if effect == "backlash_y":
        assert "backlash_y.b" in text and "half width" in text
        assert text.index("backlash_y.b") < text.index("monday/A.x")
    if effect == "linear_drift":
        assert "monday/linear_drift.r" in text and "tuesday/linear_drift.r" in text
        assert text.index("tuesday/linear_drift.r") < text.index("monday/A.x")
    document = verb("identify", *sessions, "--effect", effect, "--json").document
    assert document["effects"] == [effect]


def test_an_effect_with_the_name_of_an_error_motion_hides_it_not(sessions: list[str], verb: Verb) -> None:
    """The model has EYY as a table already: the effect adds nothing to it, and the table is shown as without it."""
    alone, text = (verb("identify", *sessions, *more).text for more in ((), ("--effect", "EYY")))
    assert "EYY" in alone.partition("Error motions")[2].partition("(--json")[0]
    assert "EYY" in text.partition("Error motions")[2].partition("(--json")[0]
    assert "not determined: effect EYY: " in text


def test_export_with_an_effect(sessions: list[str], tmp_path: Path, verb: Verb) -> None:
    text = verb("export", *sessions, "--effect", "backlash_y", "--format", "isg", "-o", tmp_path / "tables").text
    assert "RMS left" in text and "backlash_y" in text


def test_compare_for_people(sessions: list[str], verb: Verb) -> None:
    text = verb("compare", *sessions).text
    assert "The readings scatter" in text and "times their declared uncertainty" in text
    assert "Sessions, worst first" in text and "Setups of all sessions, worst first" in text
    assert "monday/A" in text and "tuesday/D" in text and "monday: Direction of approach" in text
    fits = verb("compare", *sessions, "--effect", "backlash_y").text
    assert "The model fits the readings" in fits and "In the model: backlash_y." in fits


def test_compare_for_programs(sessions: list[str], verb: Verb) -> None:
    document = json.loads(verb("compare", *sessions, "--json").text, parse_constant=pytest.fail)
    alone = verb("compare", sessions[0], "--json").document
    assert document["method"] == "joint" and document["format"] == alone["format"]
    assert [entry["label"] for entry in document["sessions"]] == ["monday", "tuesday"]
    assert all(set(entry) == {"label", *alone} for entry in document["sessions"])
    assert document["readings"] == sum(entry["readings"] for entry in document["sessions"])
    assert set(document) - {"sessions"} <= set(alone)
    worst = [entry["reduced_chi_square"] for entry in document["setups"]]
    assert len(worst) == 8 and worst == sorted(worst, reverse=True)
    assert {entry["session"] for entry in document["setups"]} == {"monday", "tuesday"}
    assert sum(entry["share"] for entry in document["setups"]) == pytest.approx(1.0)
    # What is left of the readings is the degrees of freedom of the whole, divided among the sessions.
    freedom = [entry["degrees_of_freedom"] for entry in document["sessions"]]
    assert sum(freedom) == pytest.approx(document["degrees_of_freedom"], abs=1)
    squares = [entry["reduced_chi_square"] * entry["degrees_of_freedom"] for entry in document["sessions"]]
    whole = document["reduced_chi_square"] * document["degrees_of_freedom"]
    assert sum(squares) == pytest.approx(whole, rel=0.02)


@pytest.mark.long
def test_compare_draws_and_writes_every_session(sessions: list[str], tmp_path: Path, verb: Verb) -> None:
    verb("compare", *sessions, "-o", tmp_path, "--against", "time")
    assert (tmp_path / "setups.png").read_bytes().startswith(b"\x89PNG")
    for label in ("monday", "tuesday"):
        assert {path.name for path in (tmp_path / label).iterdir()} == {
            "measured_predicted.png", "residuals.png", "residual_map.png", "setups.png"
        }  # fmt: skip
    table = pd.read_csv(tmp_path / "comparison.csv", comment="#")
    assert table["session"].value_counts().to_dict() == {"monday": 144, "tuesday": 144}
    assert (table["measured"] - table["predicted"] - table["residual"]).abs().max() < 1e-12
    assert "there is no covariate 'moon'" in verb.refused("compare", *sessions, "--against", "moon", "-o", tmp_path)


def test_the_order_of_sessions_of_different_methods(several_methods: list[str], tmp_path, verb, monkeypatch) -> None:
    """What one session did not record is empty for it."""
    monkeypatch.setattr("machine_tool_calibration.plots.compare.draw", lambda *_: [])
    verb("compare", *several_methods, "-o", tmp_path)
    table = pd.read_csv(tmp_path / "comparison.csv", comment="#")
    assert table.loc[table["session"] == "run", "azimuth"].isna().all()
    assert table.loc[table["session"] == "tracker", "azimuth"].notna().all()


@pytest.fixture(scope="module")
def several_methods(tmp_path_factory: pytest.TempPathFactory) -> list[str]:
    folder = tmp_path_factory.mktemp("methods")
    machine = {"seed": 5, "chain": "w-X-Y-b-Z-t", "travel": {axis: (0.0, 0.4) for axis in "XYZ"}}
    plans = {
        "tracker": {"method": "tracking_interferometer", "dimension": 2, "chain": "w-X-Y-b-Z-t"},
        "run": {"method": "direct", "kind": "iso230_2", "axis": "x", "repeats": 3, "count": 6, "chain": "w-X-Y-b-Z-t"},
    }
    for seed, (name, plan) in enumerate(plans.items()):
        spec = SimulationSpec.model_validate({"seed": seed, "plan": plan, "machine": machine})
        write_session(simulate(spec).session, folder / name)
    return [str(folder / name) for name in plans]


def test_history_of_several_sessions(sessions: list[str], verb: Verb) -> None:
    """It is listed, undone, and identified from, in whatever order the sessions are given."""
    paths = [Path(name) for name in sessions]
    opened = [open_measurement(path) for path in paths]
    assert "no model was tried yet" in verb.refused("history", *sessions)
    aside = (3, 5)
    parts = tuple(
        Part(label=path.name, model="rigid_body", data=fingerprint(session), set_aside=own)
        for path, session, own in zip(paths, opened, ((), aside), strict=True)
    )
    first, second = (
        Entry(
            number=1, made="2026-01-01T00:00:00+00:00", by="improve", model="joint", sessions=parts, effects=effects,
            data=fingerprint(*opened), used=286, rms_residual=rms, degrees_of_freedom=200,
        )
        for effects, rms in (((), 1e-6), (("backlash_y",), 3e-7))
    )  # fmt: skip
    rows = opened[1].readings.row[list(aside)].tolist()
    parts = (parts[0], parts[1].model_copy(update={"set_aside": tuple(rows)}))
    history = History().grown([entry.model_copy(update={"sessions": parts}) for entry in (first, second)])
    update_history(history_path(*paths), lambda old: history)
    text = verb("history", *reversed(sessions)).text
    assert "Sessions fitted together: monday, tuesday" in text and "backlash_y" in text
    document = verb("identify", *reversed(sessions), "--from-history", "--json").document
    assert document["effects"] == ["backlash_y"]
    assert (document["observations"], document["used"]) == (288, 286)
    left = [{"session": "tuesday", "row": row, "reason": "set aside by model 2 of the history"} for row in rows]
    assert document["rejected"] == left
    assert "with backlash_y" in verb("identify", *sessions, "--from-history").text
    verb("history", *sessions, "--undo")
    assert verb("history", *sessions, "--json").document["current"] == 1
