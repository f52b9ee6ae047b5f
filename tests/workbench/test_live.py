# SPDX-License-Identifier: Apache-2.0
"""What the page Live makes of what is heard: no ROS, no browser."""

import json
import pickle
import sys
from array import array
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from machine_tool_calibration.errors import CalibrationError
from machine_tool_calibration.interface.session import load, simulate
from machine_tool_calibration.methods.identify import identify
from machine_tool_calibration.nodes.heard import Heard, NodeState, Offer
from machine_tool_calibration.recording.session_bag import reading_columns, session_to_bag
from machine_tool_calibration.session.collect import Reading
from machine_tool_calibration.session.parse import description_yaml
from machine_tool_calibration.session.session import Session
from machine_tool_calibration.workbench import live_feed
from machine_tool_calibration.workbench.live_feed import Feed
from machine_tool_calibration.workbench.process import Calculation

START = 1_700_000_000_000_000_000


@pytest.fixture(scope="module")
def session() -> Session:
    return simulate("tracking_2d", seed=3).sessions[0]


def tell(heard: Heard, session: Session, rows: slice = slice(None), start: int = START) -> None:
    """What a procedure publishes of a session."""
    heard.describe(description_yaml(session.description))
    names, table = reading_columns(session)
    for row in table[rows]:
        stamp = start + round(row[names.index("time")] * 1e9)
        heard.read(stamp, Reading(names, array("d", row)))


def calculated(feed: Feed, now: float) -> None:
    """Look, and wait until what was begun is done."""
    feed.look(now)
    if feed._working is not None:
        feed._working.join()


@pytest.fixture
def feed(monkeypatch: pytest.MonkeyPatch) -> Feed:
    made = Feed()
    monkeypatch.setattr(made, "_start", lambda: None)
    return made


def test_readings_come_once_however_often_they_are_sent_and_another_session_begins_anew(session: Session) -> None:
    heard = Heard()
    tell(heard, session, slice(0, 3))
    tell(heard, session, slice(1, 5))
    run, known, rows = heard.rows(-1, 0)
    assert (known, [setup for setup, _ in rows]) == (0, session.readings.setup[:5].tolist())
    np.testing.assert_array_equal([value for _, value in rows], session.readings.displacement[:5])
    assert heard.rows(run, 3)[1:] == (3, rows[3:])
    tell(heard, session, slice(0, 2), start=START + 10**12)
    again, known, rows = heard.rows(run, 5)
    assert again != run and known == 0 and len(rows) == 2


def test_a_replay_that_begins_anew_is_seen_to_grow_again(session: Session) -> None:
    heard = Heard()
    for _ in range(2):
        tell(heard, session, slice(0, 6))
    tell(heard, session, slice(0, 2))
    run, _, rows = heard.rows(-1, 0)
    assert (run, len(rows), heard.count) == (2, 2, (2, 2))


def test_what_is_no_reading_or_no_description_is_refused_and_changes_nothing(session: Session) -> None:
    heard = Heard()
    tell(heard, session, slice(0, 3))
    with pytest.raises(CalibrationError):
        heard.read(START, Reading(("time", "reading_index"), (0.0, -4.0)))
    with pytest.raises(CalibrationError):
        heard.describe("method: nonsense")
    assert heard.count[1] == 3 and heard.setups == session.setup_ids


def state(node: str, kind: str, at: float, *, repeats: bool, message: str = "measuring") -> NodeState:
    return NodeState(node, kind, 0, message, at=at, repeats=repeats)


def test_a_nodes_own_topic_stands_for_it_only_where_it_does_not_speak() -> None:
    heard = Heard()
    heard.say(state("instrument", "instrument", 0.0, repeats=False, message="as recorded"))
    assert [one.message for one in heard.nodes()] == ["as recorded"]
    heard.say(state("interferometer", "instrument", 1.0, repeats=True))
    assert [(one.node, one.message) for one in heard.nodes()] == [("interferometer", "measuring")]
    heard.say(state("instrument", "instrument", 1.5, repeats=False, message="no signal"))
    assert [(one.node, one.message) for one in heard.nodes()] == [("interferometer", "no signal")]
    assert not heard.nodes()[0].silent(2.0) and heard.nodes()[0].silent(99.0) == 98.0
    # Long after it has gone a recording of it is replayed.
    heard.say(state("instrument", "instrument", 50.0, repeats=False, message="replayed"))
    assert [(one.node, one.message) for one in heard.nodes()] == [("instrument", "replayed")]
    assert not heard.nodes()[0].silent(99.0), "what is said only when it changes is not silent"


