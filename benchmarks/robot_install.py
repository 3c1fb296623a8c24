"""What a robot's computer gets: size of the extra `robot`, time to the first wrench, memory.

    python benchmarks/robot_install.py [--starts 3] [--write]

A wheel of this checkout is installed with its extra `robot` into a fresh environment, and
measured, without pip. Wheels of ROS, which a robot has from elsewhere, are then installed there
too, and the estimator starts, while readings of the untouched arm are published. The first wrench
is the first answer to a reading that states a force; the time counts from the start of the
process.
"""

from __future__ import annotations

import argparse
import math
import os
import sys
import tempfile
import time
from collections.abc import Sequence
from importlib.metadata import requires
from pathlib import Path
from subprocess import run
from typing import NamedTuple

import harness
from geometry_msgs.msg import WrenchStamped
from live_run import LiveRun, SpunNode
from packaging.requirements import Requirement
from sensor_msgs.msg import JointState

from cablesense_msgs_py.qos import PUBLISHER_QOS, Qos
from cablesense_ros.endpoints import qos_profile
from cablesense_ros.processes import node_command
from cablesense_sim.arm import open_arm
from cablesense_sim.build import mechanism_of
from cablesense_sim.equilibrium import solve_equilibrium

CHECKOUT = Path(__file__).parents[1]
PIP = [sys.executable, "-m", "pip"]
CONSTRAINTS = ["--constraint", str(CHECKOUT / "constraints.txt")]
ARM = "cdsm_lab"
PERIOD_S = 0.002
SETTLED_S = 10.0
"""How long after the first wrench the memory is read."""
TOOLS = ("pip", "setuptools", "pkg_resources", "_distutils_hack")
"""What `venv` puts into every environment."""
SIZE_BAR_MB = 250.0
FIRST_WRENCH_BAR_S = 4.0
MEMORY_BAR_MB = 200.0


def size_mb(folder: Path, without: Sequence[str] = ()) -> float:
    """Size of all files in a folder, MB (10^6 bytes), without some of its entries."""
    counted = [entry for entry in folder.iterdir() if entry.name.split("-")[0] not in without]
    files = [file for entry in counted for file in (entry, *entry.rglob("*"))]
    return sum(file.stat().st_size for file in files if file.is_file()) / 1e6


def install(python: Path, *wanted: str) -> None:
    """Install requirements at the versions of `constraints.txt` into a Python's environment."""
    run([*PIP, "--python", str(python), "install", "-qq", *CONSTRAINTS, *wanted], check=True)


def wheel_of_checkout(folder: Path) -> Path:
    """Build the wheel of this checkout in a folder."""
    build = ["wheel", "-qq", "--no-deps", "--no-build-isolation", "--wheel-dir", str(folder)]
    run([*PIP, *build, str(CHECKOUT)], check=True)
    (wheel,) = folder.glob("*.whl")
    return wheel


def requirements_of_ros() -> list[str]:
    """What stands in for an installation of ROS: the extra `ros`."""
    wanted = [Requirement(line) for line in requires("cablesense_ros") or []]
    of_ros = [one for one in wanted if one.marker and one.marker.evaluate({"extra": "ros"})]
    return [str(one).partition(";")[0].strip() for one in of_ros]


class Source(SpunNode):
    """Publishes readings of the untouched arm, and notes the answers that state a force."""

    def __init__(self) -> None:
        super().__init__("source")
        arm = open_arm(ARM)
        at_rest_rad = [0.0] * arm.joint_count
        self._tensions_n = solve_equilibrium(mechanism_of(arm), at_rest_rad).tensions_n.tolist()
        self._names = list(arm.cable_names)
        qos = qos_profile(PUBLISHER_QOS)
        self._readings = self.create_publisher(JointState, "cable_tensions", qos)
        every = qos_profile(Qos(depth=1000, reliable=True))
        self.create_subscription(WrenchStamped, "estimator/wrench", self._note, every)
        self._sent_ns: set[int] = set()
        self.first_s = math.inf

    def publish(self) -> None:
        """Publish one reading."""
        message = JointState(name=self._names, effort=self._tensions_n)
        stamp = self.get_clock().now()
        message.header.stamp = stamp.to_msg()
        self._sent_ns.add(stamp.nanoseconds)
        self._readings.publish(message)

    def _note(self, wrench: WrenchStamped) -> None:
        stamp = wrench.header.stamp
        answers = stamp.sec * 1_000_000_000 + stamp.nanosec in self._sent_ns
        if answers and math.isfinite(wrench.wrench.force.x):
            self.first_s = min(self.first_s, time.monotonic())


