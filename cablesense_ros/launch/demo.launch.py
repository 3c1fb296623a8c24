"""The estimator on the simulated arm and the page; RViz with rviz:=true."""

from pathlib import Path

from ament_index_python.packages import get_package_share_directory
from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, IncludeLaunchDescription
from launch.launch_description_sources import PythonLaunchDescriptionSource

WANTED = ("page",)
"""Arguments of `estimator.launch.py` that are true here; it declares all others."""


def generate_launch_description() -> LaunchDescription:
    """What to start, and when."""
    file = Path(get_package_share_directory("cablesense_ros")) / "launch" / "estimator.launch.py"
    choices = ["true", "false"]
    arguments = [
        DeclareLaunchArgument(
            name, default_value="true", choices=choices, description=f"start the {name}"
        )
        for name in WANTED
    ]
    return LaunchDescription(
        [*arguments, IncludeLaunchDescription(PythonLaunchDescriptionSource(str(file)))]
    )
