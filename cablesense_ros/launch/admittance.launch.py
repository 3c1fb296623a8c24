"""The estimator on the simulated arm, an elastic wall and the admittance node; page on request."""

from ament_index_python.packages import get_package_share_directory
from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, IncludeLaunchDescription
from launch.conditions import IfCondition
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue

PACKAGE = "cablesense_ros"
ARGUMENTS = (
    # name, default, description
    ("source", "sim", "where cable_tensions come from, as in estimator.launch.py"),
    ("arm", "cdsm", "arm file: the name of a bundled one, or a path"),
    ("model", "", "model file: the name of a bundled one, or a path; empty: the arm's own"),
    ("obstacle", "true", "start the wall that presses on the simulated arm"),
    ("page", "false", "start the page as well"),
)


def generate_launch_description() -> LaunchDescription:
    """What to start, and when."""
    share = get_package_share_directory(PACKAGE)
    estimator = IncludeLaunchDescription(
        PythonLaunchDescriptionSource(
            PathJoinSubstitution([share, "launch", "estimator.launch.py"])
        ),
        launch_arguments={
            name: LaunchConfiguration(name) for name in ("source", "arm", "model")
        }.items(),
    )
    arm = {"arm": ParameterValue(LaunchConfiguration("arm"), value_type=str)}
    settings = PathJoinSubstitution([share, "config", "nodes"])
    wanted = {
        name: {"condition": IfCondition(LaunchConfiguration(name))}
        for name in ("obstacle", "page")
    }
    nodes = [
        Node(
            package=PACKAGE,
            executable=name,
            name=name,
            output="screen",
            parameters=[*files, arm],
            **condition,
        )
        for name, files, condition in (
            ("admittance", [PathJoinSubstitution([settings, "admittance.yaml"])], {}),
            ("obstacle", [PathJoinSubstitution([settings, "obstacle.yaml"])], wanted["obstacle"]),
            ("page", [], wanted["page"]),
        )
    ]
    arguments = [
        DeclareLaunchArgument(name, default_value=default, description=text)
        for name, default, text in ARGUMENTS
    ]
    return LaunchDescription([*arguments, estimator, *nodes])
