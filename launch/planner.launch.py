"""The planner alone, started again whenever it ends unexpectedly.

ros2 launch lime_planner planner.launch.py params:=/path/to/planner.yaml namespace:=left
"""

from pathlib import Path

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

CONFIG = Path(__file__).resolve().parent.parent / "config"


def generate_launch_description():
    arguments = [
        DeclareLaunchArgument("params", default_value=str(CONFIG / "planner.yaml"), description="Parameter file."),
        DeclareLaunchArgument("namespace", default_value="", description="Namespace of the node and its topics."),
        DeclareLaunchArgument("log_level", default_value="info", description="debug, info, warn or error."),
    ]
    planner = Node(
        package="lime_planner",
        executable="planner_node",
        namespace=LaunchConfiguration("namespace"),
        parameters=[LaunchConfiguration("params")],
        arguments=["--ros-args", "--log-level", LaunchConfiguration("log_level")],
        output="screen",
        respawn=True,
        respawn_delay=2.0,
    )
    return LaunchDescription([*arguments, planner])
