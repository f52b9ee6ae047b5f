# SPDX-License-Identifier: Apache-2.0
"""The listener beside a graph: whatever it is sent, in a namespace, with nodes of other names. See also test_whole."""

import signal
from contextlib import closing

import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from sensor_msgs.msg import JointState, PointCloud2
from std_msgs.msg import String

from machine_tool_calibration.errors import CalibrationError
from machine_tool_calibration.nodes.client import Client
from machine_tool_calibration.nodes.heard import Heard
from machine_tool_calibration.nodes.ros.messages import LATCHED, READINGS, SLOW, to_message

from .conftest import ORIGIN, PATIENCE

START = round(ORIGIN * 1e9)


def _beside(heard, bench, namespace=""):
    return closing(Client(bench.domain, namespace, heard).listen())


def test_messages_that_mean_nothing_are_ignored_and_the_next_are_heard(bench):
    heard, operator = Heard(), bench.operator()
    node = operator.node
    readings = node.create_publisher(JointState, "reading", READINGS)
    sessions = node.create_publisher(String, "session", LATCHED)
    maps = node.create_publisher(PointCloud2, "error_map", LATCHED)
    diagnostics = node.create_publisher(DiagnosticArray, "/diagnostics", SLOW)
    with _beside(heard, bench):
        assert operator.wait(lambda: node.count_subscribers("/diagnostics") == 2, PATIENCE)  # both clients
        sessions.publish(String(data="method: {"))
        maps.publish(PointCloud2(width=7))
        for names, values in ((["time"], []), (["x", "x"], [0.0, 0.0]), (["reading_index"], [-3.0])):
            readings.publish(JointState(name=names, position=values))
        good = JointState(name=["time", "setup_index", "displacement"], position=[1.0, 2.0, 3e-3])
        good.header.stamp = to_message(START + 10**9)
        readings.publish(good)

        def speaks() -> bool:
            diagnostics.publish(DiagnosticArray(status=[DiagnosticStatus(name="no colon"), DiagnosticStatus(
                name="milling_robot: arm", message="hot", level=bytes([7]))]))  # fmt: skip
            return any(one.message == "hot" for one in heard.nodes())

        assert operator.wait(speaks, PATIENCE)
        assert operator.wait(lambda: heard.count[1] == 1 and heard.ignored[0] == 5, PATIENCE), heard.ignored
    assert heard.rows(-1, 0)[2] == [(2, 3e-3)]
    assert not heard.description and not heard.published.number


@pytest.mark.long
def test_services_that_move_axes_are_offered_only_where_the_node_allows_it(bench):
    bench.graph(("procedure",), namespace="cell_1", more={"procedure": {"services_move_axes": False}})
    bench.graph(("procedure",), namespace="cell_2")
    strict, willing = Heard(), Heard()
    operator = bench.operator()
    with _beside(strict, bench, "cell_1"), _beside(willing, bench, "/cell_2/"):
        assert operator.wait(lambda: bool(strict.refusing) and len(willing.offers) == 4, PATIENCE)
        assert {offer.verb for offer in strict.offers} == {"pause", "abort"}
        assert {offer.verb for offer in willing.offers if offer.moves_axes} == {"start", "resume"}
        assert strict.refusing == ("procedure",) and willing.refusing == ()
        assert [one.node for one in strict.nodes()] == ["procedure"], "the other graph's nodes are not shown"


def test_a_namespace_that_is_none_is_refused_in_one_line(bench):
    with pytest.raises(CalibrationError, match=r"^'a b' is no namespace \(.*must not contain") as refused:
        Client(bench.domain, "a b")
    assert "\n" not in str(refused.value)


class Fragile:
    """Ctrl-C comes while it is destroyed, where Python ignores every exception."""

    def __del__(self) -> None:
        signal.raise_signal(signal.SIGINT)


def test_an_interruption_within_a_destructor_is_not_lost(bench):
    before = signal.signal(signal.SIGINT, signal.default_int_handler)  # whoever runs the tests may have another
    try:
        with Client(bench.domain) as client:
            client.node.every(0.01, Fragile)
            with pytest.raises(KeyboardInterrupt):
                client.wait(lambda: False, PATIENCE)
        assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
    finally:
        signal.signal(signal.SIGINT, before)


def test_the_end_of_a_service_is_as_an_interruption(bench):
    before = signal.signal(signal.SIGTERM, signal.SIG_DFL)
    try:
        with Client(bench.domain) as client:
            client.node.every(0.01, lambda: signal.raise_signal(signal.SIGTERM))
            with pytest.raises(KeyboardInterrupt):
                client.wait(lambda: False, PATIENCE)
        assert signal.getsignal(signal.SIGTERM) is signal.SIG_DFL
    finally:
        signal.signal(signal.SIGTERM, before)
