# SPDX-License-Identifier: Apache-2.0
"""The whole graph of a procedure, of any method, with a simulated machine and instrument, recorded.

ros2 launch machine_tool_calibration graph.launch.py procedure:=tracking_3d
ros2 service call /procedure/start std_srvs/srv/Trigger
ros2 service call /estimator/identify std_srvs/srv/Trigger

`procedure` is the name of one that the package brings, or a YAML file. In a namespace the graph has its own clock. The
launch ends with the first node that the measurement cannot do without, with status 1 if that node failed.
"""

from pathlib import Path

from ament_index_python.packages import get_package_share_directory
from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, LogInfo, OpaqueFunction, Shutdown
from launch.logging import launch_config
from launch.substitutions import LaunchConfiguration

from machine_tool_calibration.errors import CalibrationError
from machine_tool_calibration.nodes.graph import graph_parameters, managed_nodes, refuse_unknown, switches
from machine_tool_calibration.nodes.measurement import site_document
from machine_tool_calibration.procedure import read_procedure
from machine_tool_calibration.recording.writer import make_folder
from machine_tool_calibration.session.text import yaml_text
from machine_tool_calibration.simulation.site import read_site

CONFIG = Path(get_package_share_directory("machine_tool_calibration"), "config")
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
    "params_file": (str(CONFIG / "nodes.yaml"), "ROS parameters of the nodes; arguments count more"),
    "autostart": ("true", "whether the nodes are configured and activated; false: by a lifecycle manager"),
}


def ends(event, context):
    """What happens when a node ends by itself that the measurement needs."""
    name = event.action.node_name.rpartition("/")[2]
    if context.is_shutdown:
        return None
    why = f"{name} has ended (status {event.returncode}), and nothing can be measured without it"
    if event.returncode:
        raise CalibrationError(why)  # no action makes `ros2 launch` itself return an error
    return Shutdown(reason=why)


def nodes(context):
    refuse_unknown("graph.launch.py", context.launch_configurations, ARGUMENTS)
    given = {name: LaunchConfiguration(name).perform(context) for name in ARGUMENTS}
    is_true = switches(given, ("use_sim_time", "axes", "pointer", "record", "autostart"))
    procedure = Path(given["procedure"])
    if not procedure.suffix:
        procedure = CONFIG / "procedures" / f"{procedure}.yaml"
    measured = read_procedure(procedure)
    # the machine's chain and travel are the procedure's; what was simulated stays with the logs of the launch
    site = Path(launch_config.log_dir, "site.yaml")
    site.write_text(yaml_text(site_document(measured, read_site(given["site"]))), encoding="utf-8")
    parameters = graph_parameters(
        measured.session.method,
        procedure,
        site,
        simulated_time=is_true["use_sim_time"],
        driver=given["driver"],
        bag=given["bag"],
    )
    if not is_true["axes"]:  # a controller such as ros2_control's has joint_states, but no axes/executed
        parameters["procedure"]["arrival"] = "joint_states"
    left_out = {
        name
        for name, key in (("axis_simulator", "axes"), ("rotary_pointer", "pointer"), ("recorder", "record"))
        if not is_true[key]
    }
    if given["bag"] and is_true["record"]:
        make_folder(Path(given["bag"]))  # rather than measure without a recording
    chosen = {name: values for name, values in parameters.items() if name not in left_out}
    said = []
    if is_true["use_sim_time"] and not is_true["axes"]:
        space = given["namespace"].strip("/")
        topic = f"/{space}/clock" if space else "/clock"
        clock = (
            f"the nodes wait for a {topic} of yours, as the simulated axes' is missing; without one: "
            "use_sim_time:=false"
        )
        said.append(LogInfo(msg=f"axes:=false with use_sim_time:=true: {clock}"))
    started = managed_nodes(chosen, given["namespace"], given["params_file"], ends, autostart=is_true["autostart"])
    return said + started


def generate_launch_description():
    arguments = [
        DeclareLaunchArgument(name, default_value=default, description=text)
        for name, (default, text) in ARGUMENTS.items()
    ]
    return LaunchDescription([*arguments, OpaqueFunction(function=nodes)])
