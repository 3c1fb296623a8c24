"""The demo's nodes as command lines, and the environment that keeps them on this machine."""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Mapping

from cablesense_ros.demo.processes import ChildCommand
from cablesense_ros.discovery import RANGE, prefer_quick_discovery

DOMAINS = 100
"""Domain ids that are safe on Linux go from 0 to 101; 0 is everyone's: the demo takes 1 … 100."""


def node_command(
    name: str,
    parameters: Mapping[str, str | int | float | bool],
    remaps: Mapping[str, str] | None = None,
) -> ChildCommand:
    """The command that runs `cablesense_ros.<name>_node` in this Python.

    `remaps` gives topics other names.
    """
    command = [sys.executable, "-m", f"cablesense_ros.{name}_node", "--ros-args"]
    for topic, other in (remaps or {}).items():
        command += ["-r", f"{topic}:={other}"]
    for key, value in parameters.items():
        command += ["-p", f"{key}:={json.dumps(value, ensure_ascii=False)}"]
    return ChildCommand(name, command)


def demo_environment() -> dict[str, str]:
    """This process's environment, with DDS kept on this machine.

    Unless ROS_DOMAIN_ID is set, the nodes get a ROS domain of their own. Who sets a discovery
    range or a profile of Fast DDS gets that.
    """
    environment = dict(os.environ)
    environment.setdefault(RANGE, "LOCALHOST")
    prefer_quick_discovery(environment)
    environment.setdefault("ROS_DOMAIN_ID", str(1 + os.getpid() % DOMAINS))
    environment.setdefault("OMP_NUM_THREADS", "1")
    environment["PYTHONUNBUFFERED"] = "1"
    return environment
