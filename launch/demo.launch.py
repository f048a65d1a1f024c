"""A generated lime plant (or a scene file), a mock arm and the planner, on this machine only.

ros2 launch lime_planner demo.launch.py [scene:=file.npz] [seed:=7] [controller:=jtc|kinova] [robot:=kinova_j2s6s200] [rviz:=true]
ros2 launch lime_planner demo.launch.py camera:=all look_first:=true   # as depth cameras see it, one of them on the arm
ros2 service call /lime_planner/plan std_srvs/srv/Trigger
"""

from pathlib import Path

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction, SetEnvironmentVariable
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue

from lime_planner.ros.launching import LOG_LEVELS, flag, log_arguments, rviz_remappings

SHARE = Path(__file__).resolve().parent.parent


def _nodes(context):
    def given(name):
        return LaunchConfiguration(name).perform(context)

    def text(name):  # as it is: launch would read 1e5 as a number, and an empty text as nothing
        return ParameterValue(LaunchConfiguration(name), value_type=str)

    namespace, simulated = given("namespace"), {"use_sim_time": flag("use_sim_time", given("use_sim_time"))}
    arm = {"robot": text("robot"), "controller": text("controller"), **simulated}
    scene = {"file": text("scene"), "seed": int(given("seed")), "density": text("density"), **simulated}
    camera, looking = given("camera"), {}
    if camera:
        scene |= {"camera": text("camera"), "labelled": True, "robot": text("robot")}
    if camera in ("wrist", "all"):  # the scene node tells on /tf_static where its cameras are
        looking = {"camera_frame": "wrist_camera", "look_first": flag("look_first", given("look_first"))}
    levels = {name: log_arguments(name, namespace, given("log_level")) for name in ("scene", "mock_arm", "lime_planner")}
    common = {"package": "lime_planner", "namespace": namespace, "output": "screen"}
    nodes = [
        Node(executable="scene_node", parameters=[scene], arguments=levels["scene"], **common),
        Node(executable="mock_arm_node", parameters=[arm], arguments=levels["mock_arm"], **common),
        Node(executable="planner_node", parameters=[arm | looking], arguments=levels["lime_planner"], **common),
    ]
    if flag("rviz", given("rviz")):
        rviz = ["-d", str(SHARE / "rviz" / "lime_planner.rviz")]
        remappings = rviz_remappings(namespace, {})
        nodes.append(Node(package="rviz2", executable="rviz2", parameters=[simulated], remappings=remappings, arguments=rviz))
    return nodes


def generate_launch_description():
    arguments = [
        DeclareLaunchArgument("scene", default_value="", description="Scene file; empty: a generated plant."),
        DeclareLaunchArgument("seed", default_value="7", description="Seed of the plant."),
        DeclareLaunchArgument("density", default_value="medium", description="Foliage: sparse, medium or dense."),
        DeclareLaunchArgument("robot", default_value="kinova_j2s6s200", description="kinova_j2s6s200 or kinova_j2n6s300."),
        DeclareLaunchArgument("controller", default_value="jtc", description="What the mock arm imitates: jtc or kinova."),
        DeclareLaunchArgument(
            "camera", default_value="", description="Who sees the plant: wrist, fixed or all depth cameras; empty: every point."
        ),
        DeclareLaunchArgument("look_first", default_value="false", description="Look with the camera on the arm before a reach."),
        DeclareLaunchArgument("namespace", default_value="", description="Namespace of the nodes and their topics."),
        DeclareLaunchArgument("log_level", default_value="info", choices=LOG_LEVELS, description="Of these nodes alone."),
        DeclareLaunchArgument("use_sim_time", default_value="false", description="Take the time from /clock."),
        DeclareLaunchArgument("rviz", default_value="false", description="Show clouds, target and plan in RViz."),
    ]
    # The arm is a mock, but its topics have the real one's names: nothing of this may reach another machine.
    here = SetEnvironmentVariable("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    return LaunchDescription([here, *arguments, OpaqueFunction(function=_nodes)])
