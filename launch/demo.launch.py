"""A generated lime plant (or a scene file), a mock arm and the planner, on this machine only.

ros2 launch lime_planner demo.launch.py [scene:=file.npz] [seed:=7] [controller:=jtc|kinova] [robot:=kinova_j2s6s200]
ros2 service call /lime_planner/plan std_srvs/srv/Trigger
"""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, LogInfo, SetEnvironmentVariable
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue

from lime_planner.robot.builtin import demo_arm


def generate_launch_description():
    arm, why_not_the_default = demo_arm()
    arguments = [
        DeclareLaunchArgument("scene", default_value="", description="Scene file; empty: a generated plant."),
        DeclareLaunchArgument("seed", default_value="7", description="Seed of the plant."),
        DeclareLaunchArgument("density", default_value="medium", description="Foliage: sparse, medium or dense."),
        DeclareLaunchArgument("robot", default_value=arm, description="kinova_j2s6s200 or kinova_j2n6s300."),
        DeclareLaunchArgument("controller", default_value="jtc", description="What the mock arm imitates: jtc or kinova."),
    ]
    robot = ParameterValue(LaunchConfiguration("robot"), value_type=str)
    controller = ParameterValue(LaunchConfiguration("controller"), value_type=str)
    scene = {
        "file": ParameterValue(LaunchConfiguration("scene"), value_type=str),
        "seed": ParameterValue(LaunchConfiguration("seed"), value_type=int),
        "density": ParameterValue(LaunchConfiguration("density"), value_type=str),
    }
    nodes = [
        Node(package="lime_planner", executable="scene_node", parameters=[scene], output="screen"),
        Node(package="lime_planner", executable="mock_arm_node", parameters=[{"robot": robot, "controller": controller}], output="screen"),
        Node(package="lime_planner", executable="planner_node", parameters=[{"robot": robot, "controller": controller}], output="screen"),
    ]
    # The arm is a mock, but its topics have the real one's names: nothing of this may reach another machine.
    said = [LogInfo(msg=why_not_the_default)] if why_not_the_default else []
    return LaunchDescription([*said, SetEnvironmentVariable("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST"), *arguments, *nodes])
