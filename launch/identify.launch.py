# SPDX-License-Identifier: Apache-2.0
"""Only what listens: an estimator and a recorder beside a graph that runs already, or beside a replay.

ros2 launch machine_tool_calibration identify.launch.py namespace:=cell_1
ros2 service call /cell_1/estimator/diagnose std_srvs/srv/Trigger

Beside a graph in simulated time, or a replay with a clock: use_sim_time:=true.
"""

from pathlib import Path

from ament_index_python.packages import get_package_share_directory
from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.substitutions import LaunchConfiguration

from machine_tool_calibration.nodes.graph import managed_nodes, refuse_unknown, switches
from machine_tool_calibration.recording.writer import make_folder

CONFIG = Path(get_package_share_directory("machine_tool_calibration"), "config")
ARGUMENTS = {
    "namespace": ("", "namespace of the graph"),
    "use_sim_time": ("false", "whether the graph or the replay has a clock"),
    "model": ("", "variant of the model, such as rigid_body"),
    "bag": ("", "folder of the recording; empty: recording_<date>_<time>"),
    "params_file": (str(CONFIG / "nodes.yaml"), "ROS parameters of the nodes; arguments count more"),
    "autostart": ("true", "whether the nodes are configured and activated; false: by a lifecycle manager"),
}


def nodes(context):
    refuse_unknown("identify.launch.py", context.launch_configurations, ARGUMENTS)
    given = {name: LaunchConfiguration(name).perform(context) for name in ARGUMENTS}
    is_true = switches(given, ("use_sim_time", "autostart"))
    common = {"use_sim_time": is_true["use_sim_time"]}
    parameters = {
        "estimator": {**common, **({"model": given["model"]} if given["model"] else {})},
        "recorder": {**common, "folder": given["bag"]},
    }
    if given["bag"]:
        make_folder(Path(given["bag"]))
    return managed_nodes(parameters, given["namespace"], given["params_file"], autostart=is_true["autostart"])


def generate_launch_description():
    arguments = [
        DeclareLaunchArgument(name, default_value=default, description=text)
        for name, (default, text) in ARGUMENTS.items()
    ]
    return LaunchDescription([*arguments, OpaqueFunction(function=nodes)])
