"""The estimator on the simulated arm and the page; RViz with rviz:=true."""

from pathlib import Path

from ament_index_python.packages import get_package_share_directory
from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, IncludeLaunchDescription
from launch.launch_description_sources import PythonLaunchDescriptionSource


def generate_launch_description() -> LaunchDescription:
    """What to start, and when."""
    file = Path(get_package_share_directory("cablesense_ros")) / "launch" / "estimator.launch.py"
    page = DeclareLaunchArgument(
        "page", default_value="true", choices=["true", "false"], description="start the page"
    )
    return LaunchDescription(
        [page, IncludeLaunchDescription(PythonLaunchDescriptionSource(str(file)))]
    )
