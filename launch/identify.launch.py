# SPDX-License-Identifier: Apache-2.0
"""Only what listens: an estimator and a recorder beside a graph that runs already, or beside a replay.

ros2 launch machine_tool_calibration identify.launch.py namespace:=cell_1
ros2 service call /cell_1/estimator/diagnose std_srvs/srv/Trigger

Beside a graph in simulated time, or a replay with a clock: use_sim_time:=true.
"""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, LogInfo, OpaqueFunction
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

from machine_tool_calibration.nodes.launching import switches, unknown_arguments

PACKAGE = "machine_tool_calibration"
ARGUMENTS = {
    "namespace": ("", "namespace of the graph"),
    "use_sim_time": ("false", "whether the graph or the replay has a clock"),
    "model": ("", "variant of the model, such as rigid_body"),
    "bag": ("", "folder of the recording; empty: recording_<date>_<time>"),
}


def ends(event, context):
    """Each goes on without the other, and says so."""
    name = event.action.node_name.rpartition("/")[2]
    return None if context.is_shutdown else LogInfo(msg=f"{name} has ended (status {event.returncode})")


def nodes(context):
    given = {name: LaunchConfiguration(name).perform(context) for name in ARGUMENTS}
    common = switches(given, ("use_sim_time",))
    parameters = {
        "estimator": {**common, "model": given["model"]},
        "recorder": {**common, "folder": given["bag"]},
    }
    # a graph in a namespace has its clock there too
    space = given["namespace"].strip("/")
    remappings = [("/clock", f"/{space}/clock")] if space else []
    unknown = [LogInfo(msg=text) for text in unknown_arguments(context.launch_configurations, ARGUMENTS)]
    return unknown + [
        Node(
            package=PACKAGE,
            executable=name,
            name=name,
            namespace=space,
            parameters=[values],
            remappings=remappings,
            output="screen",
            on_exit=ends,
        )
        for name, values in parameters.items()
    ]


def generate_launch_description():
    arguments = [
        DeclareLaunchArgument(name, default_value=default, description=text)
        for name, (default, text) in ARGUMENTS.items()
    ]
    return LaunchDescription([*arguments, OpaqueFunction(function=nodes)])
