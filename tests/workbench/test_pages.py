# SPDX-License-Identifier: Apache-2.0
"""Pages without a browser: what they show of the models, and how a browser is told of it."""

import asyncio
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from bokeh.document import Document
from bokeh.models import ColumnDataSource, Div
from bokeh.protocol import Protocol
from bokeh.server.connection import ServerConnection
from bokeh.server.protocol_handler import ProtocolHandler
from bokeh.server.session import ServerSession

from machine_tool_calibration.interface.session import simulate
from machine_tool_calibration.reports.history import history_path, read_history
from machine_tool_calibration.workbench.compare import ComparePage
from machine_tool_calibration.workbench.export import ExportPage
from machine_tool_calibration.workbench.handed_over import left
from machine_tool_calibration.workbench.improve import ImprovePage
from machine_tool_calibration.workbench.live_feed import Feed
from machine_tool_calibration.workbench.look import in_order
from machine_tool_calibration.workbench.overview import MeasurementPage, ResultPage
from machine_tool_calibration.workbench.page import _Window
from machine_tool_calibration.workbench.readings import Readings
from machine_tool_calibration.workbench.server import quieten
from machine_tool_calibration.workbench.state import State
from machine_tool_calibration.workbench.work import Work

pytestmark = pytest.mark.filterwarnings("ignore::PendingDeprecationWarning")


def shown(kind: Any, state: State) -> Any:
    readings = Readings(state)
    page = kind(state, readings, Work())
    readings.refresh()
    readings.look_at(page.title)
    page.refresh()
    return page


@pytest.mark.long
def test_models_have_the_numbers_of_the_history(state: State, hidden: Path, document: Document) -> None:
    page = shown(ImprovePage, state)
    assert list(page._before.options) == ["1: first model"]
    for name in ("warmup_y", "backlash_y"):
        state.changed(add=name)()
        state.undo()
    state.changed(add="dead_path")()
    page.refresh()
    numbers = [entry.number for entry in read_history(history_path(hidden)).models]
    assert numbers == [1, 2, 3, 4]
    assert list(page._before.options) == ["1: first model", "4: + dead_path"] == page._fall.x_range.factors
    assert "model 1" in page._table.object and "model 4" in page._table.object


def test_what_was_found_is_a_page_of_numbers_with_their_uncertainty(state: State, document: Document) -> None:
    page = shown(ResultPage, state)
    fit = state.model.fit
    row = fit.error_map.iloc[3]
    assert f"{1e6 * row['ex']:+.1f} ± {2e6 * row['ux']:.1f}" in page._values.object
    assert page._values.object.count("<tr>") > len(fit.error_map)
    assert fit.report().split("its uncertainty U (95 %)")[1].split(" µm RMS")[0].strip() in page._values.object
    assert "mtcal" not in page._words.object and "--csv" not in page._values.object
    assert page._map.plot.visible


def test_another_variant_of_the_model_is_chosen_where_the_result_is_shown(
    state: State, hidden: Path, document: Document
) -> None:
    page = shown(ResultPage, state)
    assert (page._variant.options, page._variant.value) == (["free", "rigid_body"], "free")
    state.changed(variant="rigid_body")()
    page.refresh()
    assert page._variant.value == "rigid_body" == state.model.fit.result.model_name
    assert "Error motions of X" in page._values.object
    assert read_history(history_path(hidden)).models[-1].change == "model rigid_body"


@pytest.mark.long
def test_a_model_keeps_its_residual_volumetric_error_when_another_is_undone(state: State, document: Document) -> None:
    page = shown(ImprovePage, state)
    state.changed(add="backlash_y")()
    page.refresh()
    (first, _) = page._steps.data["tool"]
    state.undo()
    page.refresh()
    assert page._steps.data["tool"] == [first]


@pytest.mark.long
def test_an_export_says_of_which_model_it_is(state: State, document: Document) -> None:
    page = shown(ExportPage, state)
    assert state.model.fit.result.model_name == "free"
    made, _, name = left(state.subject, state.model, "csv", lambda what, share: None)
    assert made.files and name == "rigid_body"
    assert page._whose(name).startswith("Of the model rigid_body; the one in use, free, has no tables")
    assert page._whose("free") == "Of the model free."


def test_compare_shows_long_readings_in_millimetres_and_hides_setups(state: State, document: Document) -> None:
    page = shown(ComparePage, state)
    assert "308.263\u202f963" in page._table.object
    assert page._legend.options == ["A", "B", "C", "D"] and page._band[0].top == pytest.approx(0.6)
    page._legend.value = ["B"]
    page._show_setups()
    assert {page._readings.data["setup"][k] for k in page._view.filter.indices} == {"B"}


