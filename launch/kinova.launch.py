"""The planner for a real Kinova Gen2 arm behind Kinova's driver; motion is disabled until the parameter file says otherwise.

ros2 launch lime_planner kinova.launch.py model:=j2s6s200 stem_cloud:=/camera/stems rviz:=true
"""

from pathlib import Path

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

from lime_planner.ros.launching import CLOUDS, LOG_LEVELS, cloud_remappings, flag, log_arguments, rviz_remappings

SHARE = Path(__file__).resolve().parent.parent
MODELS = ["j2s6s200", "j2n6s300"]


def _nodes(context):
    def given(name):
        return LaunchConfiguration(name).perform(context)

    model, namespace = given("model"), given("namespace")
    topics = {name: given(name) for name in CLOUDS}
    simulated = {"use_sim_time": flag("use_sim_time", given("use_sim_time"))}
    planner = Node(
        package="lime_planner",
        executable="planner_node",
        namespace=namespace,
        parameters=[given("params") or str(SHARE / "config" / f"kinova_{model}.yaml"), simulated],
        remappings=[
            ("joint_states", f"/{model}_driver/out/joint_state"),
            ("joint_trajectory", f"/{model}_driver/trajectory_controller/command"),
            *cloud_remappings(topics),
        ],
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
        arguments=["-d", str(SHARE / "rviz" / "kinova.rviz")],
    )
    return [planner, rviz]


def generate_launch_description():
    arguments = [
        DeclareLaunchArgument("model", default_value="j2s6s200", choices=MODELS, description="The arm's model."),
        DeclareLaunchArgument("params", default_value="", description="Parameter file; empty: config/kinova_<model>.yaml."),
        DeclareLaunchArgument("namespace", default_value="", description="Namespace of the node and its topics."),
        DeclareLaunchArgument("log_level", default_value="info", choices=LOG_LEVELS, description="Of this node alone."),
        DeclareLaunchArgument("use_sim_time", default_value="false", description="Take the time from /clock."),
        *(DeclareLaunchArgument(name, default_value="", description=f"Topic of {name}; empty: {name}.") for name in CLOUDS),
        DeclareLaunchArgument("rviz", default_value="false", description="Show the arm, clouds, target and plan in RViz."),
    ]
    return LaunchDescription([*arguments, OpaqueFunction(function=_nodes)])
