#!/bin/bash
# Starts a command with ROS and the workspace in its environment.
set -e
source /opt/ros/jazzy/setup.bash
source /workspace/install/setup.bash
exec "$@"
