# SPDX-License-Identifier: Apache-2.0
"""The whole graph of a procedure, of any method, with a simulated machine and instrument, recorded.

ros2 launch machine_tool_calibration graph.launch.py procedure:=tracking_3d
ros2 service call /procedure/start std_srvs/srv/Trigger
ros2 service call /estimator/identify std_srvs/srv/Trigger

`procedure` is the name of one that the package brings, or a YAML file. In a namespace the graph has its own clock. The
launch ends with the first node that the measurement cannot do without, with status 1 if that node failed.
"""

import time
from pathlib import Path

import yaml
from ament_index_python.packages import get_package_share_directory
from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, LogInfo, OpaqueFunction, Shutdown
from launch.logging import launch_config
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

from machine_tool_calibration.errors import CalibrationError
from machine_tool_calibration.nodes.launching import switches, unknown_arguments
from machine_tool_calibration.nodes.measurement import site_document
from machine_tool_calibration.nodes.site import read_site
from machine_tool_calibration.procedure import read_procedure
from machine_tool_calibration.session.catalogue import method_spec

PACKAGE = "machine_tool_calibration"
ARGUMENTS = {
    "procedure": ("tracking_2d", "procedure to run: a name of config/procedures, or a YAML file"),
    "site": ("", "YAML file with what is true in the simulated workshop; empty: the usual one"),
    "namespace": ("", "namespace of all nodes"),
    "use_sim_time": ("true", "as fast as the computer can; false: in real time"),
    "driver": ("simulated", "simulated, or the YAML file of a real instrument's driver"),
    "axes": ("true", "whether the axes are simulated; false where a machine's own controller runs"),
    "pointer": ("true", "whether the rotary pointer is simulated"),
    "record": ("true", "whether a recorder runs"),
    "bag": ("", "folder of the recording; empty: recording_<date>_<time>"),
}
OPTIONAL = ("estimator", "recorder")  # both can be started again: identify.launch.py


def ends(event, context):
    """What happens when a node ends by itself."""
    name = event.action.node_name.rpartition("/")[2]
    if context.is_shutdown:
        return None
    if name in OPTIONAL:
        return LogInfo(msg=f"{name} has ended (status {event.returncode}); the other nodes go on without it")
    why = f"{name} has ended (status {event.returncode}), and nothing can be measured without it"
    if event.returncode:
        raise CalibrationError(why)  # no action makes `ros2 launch` itself return an error
    return Shutdown(reason=why)


def nodes(context):
    given = {name: LaunchConfiguration(name).perform(context) for name in ARGUMENTS}
    is_true = switches(given, ("use_sim_time", "axes", "pointer", "record"))
    procedure = Path(given["procedure"])
    if not procedure.suffix:
        procedure = Path(get_package_share_directory(PACKAGE), "config", "procedures", f"{procedure}.yaml")
    measured = read_procedure(procedure)
    # the machine's chain and travel are the procedure's; what was simulated stays with the logs of the launch
    site = Path(launch_config.log_dir, "site.yaml")
    site.write_text(yaml.safe_dump(site_document(measured, read_site(given["site"])), sort_keys=False))
    common = {"use_sim_time": is_true["use_sim_time"]}
    world = {**common, "site": str(site), "time_origin": float(int(time.time()))}
    parameters = {
        "axis_simulator": world,
        "rotary_pointer": world,
        "instrument": {**world, "driver": given["driver"]},
        "probe": world,
        "estimator": common,
        "procedure": {**common, "procedure": str(procedure)},
        "recorder": {**common, "folder": given["bag"]},
    }
    left_out = {
        name
        for name, key in (("axis_simulator", "axes"), ("rotary_pointer", "pointer"), ("recorder", "record"))
        if not is_true[key]
    } | set(method_spec(measured.session.method).unneeded)
    if not is_true["axes"]:  # a controller such as ros2_control's has joint_states, but no axes/status
        parameters["procedure"]["arrival"] = "joint_states"
    # /clock is absolute: without this two graphs in one domain would share it
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
        if name not in left_out
    ]


def generate_launch_description():
    arguments = [
        DeclareLaunchArgument(name, default_value=default, description=text)
        for name, (default, text) in ARGUMENTS.items()
    ]
    return LaunchDescription([*arguments, OpaqueFunction(function=nodes)])
