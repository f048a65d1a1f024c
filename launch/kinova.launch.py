"""The planner for a real Kinova Gen2 arm behind Kinova's driver; motion is disabled until the parameter file says otherwise.

ros2 launch lime_planner kinova.launch.py model:=j2s6s200
"""

from pathlib import Path

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

CONFIG = Path(__file__).resolve().parent.parent / "config"
MODELS = ["j2s6s200", "j2n6s300"]


def _planner(context):
    model = LaunchConfiguration("model").perform(context)
    params = LaunchConfiguration("params").perform(context) or str(CONFIG / f"kinova_{model}.yaml")
    return [
        Node(
            package="lime_planner",
            executable="planner_node",
            parameters=[params],
            remappings=[
                ("joint_states", f"/{model}_driver/out/joint_state"),
                ("joint_trajectory", f"/{model}_driver/trajectory_controller/command"),
            ],
            output="screen",
            respawn=True,
            respawn_delay=2.0,
        )
    ]


def generate_launch_description():
    arguments = [
        DeclareLaunchArgument("model", default_value="j2s6s200", choices=MODELS, description="The arm's model."),
        DeclareLaunchArgument("params", default_value="", description="Parameter file; empty: config/kinova_<model>.yaml."),
    ]
    return LaunchDescription([*arguments, OpaqueFunction(function=_planner)])
