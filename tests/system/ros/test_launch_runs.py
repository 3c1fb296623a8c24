"""The launch files, run by ROS 2's own `launch` where that is installed."""

import os
import signal
import sys
from importlib.metadata import entry_points

import pytest

pytest.importorskip("launch_ros", reason="needs a ROS 2 installation")
pytest.importorskip("ros2launch", reason="needs a ROS 2 installation")

from cablesense_ros.processes import Process, wait_until
from tests.helpers.checkout import CHECKOUT

PACKAGE = "cablesense_ros"
ROS2 = "import sys; from ros2cli.cli import main; sys.exit(main())"
PATIENCE_S = 60.0


@pytest.fixture(scope="module")
def prefix(tmp_path_factory):
    """This checkout laid out as an installed package."""
    root = tmp_path_factory.mktemp("prefix")
    index = root / "share/ament_index/resource_index/packages"
    programs = root / "lib" / PACKAGE
    share = root / "share" / PACKAGE
    for folder in (index, programs, share):
        folder.mkdir(parents=True)
    (index / PACKAGE).touch()
    for source, name in (("config", "config"), (f"{PACKAGE}/launch", "launch")):
        (share / name).symlink_to(CHECKOUT / source)
    for script in entry_points(group="console_scripts"):
        if script.module.startswith(f"{PACKAGE}."):
            program = programs / script.name
            program.write_text(
                f"#!{sys.executable}\nfrom {script.module} import {script.attr} as main\n"
                "raise SystemExit(main())\n"
            )
            program.chmod(0o755)
    return root


@pytest.fixture
def launch(prefix, tmp_path):
    """Run a launch file with arguments, as `ros2 launch` does."""
    started = []
    present = os.environ.get("AMENT_PREFIX_PATH")
    path = os.pathsep.join(filter(None, (str(prefix), present)))

    def run(file, *arguments):
        command = [sys.executable, "-c", ROS2, "launch"]
        command += [str(prefix / "share" / PACKAGE / "launch" / file), "description:=false"]
        environment = os.environ | {"AMENT_PREFIX_PATH": path, "ROS_LOG_DIR": str(tmp_path)}
        log = tmp_path / f"launch_{len(started)}.txt"
        started.append(Process(file, [*command, *arguments], log, environment))
        return started[-1]

    yield run
    for process in started:
        process.stop()


@pytest.mark.parametrize(
    ("given", "told"),
    [
        ({"channel": "can1"}, "channel has no effect with source:=sim"),
        ({"source": "none"}, "is not valid"),
        ({"model": "none"}, "estimator cannot be configured"),
        ({"params_file": {"tare_samples": -5}}, "estimator-2 cannot start"),
        (
            {"params_file": {"qos_overrides./cable_tensions.subscription.depth": -5}},
            "estimator cannot be activated",
        ),
    ],
)
def test_what_cannot_run_ends_the_launch_with_an_error(launch, tmp_path, given, told):
    arguments = []
    for name, value in given.items():
        if isinstance(value, dict):
            (setting,) = value.items()
            file = tmp_path / "mine.yaml"
            file.write_text("/**/estimator: {{ros__parameters: {{{}: {}}}}}\n".format(*setting))
            value = file
        arguments.append(f"{name}:={value}")
    run = launch("estimator.launch.py", *arguments)
    assert run.wait(PATIENCE_S) == 1, run.log
    assert told in run.log


def test_two_arms_run_side_by_side_and_end_with_ctrl_c(launch):
    runs = {
        arm: launch(file, f"namespace:={arm}", f"frame_prefix:={arm}_", *more)
        for arm, file, more in (
            ("left", "demo.launch.py", ()),
            ("right", "estimator.launch.py", ("source:=emulated_can",)),
        )
    }
    for arm, run in runs.items():
        tared = f"[{arm}.estimator]: tare taken"
        wait_until(lambda log=run, line=tared: line in log.log, PATIENCE_S, tared, run.check)
        run.signal(signal.SIGINT)
    for arm, run in runs.items():
        run.wait(PATIENCE_S)
        nodes = run.log.count("process started")
        assert nodes == {"left": 3, "right": 4}[arm]
        assert run.log.count("process has finished cleanly") == nodes, run.log