def test_more_nodes_than_a_graph_has_are_refused() -> None:
    heard = Heard()
    for k in range(200):
        heard.say(state(f"node{k}", "x", 0.0, repeats=True))
    with pytest.raises(CalibrationError, match="more than 200"):
        heard.say(state("one_more", "x", 0.0, repeats=True))
    heard.say(state("node7", "x", 5.0, repeats=True))
    assert len(heard.nodes()) == 200


def test_what_nodes_say_cannot_be_taken_for_the_page() -> None:
    from machine_tool_calibration.workbench.live import node_table

    hostile = NodeState("<b>x</b>", "estimator", 9, "<script>1</script>", {"step": "<i>", "ignored": "3"})
    shown = node_table([hostile], 0.0)
    assert "<script>" not in shown and "<b>x" not in shown and "<i>" not in shown
    assert "error" in shown and "3 messages ignored" in shown


def test_a_request_is_answered_or_its_node_has_gone() -> None:
    heard = Heard()
    heard.offer([Offer("estimator/identify", "identify"), Offer("procedure/start", "start", moves_axes=True)])
    first, second = heard.ask("estimator/identify"), heard.ask("procedure/start")
    assert [call.success for call in heard.calls] == [None, None]
    first.answer(True, "done")
    heard.offer([Offer("estimator/identify", "identify")])
    assert [(call.service, call.success) for call in heard.calls] == [
        ("procedure/start", False),
        ("estimator/identify", True),
    ]
    second.answer(True, "late")
    assert heard.calls[0].success, "it was only not seen for a moment"
    for _ in range(20):
        heard.ask("estimator/identify")
    assert len(heard.calls) < 10


