# SPDX-License-Identifier: Apache-2.0
"""`mtcal plan` and `mtcal workpiece`: what is promised is what a simulated measurement then gives."""

import json
from pathlib import Path

import numpy as np
import pytest

from machine_tool_calibration.budget.enough import Reached, Until
from machine_tool_calibration.cli.enough import known_after
from machine_tool_calibration.errors import SessionError
from machine_tool_calibration.methods.fitted import FitRequest
from machine_tool_calibration.planning.forecast import Assumed, forecast, planned_session
from machine_tool_calibration.procedure import plan, read_procedure
from machine_tool_calibration.session.checks import check_session
from machine_tool_calibration.session.folder import read_session

from ..told import Verb

ROOT = Path(__file__).parents[2]
PROCEDURES = sorted((ROOT / "config" / "procedures").glob("*.yaml"))
OF_MAPS = [file for file in PROCEDURES if not file.stem.startswith("pointer_")]


@pytest.mark.long
@pytest.mark.parametrize("file", OF_MAPS, ids=lambda file: file.stem)
def test_every_procedure_can_be_foretold(file: Path) -> None:
    procedure = read_procedure(file)
    planned = planned_session(procedure)
    check_session(planned)
    assert len(planned.readings) == len(plan(procedure).steps)
    assert planned.readings.columns["time"][-1] == pytest.approx(plan(procedure).duration)
    found = forecast(procedure, Assumed())
    document = found.document()
    json.dumps(document, allow_nan=False, default=lambda array: [])
    assert found.visible and all(entry.size and entry.size > 0 for entry in found.visible)
    assert not {entry.effect for entry in found.visible} & set(found.absorbed)


@pytest.mark.long
def test_where_it_was_not_enough_the_next_step_is_named(backlash: Path, verb: Verb) -> None:
    said = verb("enough", backlash, "--until", "U=0.1um").text
    assert "not enough What the next measurement would tell" in said and "one more station" in said
    wanted, chosen = Until(told=("backlash_y",)), FitRequest((read_session(backlash),))
    *_, never, further = known_after(chosen, wanted, [Reached("A", 72, 60.0)], backlash)
    assert (never, further) == ("not enough", f"`mtcal diagnose {backlash}` says what would tell more")


def test_choices_are_looked_at_before_anything_is_chosen(tmp_path: Path, verb: Verb) -> None:
    file = tmp_path / "mine.yaml"
    file.write_text((ROOT / "config" / "procedures" / "ball_bar.yaml").read_text() + "\nchoices: {features: [pin]}\n")
    assert "choices.features are for a workpiece" in verb.refused("plan", file)


def test_a_plan_says_how_well_a_squareness_comes_out(verb: Verb) -> None:
    told = {
        one["name"]: one["standard_uncertainty"] for one in verb("plan", "ball_bar", "--json").document["squareness"]
    }
    assert told.keys() == {"C0Y", "scale_y_less_x"} and 1e-7 < told["C0Y"] < 5e-7
    shown = [line.split() for line in verb("plan", "ball_bar").out.splitlines() if line.startswith("C0Y")]
    assert shown == [["C0Y", *2 * (f"{2e6 * told['C0Y']:.2g}", "µrad")]]


def test_a_run_of_one_axis_promises_that_axis_alone(verb: Verb) -> None:
    rows = verb("plan", "direct_iso230_2", "--json").document["uncertainties"]["position_error_u"]
    assert all(row[0] > 0 and row[1:] == [None, None] for row in rows)
    (line,) = [line for line in verb("plan", "direct_iso230_2").out.splitlines() if line.startswith("position error")]
    typical = 2e6 * np.sqrt(np.mean([row[0] ** 2 for row in rows]))
    assert line.split()[2] == f"{typical:.2g}"
    assert line.rstrip().endswith(f"{2 * len(rows)} of {3 * len(rows)}")


