# SPDX-License-Identifier: Apache-2.0
"""One quantity has one value and one U: in the report, on the terminal, in the workbench, in JSON, from the node."""

import json
import math
import re
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import pandas as pd
import pytest

from machine_tool_calibration.budget import complete
from machine_tool_calibration.budget.contributor import template_of
from machine_tool_calibration.methods.fitted import FitRequest
from machine_tool_calibration.nodes import calculation
from machine_tool_calibration.recording.session_bag import session_from_bag, session_to_bag
from machine_tool_calibration.report import sections as room
from machine_tool_calibration.report.evaluation import Evaluation, evaluate
from machine_tool_calibration.reports.diagnosis import diagnosis_report
from machine_tool_calibration.reports.identification import Measured, summary_rows
from machine_tool_calibration.reports.improvement import improvement_document
from machine_tool_calibration.reports.quantities import sizes_in_words
from machine_tool_calibration.reports.tables import TextTable
from machine_tool_calibration.reports.values import standard_rows
from machine_tool_calibration.session.folder import write_session
from machine_tool_calibration.session.session import Session
from machine_tool_calibration.simulation import PRESETS, FlawSpec, SimulationSpec, simulate
from machine_tool_calibration.words import words
from machine_tool_calibration.workbench import models

from ..told import Verb

# One of each method, and of each kind where a method has several.
KINDS = ("tracking_2d", "step_diagonal", "rotary_axis", "probing_cross", "iso230_2", "grid_plate", "ball_bar")


@dataclass(frozen=True)
class Received(calculation.Request):
    """What came from a bag's messages."""

    session: Session | None = None

    def chosen(self) -> FitRequest:
        assert self.session is not None
        return FitRequest((self.session,))


pytestmark = pytest.mark.usefixtures("few_draws", "found_once")


@pytest.fixture(scope="module", autouse=True)
def no_pictures() -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        for name in ("map_pictures", "motion_pictures", "residual_pictures"):
            patch.setattr(room.figures, name, lambda *_: iter(()))
        patch.setattr(room.figures, "turnable", lambda *_: None)
        patch.setenv("COLUMNS", "500")
        yield


# The same with a budget that the session states, so that its U is the complete one.
RUN = "iso230_2 with laser_interferometer"
WITH_BUDGET = (RUN, "rotary_axis with laser_tracker")


@cache
def session_of(kind: str) -> Session:
    kind, _, instrument = kind.partition(" with ")
    effects = (FlawSpec(id="backlash_x", amplitude=2e-6),) if kind == "iso230_2" else ()
    session = simulate(SimulationSpec(plan=PRESETS[kind], seed=4, effects=effects)).session
    lines = template_of(instrument) if instrument else ()
    return replace(session, description=session.description.model_copy(update={"budget": lines}))


def received(kind: str, folder: Path) -> Received:
    session_to_bag(session_of(kind), folder / "bag")
    return Received("", [], None, (), (), 0.0, lambda: 0, session_from_bag(folder / "bag"))


def published(outcome: calculation.Outcome, topic: str) -> dict[str, Any]:
    """The document that a node publishes."""
    return dict(json.loads(outcome.messages[topic].data))


def tables(found: Evaluation) -> dict[str, TextTable]:
    return {
        block.title: block
        for section in room.sections(found, words("en"))
        for block in section.blocks
        if isinstance(block, TextTable)
    }


def compared(one: Any, other: Any, where: str = "") -> int:
    """How many numbers two documents have in common; all of them."""
    if isinstance(one, dict):
        assert one.keys() == other.keys(), where
        return sum(compared(one[key], other[key], f"{where}.{key}") for key in one)
    if isinstance(one, list):
        assert len(one) == len(other), where
        return sum(compared(a, b, f"{where}[{k}]") for k, (a, b) in enumerate(zip(one, other, strict=True)))
    if isinstance(one, float):
        assert other == pytest.approx(one, rel=1e-9, abs=1e-18), where
        return 1
    assert one == other, where
    return 0


def without_origin(document: dict[str, Any]) -> dict[str, Any]:
    return {key: value for key, value in json.loads(json.dumps(document)).items() if key != "provenance"}


@pytest.mark.long(but=("ball_bar",))
@pytest.mark.parametrize("kind", [*KINDS, *WITH_BUDGET])
def test_a_result_is_the_same_wherever_it_is_told(kind: str, verb: Verb, tmp_path: Path) -> None:
    session, folder = session_of(kind), tmp_path / "session"
    write_session(session, folder)
    found = evaluate(Measured((session,), FitRequest((session,))), diagnosis=False)
    of_report = without_origin(found.document)
    assert of_report["uncertainty"] == ("budget" if kind in WITH_BUDGET else "identification")
    table = tmp_path / "found.csv"
    of_terminal = verb("identify", folder, "--csv", table).out
    shown = models.opened([folder], None, (), lambda *_: None).models[-1]
    for other in (
        verb("identify", folder, "--json").document,
        published(calculation.identified(received(kind, tmp_path), lambda *_: None), "error_map/result"),
        shown.fit.document(),
    ):
        assert compared(of_report, without_origin(other)) > 20
    told = tables(found)
    lines = [re.sub(r"\s+", " ", line).strip() for line in of_terminal.splitlines()]
    assert kind not in WITH_BUDGET or "without instrument and temperature" not in of_terminal
    assert all(f"{name} {value}" in lines for name, value in summary_rows({**of_report, "not_determined": []}))
    summary = next(block for block in room.sections(found, words("en"))[0].blocks if isinstance(block, TextTable))
    figures = tuple(standard_rows(of_report["error_map"]))
    assert summary.rows == (*summary_rows({**of_report, "not_determined": []}), *figures)
    for _, told_in_short in figures:  # each figure as the terminal has it in its table
        for name, size in re.findall(r"([AERB]) ([\d.]+ ± [\d.]+)", told_in_short):
            assert any(re.search(rf"\b{name} .*{re.escape(size)}$", line) for line in lines), name
    listed = pd.read_csv(table, comment="#")
    whole = [one for title, one in told.items() if title.startswith("Error motions of ")]
    assert whole or not listed["error"].str.fullmatch("E[XYZABC]{2}").any()
    for one in whole:
        for k, name in enumerate(head.split(" ")[0] for head in one.columns[1:]):
            own = listed[(listed["error"] == name) & listed["determined"]].sort_values("position")
            cells = [row[k + 1].split(" ± ") for row in one.rows if row[k + 1] not in ("", "–")]
            assert len(cells) == len(own), name
            for cell, value, expanded in zip(cells, own["value"], own["U"], strict=True):
                for text, number in zip(cell, (value, expanded), strict=False):
                    # U has two figures, and the value as many decimals.
                    place = 10.0 ** (math.floor(math.log10(1e6 * expanded)) - 1) if expanded > 1e-15 else 1e-3
                    assert float(text) == pytest.approx(1e6 * number, abs=0.51 * place), name


