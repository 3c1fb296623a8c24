"""A robot's computer needs few packages: the estimator and the CAN driver import no heavy one."""

import json
import subprocess
import sys

import pytest
from catkin_pkg.package import parse_package

from cablesense_base.installation import EXTRAS, missing_package_line
from tests.helpers.checkout import CHECKOUT
from tests.repository.test_packaging_imports import declared, distributions_of

HEAVY = {
    *("mujoco", "scipy", "numba", "llvmlite", "torch", "sklearn", "distributed"),
    *("pandas", "pyarrow", "matplotlib", "PIL", "viser", "rosbags", "mcap"),
}
ANSWERED = """
import json, sys, time
import numpy as np
from sensor_msgs.msg import JointState
from rclpy.serialization import serialize_message
import cablesense_ros.estimator_node
from cablesense_online.estimation import Estimation
from cablesense_online.models import load_model
from cablesense_online.settings import EstimationSettings
from cablesense_online.statuses import ForceKnown
from cablesense_ros.node_process import parameter_table
from cablesense_sim.compiled import leave_interpreted

given = {parameter.name: parameter.default for parameter in parameter_table("estimator")}
degrees = {name: value for name, value in given.items() if "_deg" in name}
given |= {name.replace("_deg", "_rad"): np.deg2rad(value) for name, value in degrees.items()}
settings = EstimationSettings.model_validate(given)
loaded = load_model("cdsm_lab", "")
estimation = Estimation(loaded.machine, loaded.contacts(settings), settings, 0.0)
message = JointState(name=list(loaded.arm.cable_names), effort=[100.0] * loaded.arm.cable_count)
message.header.stamp.sec = 1
answer = estimation.sample(bytes(serialize_message(message)), 1_000_000_000, 1.0)
assert answer.stamp_ns == 1_000_000_000, answer
leave_interpreted()
known = estimation.state.unloaded.calibration
force_known = ForceKnown(loaded.machine, loaded.model, loaded.reference_contacts)
assert force_known.by(known).half_interval_n > 0.0
"""
CONDITION = "$CABLESENSE_ROBOT != 1"


def imported_by(script: str) -> set[str]:
    """Name the top-level modules that a script has imported at its end."""
    show = (
        "\nimport json, sys\nprint(json.dumps(sorted({n.partition('.')[0] for n in sys.modules})))"
    )
    done = subprocess.run(
        [sys.executable, "-c", script + show],
        check=False,
        capture_output=True,
        text=True,
        cwd=CHECKOUT,
        timeout=60,
    )
    assert done.returncode == 0, done.stderr
    return set(json.loads(done.stdout.splitlines()[-1]))


@pytest.mark.slow
@pytest.mark.parametrize(
    "script",
    [
        ANSWERED,
        "import cablesense_ros.can_driver_node",
        "import cablesense_ros.can_emulator_node",
        "import cablesense_ros.commissioner_node",
        "import cablesense_ros.breather_node",
        "import cablesense_ros.cli.app",
        "import cablesense_sim.urdf",
    ],
    ids=["an answer", "driver", "emulator", "commissioner", "breather", "command", "urdf"],
)
def test_what_a_robot_runs_imports_no_heavy_package(script: str) -> None:
    assert not imported_by(script) & HEAVY


def test_every_extra_named_in_an_error_brings_its_package() -> None:
    for module, extra in EXTRAS.items():
        assert distributions_of(module) & declared(extra), module


@pytest.mark.slow
def test_what_only_extras_bring_is_named_with_its_extra() -> None:
    extras = declared("demo", "gap", "train") - declared("")
    named = {name for module in EXTRAS for name in distributions_of(module)}
    ros = {name for name in extras if name.startswith("ros-")}
    assert extras - ros <= named


@pytest.mark.parametrize(
    ("module", "remedy"),
    [("numba.core", "'cablesense_ros[sim]'"), ("elsewhere", "pip install elsewhere")],
)
def test_a_missing_package_is_one_line_with_its_remedy(module: str, remedy: str) -> None:
    line = missing_package_line(ModuleNotFoundError(name=module))
    assert remedy in line
    assert "\n" not in line


PROGRAM = """
import sys
sys.modules[{absent!r}] = None
from cablesense_ros.programs import {program}
sys.exit({program}())
"""


@pytest.mark.slow
@pytest.mark.parametrize(
    ("program", "absent", "extra"),
    [("sim", "mujoco", "sim"), ("page", "viser", "page"), ("can_driver", "can", "robot")],
)
def test_a_program_without_its_packages_ends_with_one_line(
    program: str, absent: str, extra: str
) -> None:
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM.format(absent=absent, program=program)],
        capture_output=True,
        check=False,
        text=True,
        timeout=60,
    )
    assert done.returncode == 2
    (line,) = done.stderr.splitlines()
    assert f"'cablesense_ros[{extra}]'" in line


def test_rosdep_leaves_out_on_a_robot_what_the_extra_robot_leaves_out() -> None:
    depends = parse_package(CHECKOUT).exec_depends
    left_out = {depend.name for depend in depends if depend.condition == CONDITION}
    brought = declared("", "robot")
    for depend in depends:
        name = depend.name.removeprefix("python3-").removesuffix("-pip")
        if not depend.name.startswith("python3-") or name == "serial":
            continue
        on_a_robot = bool(distributions_of(name) & brought)
        assert on_a_robot != (depend.name in left_out), depend.name
