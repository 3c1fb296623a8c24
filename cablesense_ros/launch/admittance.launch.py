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
    admittance = _node("admittance", [_settings(share, "admittance"), arm])
    obstacle = _node("obstacle", [_settings(share, "obstacle"), arm], when="obstacle")
    page = _node("page", [arm], when="page")
    return LaunchDescription([*_arguments(), estimator, admittance, obstacle, page])


def _node(name: str, parameters: list, when: str = "") -> Node:
    condition = {"condition": IfCondition(LaunchConfiguration(when))} if when else {}
    return Node(
        package=PACKAGE,
        executable=name,
        name=name,
        output="screen",
        parameters=parameters,
        **condition,
    )


def _settings(share: str, name: str) -> PathJoinSubstitution:
    return PathJoinSubstitution([share, "config", "nodes", f"{name}.yaml"])


def _arguments() -> list[DeclareLaunchArgument]:
    return [
        DeclareLaunchArgument(name, default_value=default, description=text)
        for name, default, text in ARGUMENTS
    ]