@cache
def whole() -> Evaluation:
    """All of a report of a run by ISO 230-2, with a budget."""
    session = session_of(RUN)
    return evaluate(Measured((session,), FitRequest((session,))), tolerances={"A": 20e-6, "EXX": 20e-6})


@pytest.mark.long
def test_a_diagnosis_is_the_same_wherever_it_is_told(
    verb: Verb, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    kind, folder, found = RUN, tmp_path / "session", whole()
    write_session(session_of(kind), folder)
    assert found.improvement is not None and found.conclusions is not None
    diagnosis, then = found.improvement.diagnosis, found.conclusions
    document = verb("diagnose", folder, "--json").document
    assert document["accepted"] == ["backlash_x"]
    monkeypatch.setattr(complete, "look_for_effects", lambda *_, **__: diagnosis)
    of_node = published(calculation.diagnosed(received(kind, tmp_path), lambda *_: None), "diagnosis/result")
    assert compared(without_origin(document), without_origin(of_node)) > 20
    opened = models.opened([folder], None, (), lambda *_: None)
    of_workbench = models.diagnosed(opened.subject, opened.models[-1], lambda *_: None)
    report = diagnosis_report(diagnosis, then.advice, then.changes)
    assert report == diagnosis_report(of_workbench, of_workbench.conclusions.advice, of_workbench.conclusions.changes)
    (section,) = (one for one in room.sections(found, words("en")) if one.id == "diagnosis")
    assert tuple(block for block in section.blocks if isinstance(block, str)) == report.words
    written = [block for block in section.blocks if isinstance(block, TextTable)]
    assert [block.title for block in written] == [block.title for block in report.tables]
    size = sizes_in_words(then.changes["backlash_x"].parameters)
    assert size == report.tables[0].rows[0][report.tables[0].columns.index("size")] and size in " ".join(report.words)
    (told,) = document["candidates"][0]["parameters"]
    (own,) = then.changes["backlash_x"].parameters
    assert (told["value"], told["standard_uncertainty"]) == pytest.approx((own.value, own.standard_uncertainty))
    # The size that the diagnosis tells is that of the model with it, on the way and as it is identified.
    steps = improvement_document(found.improvement)
    told_by_verb = verb("improve", folder, "--json", "-o", tmp_path / "pictures").document
    assert compared(without_origin(steps), without_origin(told_by_verb)) > 20
    best = models.improved(opened.subject, opened.models[-1], of_workbench, lambda *_: None)[-1]
    of_model = [p for p in best.fit.document()["parameters"] if p["name"] == own.name]
    for parameter in (*found.improvement.steps[-1].parameters, *best.step.parameters):
        assert parameter.standard_uncertainty == pytest.approx(own.standard_uncertainty)
    assert [p["standard_uncertainty"] for p in of_model] == pytest.approx([own.standard_uncertainty])


@pytest.mark.long
def test_with_a_budget_the_whole_report_states_its_uncertainty() -> None:
    found = whole()
    assert found.budget is not None and found.conformity is not None and found.improvement is not None
    expanded = found.budget.largest("EXX").expanded  # type: ignore[union-attr]
    document = found.document
    assert document["uncertainty"] == "budget"
    motion = [p["standard_uncertainty"] for p in document["parameters"] if p.get("error_motion") == "EXX"]
    assert 2 * max(motion) == pytest.approx(expanded)
    assert 2 * max(document["error_map"]["tables"]["EXX"]["value_u"]) == pytest.approx(expanded)
    (run_,) = document["error_map"]["iso230_2"]
    accuracy = found.conformity.each[0]
    assert run_["A_U"] == pytest.approx(2 * accuracy.u) == pytest.approx(found.budget.largest("A_X").expanded)  # type: ignore[union-attr]
    assert "note" not in run_  # that the instrument's comes on top
    told = tables(found)
    shown = max(row[1].split(" ± ")[1] for row in told["Error motions of X ± U (95 %)"].rows)
    assert float(shown) == pytest.approx(1e6 * expanded, abs=0.06)
    # Each step has the budget of its own model; that of the first is the result's.
    first = found.improvement.steps[0]
    assert first.result.error_map.uncertainty == pytest.approx(found.result.error_map.uncertainty, nan_ok=True)
    summary = room.sections(found, words("en"))[0].blocks
    assert summary[0] == "All together: pass."
    assert words("en")("report.u_is_complete") in summary
