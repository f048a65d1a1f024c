"""The planner alone, started again whenever it ends unexpectedly.

ros2 launch lime_planner planner.launch.py params:=/path/to/planner.yaml namespace:=left stem_cloud:=/camera/stems rviz:=true
"""

from pathlib import Path

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

from lime_planner.ros.launching import CLOUDS, LOG_LEVELS, cloud_remappings, flag, log_arguments, rviz_remappings

SHARE = Path(__file__).resolve().parent.parent


def _nodes(context):
    def given(name):
        return LaunchConfiguration(name).perform(context)

    namespace = given("namespace")
    topics = {name: given(name) for name in CLOUDS}
    simulated = {"use_sim_time": flag("use_sim_time", given("use_sim_time"))}
    planner = Node(
        package="lime_planner",
        executable="planner_node",
        namespace=namespace,
        parameters=[given("params"), simulated],
        remappings=cloud_remappings(topics),
        arguments=log_arguments("lime_planner", namespace, given("log_level")),
        output="screen",
        respawn=True,
        respawn_delay=2.0,
    )
    if not flag("rviz", given("rviz")):
        return [planner]
    rviz = Node(
        package="rviz2",
        executable="rviz2",
        parameters=[simulated],
        remappings=rviz_remappings(namespace, topics),
        arguments=["-d", str(SHARE / "rviz" / "lime_planner.rviz")],
    )
    return [planner, rviz]


def generate_launch_description():
    arguments = [
        DeclareLaunchArgument("params", default_value=str(SHARE / "config" / "planner.yaml"), description="Parameter file."),
        DeclareLaunchArgument("namespace", default_value="", description="Namespace of the node and its topics."),
        DeclareLaunchArgument("log_level", default_value="info", choices=LOG_LEVELS, description="Of this node alone."),
        DeclareLaunchArgument("use_sim_time", default_value="false", description="Take the time from /clock."),
        *(DeclareLaunchArgument(name, default_value="", description=f"Topic of {name}; empty: {name}.") for name in CLOUDS),
        DeclareLaunchArgument("rviz", default_value="false", description="Show clouds, target and plan in RViz."),
    ]
    return LaunchDescription([*arguments, OpaqueFunction(function=_nodes)])
