"""Nodes, launch files and the demo: all that needs rclpy or starts nodes."""

import os
import signal
import sys
from pathlib import Path

_NODES = (
    "breather",
    "can_driver",
    "can_emulator",
    "estimator",
    "page",
    "sim",
)
_PROGRAMS = {*_NODES, *(f"cablesense_ros.{name}_node" for name in _NODES)}

if any(Path(word).name in _PROGRAMS for word in sys.orig_argv[1:3]):
    # a node imports for half a second before it takes signals (`node_process.run_node`); until
    # then nothing has begun, and Ctrl-C would leave a traceback
    for _number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(_number, lambda *_: os._exit(0))
