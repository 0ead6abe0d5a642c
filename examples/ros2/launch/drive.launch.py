"""Starts the node: ros2 launch nnql_bullet_ros drive.launch.py policy:=paper."""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue
from nnql_bullet_ros.messages import PARAMETERS


def generate_launch_description() -> LaunchDescription:
    """The node with its parameters."""
    values = {
        name: ParameterValue(LaunchConfiguration(name), value_type=type(value)) for name, value in PARAMETERS.items()
    }
    return LaunchDescription(
        [
            *(DeclareLaunchArgument(name, default_value=str(value)) for name, value in PARAMETERS.items()),
            Node(package="nnql_bullet_ros", executable="drive", parameters=[values], output="screen"),
        ]
    )