@pytest.mark.long
def test_another_measurement_may_lie_in_another_plane(state: State, tmp_path: Path, document: Document) -> None:
    page = shown(ImprovePage, state)
    assert page._plane.value == "xy"
    simulate("step_diagonal", seed=3).save(tmp_path / "diagonals")
    state.opened(tmp_path / "diagonals")()
    page._readings.refresh()
    page._readings.planes.remove("xy")
    page.refresh()
    assert page._plane.value == "xz" == page._plane.options[0]


@pytest.mark.long
def test_at_one_place_nothing_is_magnified(state: State, tmp_path: Path, document: Document) -> None:
    (tmp_path / "session.yaml").write_text(
        "{format: mtcal-session/1, method: direct, machine: {chain: w-X-Y-Z-b-t}, setups: [{id: top}], "
        "standard_uncertainty: {displacement: 5.0e-6}, repeats: 1}"
    )
    rows = [f"{60 * k},top,0,0,0,0,1,{1e-6 * k * k}" for k in range(12)]
    (tmp_path / "observations.csv").write_text("\n".join(["time,setup,repeat,z,gx,gy,gz,displacement", *rows, ""]))
    state.opened(tmp_path)()
    assert shown(ComparePage, state)._map.title.text == "Places"
    state.changed(add="warmup_z")()
    assert shown(ImprovePage, state)._scale.object == "Above the plots: RMS."


def test_the_tables_of_a_measurement_are_tables(state: State, document: Document) -> None:
    page = shown(MeasurementPage, state)
    assert "<pre" not in page._setups.object + page._more.object, "no lines that break in the middle"
    assert "<td" in page._setups.object and "(-350.0, 50.0, 0.0) mm" in page._setups.object
    assert "Columns" in page._more.object and "--model" not in page._more.object
    assert "how the model fits, Result says" in page._words.object


@pytest.mark.long
def test_a_page_is_put_in_its_place_at_once(hidden: Path, document: Document, monkeypatch: pytest.MonkeyPatch) -> None:
    window = _Window([hidden], (), None, Feed(), False)
    for root in window.roots:
        document.add_root(root.get_root(document))
    through: list[None] = []
    recompute = document.models.recompute
    monkeypatch.setattr(document.models, "recompute", lambda: through.append(recompute()))
    window._show("Export")
    assert len(through) == 1, "Bokeh goes through all models of the window"
    assert window._head.visible
    window._show("Live")
    assert not window._head.visible, "what is heard is not the measurement that is open"


class Connection:
    """A browser's end of the line."""

    def __init__(self) -> None:
        self.protocol, self._socket, self.sent = Protocol(), self, []

    async def send_message(self, message: Any) -> None:
        self.sent.append([(event["attr"], event["new"]) for event in message.content["events"]])

    def send_patch_document(self, event: Any) -> Any:
        return self.send_message(self.protocol.create("PATCH-DOC", [event]))


def test_a_browser_is_told_of_all_changes_in_one_message(document: Document) -> None:
    words, more, source = Div(text=""), Div(text=""), ColumnDataSource({"x": [1.0, 2.0]})
    for root in (words, more):
        document.add_root(root)
    source.selected.on_change("indices", lambda attr, old, new: more.update(text=f"{len(new)} selected"))
    more.tags = [source]
    session = ServerSession("a window", document)
    context = SimpleNamespace(session=session)
    document._session_context = lambda: context
    browsers = Connection(), Connection()
    for browser in browsers:
        session.subscribe(browser)

    def act() -> None:
        words.text = "fitting"
        source.selected.indices = [1]
        words.text = "fitted"

    asyncio.run(session.with_document_locked(in_order, document, act))
    told = [("text", "fitted"), ("indices", [1]), ("text", "1 selected")]
    assert [browser.sent for browser in browsers] == [[told], [told]]
    asyncio.run(session.with_document_locked(words.update, text="later"))
    assert browsers[0].sent[1:] == [[("text", "later")]], "what changes otherwise is sent as ever"
    in_order(Document(), lambda: None)


def test_a_click_at_a_page_that_was_closed_meanwhile_is_no_fault(
    document: Document, caplog: pytest.LogCaptureFixture
) -> None:
    def handled(closed: bool) -> None:
        """A message with which nothing can be done."""
        page = ServerConnection(Protocol(), Any, Any, ServerSession("a window", document))
        if closed:
            page.detach_session()
        message = SimpleNamespace(msgtype="PATCH-DOC", header={"msgid": "1"})
        asyncio.run(ProtocolHandler().handle(message, page))

    quieten()
    handled(closed=True)
    assert not caplog.records
    handled(closed=False)
    assert "error handling message" in caplog.text


def test_what_was_changed_before_a_fault_is_told_all_the_same(document: Document) -> None:
    words = Div(text="")
    document.add_root(words)
    heard: list[str] = []
    document.on_change(lambda event: heard.append(event.new))

    def act() -> None:
        words.text = "half"
        raise ValueError("the other half")

    with pytest.raises(ValueError, match="the other half"):
        in_order(document, act)
    assert heard == ["half"] and document.callbacks.hold_value is None
