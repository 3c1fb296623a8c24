"""Nodes, launch files, the demo and the verbs: all that needs rclpy or starts nodes."""

import os
import signal
import sys
from pathlib import Path

_NODES = ("breather", "can_driver", "can_emulator", "estimator", "page", "sim")


def _program() -> str:
    """The module after `-m`, or the name of the script; never one of its arguments."""
    if sys.argv[:1] == ["-m"]:  # until the module runs, its name is known only here
        return sys.orig_argv[sys.orig_argv.index("-m") + 1]
    return Path(sys.argv[0]).name if sys.argv else ""


if _program() in {*_NODES, *(f"cablesense_ros.{name}_node" for name in _NODES)}:
    # A node imports for half a second before `node_process.run_node` handles signals. Nothing has
    # started by then, and Ctrl-C would leave a traceback.
    for _number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(_number, lambda *_: os._exit(0))
