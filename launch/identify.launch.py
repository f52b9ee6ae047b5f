"""Only what listens: an estimator and a recorder beside a graph that runs already, or beside a replay.

ros2 launch machine_tool_calibration identify.launch.py namespace:=cell_1
"""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

PACKAGE = "machine_tool_calibration"


def generate_launch_description():
    space = LaunchConfiguration("namespace")
    model = LaunchConfiguration("model")
    return LaunchDescription(
        [
            DeclareLaunchArgument("namespace", default_value="", description="namespace of the graph"),
            DeclareLaunchArgument("model", default_value="", description="variant of the model, such as rigid_body"),
            Node(
                package=PACKAGE,
                executable="estimator",
                name="estimator",
                namespace=space,
                parameters=[{"model": model}],
                output="screen",
            ),
            Node(package=PACKAGE, executable="recorder", name="recorder", namespace=space, output="screen"),
        ]
    )
