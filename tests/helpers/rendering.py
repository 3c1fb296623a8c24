"""Whether MuJoCo draws without a window here: a driver may end the process that asks it."""

import subprocess
import sys
from functools import cache

import pytest

DRAWS = """
import mujoco
with mujoco.Renderer(mujoco.MjModel.from_xml_string("<mujoco/>"), 16, 16) as renderer:
    renderer.render()
"""


@cache
def can_draw() -> bool:
    """Whether the driver that `MUJOCO_GL` names renders an empty scene."""
    probe = subprocess.run([sys.executable, "-c", DRAWS], capture_output=True, check=False)
    return probe.returncode == 0


def need_renderer() -> None:
    """Skip a test where no driver draws; where one does, what fails is no driver's fault."""
    if not can_draw():
        pytest.skip("no EGL that MuJoCo draws with: apt-get install libegl1 libgl1-mesa-dri")
