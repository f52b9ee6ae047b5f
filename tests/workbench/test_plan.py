# SPDX-License-Identifier: Apache-2.0
"""What the pages Plan and Export ask for: a procedure with other choices, its forecast, and the report."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from machine_tool_calibration.budget.contributor import template_of
from machine_tool_calibration.errors import CalibrationError, SessionError
from machine_tool_calibration.interface.session import simulate
from machine_tool_calibration.methods.fitted import FitRequest
from machine_tool_calibration.nodes.shared import procedure_file
from machine_tool_calibration.planning.forecast import Assumed
from machine_tool_calibration.planning.outlook import outlooks
from machine_tool_calibration.procedure import parse_procedure
from machine_tool_calibration.progress import untold
from machine_tool_calibration.session.text import load_yaml
from machine_tool_calibration.workbench.handed_over import reported
from machine_tool_calibration.workbench.models import Subject, planned
from machine_tool_calibration.workbench.state import Job, State


def content(name: str) -> dict[str, object]:
    found = load_yaml(procedure_file(name).read_text(encoding="utf-8"), name).value
    assert isinstance(found, dict)
    return found


def test_a_procedure_with_other_choices_is_one_that_can_be_run() -> None:
    from machine_tool_calibration.workbench.plan import changed_procedure

    given = content("tracking_2d")
    changed = changed_procedure(given, ["A", "C"], 3, 2.5, {"x": 4})
    made = parse_procedure(changed, "changed")
    usual = parse_procedure(procedure_file("tracking_2d").read_text(encoding="utf-8"), "usual")
    assert [setup.id for setup in made.session.setups] == ["A", "C"]
    assert (made.session.repeats, made.motion.dwell) == (3, 2.5)
    assert (made.path.grid["x"].count, made.path.grid["y"].count) == (4, usual.path.grid["y"].count)


@pytest.mark.filterwarnings("ignore::PendingDeprecationWarning")
def test_the_form_says_what_a_procedure_is_and_why_one_is_none(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from machine_tool_calibration.workbench import look
    from machine_tool_calibration.workbench.plan import ProcedureForm

    monkeypatch.setattr(look, "_locked", lambda act: act())
    ready: list[bool] = []
    form = ProcedureForm(ready.append)
    form._read("step_diagonal")
    assert ready[-1] and form.procedure().session.method == "step_diagonal"
    form._counts["blocks"].value = 4
    assert form.procedure().session.blocks == 4
    wrong = tmp_path / "wrong.yaml"
    wrong.write_text("session: {method: nonsense}\n", encoding="utf-8")
    form._read(str(wrong))
    assert ready[-1] is False and not form.text
    assert 'role="alert"' in form._said.object and "wrong.yaml" in form._said.object
    with pytest.raises(SessionError):
        form.procedure()
    form._read("")
    assert ready[-1] is False and not form._choices.visible


@pytest.mark.long
def test_a_procedure_with_more_runs_is_forecast_to_tell_more(hidden: Path) -> None:
    from machine_tool_calibration.workbench.plan import changed_procedure

    state = State()
    state.opened(hidden)()
    wide = []
    for repeats in (1, 4):
        text = changed_procedure(content("tracking_2d"), "ABCD", repeats, 1.0, {"x": 3, "y": 3})
        now, then, words = planned(
            state.subject, None, parse_procedure(text, "small"), Assumed("rigid_body", warming=0.0, angular=0.0), untold
        )
        assert now is None and then.words.startswith("procedure ") and f"{repeats * 36} readings" in words
        assert len(then.session.readings) == repeats * 36 and then.seconds is not None
        wide.append((float(np.nanmean(then.uncertainty)), then.seconds))
    assert wide[1][0] < wide[0][0] and wide[1][1] > 2 * wide[0][1]


@pytest.mark.long
@pytest.mark.parametrize("method", ["tracking_2d", "rotary_axis", "step_diagonal", "probing"])
def test_no_measurement_makes_the_published_uncertainty_larger(method: str) -> None:
    measurement = simulate(method, effects={"linear_drift": 1e-9} if method != "probing" else {}, seed=3)
    subject = Subject(measurement)
    model = subject.tried(None, "", FitRequest(measurement.sessions), frozenset(), frozenset(), {})
    now, *then = outlooks(subject.chosen(model), model.fit.result, lambda what, share: None)
    assert now.typical == model.step.map_uncertainty, "that which Improve and the history show"
    known = now.uncertainty > 0
    assert len(then) > 1 and all(np.all(one.uncertainty[known] < 1.001 * now.uncertainty[known]) for one in then)
    assert min(one.typical for one in then) < 0.9 * now.typical


@pytest.mark.long
@pytest.mark.usefixtures("few_draws")
def test_what_a_budget_adds_stays_whatever_is_measured_next() -> None:
    measurement, every = simulate("rotary_axis", seed=3), []
    for lines in ((), template_of("laser_tracker")):
        described = measurement.sessions[0].description.model_copy(update={"budget": lines})
        own = replace(measurement, sessions=(replace(measurement.sessions[0], description=described),))
        subject = Subject(own)
        model = subject.tried(None, "", FitRequest(own.sessions), frozenset(), frozenset(), {})
        found = outlooks(subject.chosen(model), model.fit.result, lambda what, share: None)
        every.append({one.words: one.uncertainty**2 for one in found})
    read, complete = every
    both = read.keys() & complete.keys()
    assert len(both) > 1 and np.nanmax(complete[""] - read[""]) > 0.01 * np.nanmax(read[""])
    for words in both:
        np.testing.assert_allclose(complete[words] - read[words], complete[""] - read[""], atol=1e-18)


@pytest.mark.filterwarnings("ignore::PendingDeprecationWarning")
def test_the_buttons_ask_for_the_report_in_their_format(
    hidden: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from machine_tool_calibration.workbench import look
    from machine_tool_calibration.workbench.export import ExportPage
    from machine_tool_calibration.workbench.readings import Readings

    monkeypatch.setattr(look, "_locked", lambda act: act())
    state = State()
    state.opened(hidden)()
    asked: list[Job] = []
    work = SimpleNamespace(run=lambda what, job: asked.append(job))
    page = ExportPage(state, Readings(state), work)  # type: ignore[arg-type]
    page.refresh()
    page._saved.folder.value = str(tmp_path)
    for row in page.view:
        for button in getattr(row, "objects", ()):
            if button.name.startswith("Save the report"):
                button.clicks += 1
    assert [job.work.func for job in asked] == [reported, reported]
    assert [job.work.args[4] for job in asked] == [[tmp_path / "report.html"], [tmp_path / "report.pdf"]]


def test_what_a_window_began_to_write_it_may_write_again_and_nothing_else(tmp_path: Path) -> None:
    from machine_tool_calibration.workbench.saved import Saved

    here, there = Saved("folder"), Saved("folder")
    here.claim([tmp_path / "report.html"])
    (tmp_path / "report.html").write_text("half, as it was stopped", encoding="utf-8")
    here.claim([tmp_path / "report.html"])
    with pytest.raises(CalibrationError, match=r"report\.html: is there already"):
        there.claim([tmp_path / "report.html"])
