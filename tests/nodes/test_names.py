# SPDX-License-Identifier: Apache-2.0
"""Topics and services of a node's own follow its name."""

from rclpy.parameter import Parameter
from std_msgs.msg import String
from std_srvs.srv import Trigger

from machine_tool_calibration.nodes.ros.messages import LATCHED
from machine_tool_calibration.nodes.ros.names import OwnPublisher, offer
from machine_tool_calibration.nodes.ros.node import GuardedNode

from .conftest import PATIENCE, ask


def made(bench, name, **parameters):
    """A node that says its name and answers with it, beside the bench's operator."""
    operator = bench.operator()
    given = [Parameter(key, value=value) for key, value in parameters.items()]
    node = GuardedNode(name, context=operator._guest.context, parameter_overrides=given)
    operator._guest.executor.add_node(node)
    bench.stack.callback(node.destroy_node)
    OwnPublisher(node, "estimator", "words", String, LATCHED).publish(String(data=name))
    offer(node, "estimator", "reset", lambda answer: answer.send(True, name))
    return operator, node


def names(operator, node):
    """What a node publishes and serves below a name, as others see it."""
    found = set()

    def complete():
        topics = operator._node.get_publisher_names_and_types_by_node(node, "/")
        services = operator._node.get_service_names_and_types_by_node(node, "/")
        found.update(name for name, types in topics if types == ["std_msgs/msg/String"])
        found.update(name for name, types in services if types == ["std_srvs/srv/Trigger"])
        return len(found) >= 2

    assert operator.wait(complete, PATIENCE)
    return found


def test_a_node_of_the_usual_name_has_each_name_once(bench):
    operator, _ = made(bench, "estimator")
    assert names(operator, "estimator") == {"/estimator/words", "/estimator/reset"}


def test_a_renamed_node_takes_its_names_along_and_keeps_the_old_ones_for_a_release(bench):
    operator, _ = made(bench, "second")
    assert operator.wait(lambda: len(names(operator, "second")) == 4, PATIENCE)
    assert names(operator, "second") == {"/second/words", "/second/reset", "/estimator/words", "/estimator/reset"}
    for service in ("second/reset", "estimator/reset"):
        answer = ask(operator, Trigger, service, Trigger.Request())
        assert (answer.success, answer.message) == (True, "second")
    heard = []
    for topic in ("second/words", "estimator/words"):
        operator._node.create_subscription(String, topic, lambda message: heard.append(message.data), LATCHED)
    assert operator.wait(lambda: heard == ["second", "second"], PATIENCE)


def test_two_side_by_side_are_told_apart_without_the_old_names(bench):
    operator, _ = made(bench, "second", old_names=False)
    assert names(operator, "second") == {"/second/words", "/second/reset"}