@pytest.mark.long
def test_a_plan_in_words_and_as_json(verb: Verb) -> None:
    text = verb("plan", "probing_cross").out
    assert "workpiece form" in text and "absolute length" in text and "probe_pretravel" in text
    document = verb("plan", "probing_cross", "--json").document
    assert document["format"] == "mtcal-plan/1"
    assert document["not_determined"][0]["name"] == "absolute length"
    assert "scale" in document["absorbed"]


def test_a_plan_that_cannot_be(tmp_path: Path, verb: Verb) -> None:
    text = (ROOT / "config" / "procedures" / "tracking_2d.yaml").read_text()
    (tmp_path / "wrong.yaml").write_text(text.replace("last: 0.4, count: 6}\n    y", "last: 0.9, count: 6}\n    y"))
    assert "outside the travel" in verb.refused("plan", tmp_path / "wrong.yaml")


def test_a_plan_too_large_to_forecast_is_refused_before_its_steps_are_made(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("machine_tool_calibration.planning.forecast._MOST_READINGS", 999)
    procedure = read_procedure(ROOT / "config" / "procedures" / "tracking_3d.yaml")
    with pytest.raises(SessionError, match="has more than 999 readings, which are too many to forecast"):
        planned_session(procedure)
    steps = plan(procedure).steps
    assert len(steps) == 1000
    assert plan(procedure, 1000).steps == steps


def test_points_of_a_description(tmp_path: Path, verb: Verb) -> None:
    description = ROOT / "config" / "workpieces" / "cross_pocket.yaml"
    assert "92 points" in verb("workpiece", description, "-o", tmp_path / "points.csv").out
    rows = (tmp_path / "points.csv").read_text().splitlines()
    assert rows[:2] == ["id,feature,x,y,nx,ny", "0,work,0.023125,0.018,0.0,-1.0"]
    assert len(rows) == 93
    assert "is there already" in verb.refused("workpiece", description, "-o", tmp_path / "points.csv")


def test_an_outline_into_a_procedure(tmp_path: Path, verb: Verb) -> None:
    (tmp_path / "part.csv").write_text("x,y\n-40,-30\n40,-30\n40,30\n-40,30\n")
    made = tmp_path / "mine.yaml"
    words = ["workpiece", str(tmp_path / "part.csv"), "--unit", "mm", "--spacing", "10", "--stylus", "6"]
    points = verb(*words, "--into", "probing_cross", "-o", made, "--json").document["workpiece"]
    session = read_procedure(made).session
    assert [p.id for p in session.workpiece] == [p["id"] for p in points]  # type: ignore[union-attr]
    for point in points:  # outside of the part
        assert np.dot(point["position"], point["normal"]) > 0
    verb("plan", made)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["nothing.yaml"], "no such file"),
        (["part.csv", "--spacing", "10"], "does not say its unit"),
        (["part.csv", "--spacing", "-1", "--unit", "mm"], "spacing"),
        (["part.txt", "--spacing", "1", "--unit", "mm"], "outlines are read from .dxf and .csv files"),
    ],
)
def test_workpieces_that_cannot_be(words: list[str], message: str, tmp_path: Path, verb: Verb) -> None:
    for name in ("part.csv", "part.txt"):
        (tmp_path / name).write_text("x,y\n-40,-30\n40,-30\n40,30\n-40,30\n")
    error = verb("workpiece", tmp_path / words[0], *words[1:], status=1).err
    assert message in error and error.count("\n") == 1


def test_a_plan_says_how_far_it_is() -> None:
    procedure = read_procedure(ROOT / "config" / "procedures" / "tracking_2d.yaml")
    told: list[tuple[str, float]] = []
    forecast(procedure, Assumed(), lambda what, share: told.append((what, share)))
    shares = [share for _, share in told]
    assert (np.diff(shares) > -1e-12).all() and shares[0] == 0.0 and 0.8 < shares[-1] < 1.0
    assert len({what for what, _ in told}) == 4