@pytest.mark.parametrize("most", [1, 4, 10])
def test_however_many_readings_come_a_bounded_number_is_drawn_evenly(most: int) -> None:
    from machine_tool_calibration.workbench.live import Thinned

    thinned, drawn, known = Thinned(most), list[int](), 0
    for total in (0, 1, 3, 4, 9, 10, 11, 60, 61, 1000):
        if thinned.grow(total):
            drawn = thinned.of(0, total)
        else:
            drawn += thinned.of(known, total)
        known = total
        assert drawn == thinned.of(0, total) == sorted(drawn)
        whole = total // thinned.step
        assert [number // thinned.step for number in drawn][:whole] == list(range(whole)) and len(drawn) <= most


def test_of_a_procedure_that_repeats_itself_every_target_is_drawn() -> None:
    from machine_tool_calibration.workbench.live import Thinned

    thinned = Thinned(2000)
    thinned.grow(32 * 2000)
    assert {number % 32 for number in thinned.of(0, 32 * 2000)} == set(range(32))


def test_the_map_comes_as_soon_as_it_can_be_calculated_and_not_more_often_than_it_may(
    feed: Feed, session: Session
) -> None:
    calculated(feed, 0.0)
    assert feed.map is None and not feed.why_not, "nothing has come: nothing is to be said"
    tell(feed.heard, session, slice(0, 20))
    calculated(feed, 0.0)
    assert feed.map is None and feed.why_not
    tell(feed.heard, session)
    feed.look(feed._due - 0.1)
    assert feed._working is None and feed.map is None
    calculated(feed, feed._due)
    assert feed.map is not None and not feed.why_not
    direct = identify(session)
    np.testing.assert_array_equal(feed.map.error_map.error, direct.error_map.error)
    np.testing.assert_array_equal(feed.map.residual, direct.fit.residuals)
    number = feed.number
    calculated(feed, feed._due)
    assert feed.number == number, "no reading has come since"
    assert feed.fall == [(len(session.readings), 72, pytest.approx(2.0 * np.nanmax(direct.error_map.uncertainty)))]


def test_u_falls_from_map_to_map_and_begins_anew_with_another_session(feed: Feed, session: Session) -> None:
    for rows in (slice(0, 216), slice(216, 288)):
        tell(feed.heard, session, rows)
        calculated(feed, feed._due)
        assert not feed.why_not
    (few, _, before), (many, _, after) = feed.fall
    assert (few, many) == (216, 288) and after < before
    tell(feed.heard, session, slice(0, 2), start=START + 10**12)
    calculated(feed, feed._due)
    assert not feed.fall


def test_a_large_session_is_calculated_in_another_process(
    feed: Feed, session: Session, monkeypatch: pytest.MonkeyPatch
) -> None:
    beside: list[Calculation] = []

    class Recorded(Calculation):
        def outcome(self, progress: Callable[[str, float], object]) -> Any:
            beside.append(self)
            return pickle.loads(pickle.dumps(pickle.loads(pickle.dumps(self._work))(progress)))

    monkeypatch.setattr(live_feed, "Calculation", Recorded)
    monkeypatch.setattr(live_feed, "_READINGS_APART", len(session.readings))
    tell(feed.heard, session)
    calculated(feed, 0.0)
    assert feed.map is not None and not beside
    monkeypatch.setattr(live_feed, "_READINGS_APART", 100)
    tell(feed.heard, session, slice(0, 200), start=START + 10**12)
    calculated(feed, feed._due)
    assert len(beside) == 1 and feed.map is not None and feed.map.whose == "calculated here from 200 readings"


def test_the_estimators_map_is_shown_until_readings_come(feed: Feed, session: Session) -> None:
    tell(feed.heard, session, slice(0, 144))
    calculated(feed, 0.0)
    found = identify(session)
    points, error, wide = found.error_map.points, found.error_map.error, found.error_map.uncertainty
    columns = {f"{what}{axis}": values[:, k] for what, values in (("", points), ("e", error), ("u", wide))
               for k, axis in enumerate("xyz")}  # fmt: skip
    feed.heard.publish(error_map=columns, document=json.dumps(found.document()))
    feed.heard.publish(residuals={"row": np.arange(2.0), "setup": np.zeros(2), "residual": np.full(2, 1e-6)})
    calculated(feed, feed._due)
    assert feed.map is not None and feed.map.whose == "published by the estimator"
    np.testing.assert_array_equal(feed.map.error_map.uncertainty, wide)
    assert feed.map.residual.tolist() == [1e-6, 1e-6] and ("readings used", "288 of 288") in feed.map.rows
    tell(feed.heard, session)
    calculated(feed, feed._due)
    assert feed.map.whose == "calculated here from 288 readings"


@pytest.mark.parametrize("document", ["{", "[1]", "7", '{"format": "mtcal-result/1"}', '{"effects": 3}'])
def test_a_published_document_that_is_none_is_passed_over(feed: Feed, document: str) -> None:
    feed.heard.publish(document=document)
    feed.look(0.0)
    assert feed.map is None


def test_what_was_heard_becomes_a_session_once(
    feed: Feed, session: Session, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("rclpy", reason="only with ROS 2 is anything heard")
    monkeypatch.chdir(tmp_path)
    with pytest.raises(CalibrationError, match="no readings"):
        feed.keep()
    tell(feed.heard, session, slice(0, 20))
    with pytest.raises(CalibrationError, match="needs at least 2"):
        feed.keep()
    assert not list(tmp_path.iterdir()), "what does not suffice is not written"
    tell(feed.heard, session)
    kept = feed.keep()
    assert feed.keep() == kept
    taken = load(kept).sessions[0]
    np.testing.assert_array_equal(taken.readings.displacement, session.readings.displacement)
    assert taken.description == session.description


def test_the_graphs_own_recording_is_opened_where_it_is_finished_and_whole(
    feed: Feed, session: Session, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("rclpy", reason="only with ROS 2 is anything heard")
    monkeypatch.chdir(tmp_path)
    tell(feed.heard, session, slice(0, 200))
    bag = tmp_path / "bag"
    feed.heard.say(NodeState("recorder", "recorder", 0, "recording", {"bag": str(bag)}, at=1.0, repeats=True))
    assert feed.keep() != bag, "it is not there"
    tell(feed.heard, session, slice(0, 250))
    session_to_bag(session.with_readings(session.readings.select(np.arange(288) < 249)), bag, start=START)
    assert feed.keep() != bag, "it lacks what was heard"
    whole = tmp_path / "whole"
    session_to_bag(session, whole, start=START)
    feed.heard.say(NodeState("recorder", "recorder", 0, "recording", {"bag": str(whole)}, at=2.0, repeats=True))
    tell(feed.heard, session, slice(0, 20), start=START + 10**12)
    assert feed.keep() == whole, "though what was heard does not suffice"


def test_without_ros_the_page_says_so_in_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "diagnostic_msgs.msg", None)
    monkeypatch.delitem(sys.modules, "machine_tool_calibration.nodes.client", raising=False)
    feed = Feed()
    feed.look(0.0)
    feed.close()
    assert "needs ROS 2 (" in feed.trouble and "\n" not in feed.trouble
