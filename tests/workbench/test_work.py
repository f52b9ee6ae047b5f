# SPDX-License-Identifier: Apache-2.0
"""What a window does with buttons and fields while something is calculated, and where that fails or is stopped.
What `mtcal workbench` says before it serves anything.
A calculation beside the page gives its outcome or its error, and is ended wherever it is.
"""

import sys
import threading
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import panel as pn
import pytest
from bokeh.document import Document

from machine_tool_calibration.cli.main import run
from machine_tool_calibration.errors import CalibrationError
from machine_tool_calibration.planning.outlook import outlooks
from machine_tool_calibration.reports.history import history_path, read_history
from machine_tool_calibration.workbench import work
from machine_tool_calibration.workbench.handed_over import left
from machine_tool_calibration.workbench.live_feed import Feed
from machine_tool_calibration.workbench.models import Progress
from machine_tool_calibration.workbench.page import _Window
from machine_tool_calibration.workbench.process import Calculation, FaultError, warm_up
from machine_tool_calibration.workbench.state import Job, State

pytestmark = pytest.mark.filterwarnings("ignore::PendingDeprecationWarning")


IDLE = Job(lambda progress: None, lambda found: None)


class Endless:
    """A calculation that is never over by itself."""

    def __init__(self, job: Callable[[Progress], Any]) -> None:
        self.over = threading.Event()

    def outcome(self, progress: Progress) -> None:
        self.over.wait()

    def end(self) -> None:
        self.over.set()


@pytest.fixture
def window(document: Document, hidden: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Any]:
    """On a session that is open, beside one that cannot be read."""
    damaged = hidden.with_name("damaged")
    damaged.mkdir()
    (damaged / "session.yaml").write_text("format: none\n", encoding="utf-8")
    monkeypatch.setattr(work, "Calculation", Endless)
    made = _Window([hidden.parent], (), None, Feed(), False)
    made._state.opened(hidden)()
    yield made
    made._work._rest()


def answered(document: Document, act: Callable[[], object]) -> None:
    """Do something, and what the page does upon it at once."""
    act()
    while waiting := [one for one in document.session_callbacks if not hasattr(one, "timeout")]:
        for one in waiting:
            one.callback()


def press(document: Document, page: Any, name: str) -> None:
    (button,) = (one for block in page.view for one in block.select(pn.widgets.Button) if one.name == name)
    answered(document, partial(setattr, button, "clicks", button.clicks + 1))


def test_without_a_measurement_every_button_says_so(document: Document, tmp_path: Path) -> None:
    window = _Window([tmp_path], (), None, Feed(), False)
    for title, names in {
        "Diagnose": ["Look for what is missing"],
        "Improve": ["Diagnose, and add all that is found", "Undo"],
        "Plan": ["Look ahead"],
        "Export": ["Save the report as HTML", "Save the tables", "Show what would be left"],
    }.items():
        window._show(title)
        for name in names:
            window._work.say("")
            press(document, window._pages[title], name)
            assert 'role="alert"' in window._work._words.object, name


def test_what_cannot_be_written_is_said_by_its_name(window: Any, document: Document, tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    window._show("Export")
    page = window._pages["Export"]
    page._saved.folder.value = str(tmp_path / "file")
    page._left = "csv", SimpleNamespace(files={"errors.csv": ""}), b""
    press(document, page, "Save the files")
    assert f">{tmp_path / 'file' / 'csv'}: cannot be written: Not a directory<" in window._work._words.object


@pytest.mark.long
def test_the_model_stays_while_something_is_calculated_of_it(window: Any, document: Document, hidden: Path) -> None:
    window._state.changed(add="backlash_y")()
    window._show("Improve")
    window._work.run("working", IDLE)
    press(document, window._pages["Improve"], "Undo")
    assert window._state.model.number == 2 == read_history(history_path(hidden)).current
    assert "One thing at a time" in window._work._words.object
    window._work.stop()
    press(document, window._pages["Improve"], "Undo")
    assert window._state.model.number == 1


def test_what_was_not_done_can_be_chosen_again(window: Any, document: Document, hidden: Path) -> None:
    for title in ("Improve", "Diagnose"):
        window._show(title)
    fields = {
        window._pages["Improve"]._add: "backlash_y",
        window._pages["Diagnose"]._effect: "backlash_y",
        window._choice: (hidden.with_name("damaged"),),
    }
    before = {field: field.value for field in fields} | {window._choice: (hidden,)}
    fail = partial(window._work._done, window._work._failed, CalibrationError("it cannot be"))

    def refuse(found: object) -> None:
        raise CalibrationError("it cannot be kept")

    for end in (window._work.stop, fail, partial(window._work._done, refuse, None)):
        for field, value in fields.items():
            answered(document, partial(setattr, field, "value", value))
            assert window._work._job is not None
            answered(document, end)
            assert window._work._job is None and field.value == before[field], field
    window._work.run("working", IDLE)
    for field, value in fields.items():
        answered(document, partial(setattr, field, "value", value))
        assert field.value == before[field], "one thing at a time"


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


@pytest.mark.long
def test_a_calculation_is_ended_and_its_errors_come_back(hidden: Path) -> None:
    warm_up()
    state = State()
    state.opened(hidden)()
    told: list[str] = []

    def stop(what: str, share: float) -> None:
        told.append(what)
        ahead.end()

    ahead = Calculation(partial(outlooks, state.subject.chosen(state.model), state.model.fit.result))
    with pytest.raises(CalibrationError, match="has ended"):
        ahead.outcome(stop)
    assert told == ["what is known now"]
    with pytest.raises(CalibrationError, match="no format 'abacus'"):
        Calculation(partial(left, state.subject, state.model, "abacus")).outcome(lambda what, share: None)
    with pytest.raises(FaultError, match="AttributeError"):
        Calculation(partial(left, state.subject, None, "csv")).outcome(lambda what, share: None)