class Start(NamedTuple):
    """One start of the estimator.

    Attributes:
        wrench_s: from the start of the process to the first wrench.
        cpu_s: processor time that it took up to there; other work has no part in it.
        memory_mb: when settled.
    """

    wrench_s: float
    cpu_s: float
    memory_mb: float


def start(python: Path) -> Start:
    """Start the estimator once."""
    with LiveRun() as live:
        source = Source()
        # -P: modules are those that are installed, not those of this folder
        command = node_command("estimator", {"arm": ARM, "auto_tare": True})
        estimator = live.start("estimator", [str(python), "-P", *command[1:]])

        def answered() -> bool:
            live.check()
            source.publish()
            source.spin(PERIOD_S)
            return math.isfinite(source.first_s)

        source.spin_until(answered, "the first wrench")
        cpu_s = harness.cpu_s(estimator.pid)
        settled_s = time.monotonic() + SETTLED_S
        while time.monotonic() < settled_s:
            live.check()
            source.publish()
            source.spin(PERIOD_S)
        memory_mb = harness.rss_mb(estimator.pid)
        source.destroy_node()
        return Start(source.first_s - estimator.started_s, cpu_s, memory_mb)


def main(given: argparse.Namespace) -> int:
    """Install, start, print; write with `--write`."""
    for name in ("PYTHONPATH", "_ROS_WHEELS_BOOTSTRAP_COMPLETE", "LD_LIBRARY_PATH"):
        os.environ.pop(name, None)  # the fresh environment is to see itself alone
    with tempfile.TemporaryDirectory() as name:
        venv = Path(name) / "venv"
        run([sys.executable, "-m", "venv", str(venv)], check=True)
        python = venv / "bin/python"
        install(python, f"{wheel_of_checkout(Path(name))}[robot]")
        (packages,) = venv.glob("lib/*/site-packages")
        installed_mb = size_mb(packages, TOOLS) + size_mb(venv / "share")
        distributions = len(list(packages.glob("*.dist-info")))
        install(python, *requirements_of_ros())
        starts = [start(python) for _ in range(given.starts)]
    first_wrench_s = [round(one.wrench_s, 2) for one in starts]
    memory_mb = [round(one.memory_mb, 1) for one in starts]
    figures = {
        "load": round(os.getloadavg()[0], 2),
        "arm": ARM,
        "installed_mb": round(installed_mb, 1),
        "distributions": distributions,
        "first_wrench_s": first_wrench_s,
        "processor_s": [round(one.cpu_s, 2) for one in starts],
        "memory_mb": memory_mb,
        "bars": {
            f"at most {SIZE_BAR_MB:g} MB beside ROS": installed_mb <= SIZE_BAR_MB,
            f"first wrench within {FIRST_WRENCH_BAR_S:g} s": (
                max(first_wrench_s) <= FIRST_WRENCH_BAR_S
            ),
            f"at most {MEMORY_BAR_MB:g} MB of memory": max(memory_mb) <= MEMORY_BAR_MB,
        },
    }
    return harness.publish("robot_install.json", figures, given, "numpy", "onnxruntime")


if __name__ == "__main__":
    parser = harness.parser(__doc__, "results/robot_install.json")
    parser.add_argument("--starts", type=int, default=3, help="of the estimator")
    sys.exit(main(parser.parse_args()))
