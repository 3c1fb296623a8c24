"""The simulated arm, the estimator, the page and robot_state_publisher; RViz with rviz:=true."""

from ament_index_python.packages import get_package_share_directory
from launch import LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, IncludeLaunchDescription, OpaqueFunction
from launch.conditions import IfCondition
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue

from cablesense_sim.arm import open_arm
from cablesense_sim.model import urdf_xml

PACKAGE = "cablesense_ros"


def generate_launch_description() -> LaunchDescription:
    """What to start, and when."""
    share = get_package_share_directory(PACKAGE)
    arguments = [
        DeclareLaunchArgument("arm", default_value="cdsm", description="arm file: name or path"),
        DeclareLaunchArgument("model", default_value="", description="model file: name or path"),
        DeclareLaunchArgument(
            "breathe",
            default_value="none",
            choices=["none", "on_request", "continuous"],
            description="start the breather, as in estimator.launch.py",
        ),
        DeclareLaunchArgument("rviz", default_value="false", description="start rviz2 as well"),
    ]
    estimator = IncludeLaunchDescription(
        PythonLaunchDescriptionSource(
            PathJoinSubstitution([share, "launch", "estimator.launch.py"])
        ),
        launch_arguments={
            "source": "sim",
            "arm": LaunchConfiguration("arm"),
            "model": LaunchConfiguration("model"),
            "breathe": LaunchConfiguration("breathe"),
        }.items(),
    )
    page = Node(
        package=PACKAGE,
        executable="page",
        name="page",
        output="screen",
        parameters=[{"arm": ParameterValue(LaunchConfiguration("arm"), value_type=str)}],
    )
    rviz = Node(
        package="rviz2",
        executable="rviz2",
        name="rviz2",
        arguments=["-d", PathJoinSubstitution([share, "config", "layouts", "cablesense.rviz"])],
        condition=IfCondition(LaunchConfiguration("rviz")),
    )
    frames = OpaqueFunction(function=_state_publisher)
    return LaunchDescription([*arguments, estimator, frames, page, rviz])


def _state_publisher(context: LaunchContext) -> list[Node]:
    arm = open_arm(LaunchConfiguration("arm").perform(context))
    return [
        Node(
            package="robot_state_publisher",
            executable="robot_state_publisher",
            name="robot_state_publisher",
            parameters=[{"robot_description": ParameterValue(urdf_xml(arm), value_type=str)}],
        )
    ]
