"""A real `colcon build` of the tracked files lays out what `ros2 run` and `ros2 launch` seek."""

import os
import shutil
import subprocess
import sys
import warnings
from pathlib import Path

import pytest
from colcon_core.task.python.test import has_test_dependency

pytestmark = pytest.mark.slow

CHECKOUT = Path(__file__).resolve().parents[2]


def tracked_files() -> list[Path]:
    """List the files that git tracks and that are there."""
    listed = subprocess.run(
        ["git", "ls-files", "-z"], cwd=CHECKOUT, capture_output=True, check=False, text=True
    )
    if listed.returncode:
        pytest.skip("no git checkout here: nothing says which files are tracked")
    names = [Path(name) for name in listed.stdout.split("\0") if name]
    return [name for name in names if (CHECKOUT / name).is_file()]


@pytest.fixture(scope="module")
def build(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    """Build a fresh workspace; give the folder of the installed package and what colcon said."""
    workspace = tmp_path_factory.mktemp("workspace")
    source = workspace / "src/cablesense"
    for name in tracked_files():
        (source / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(CHECKOUT / name, source / name)
    environment = {k: v for k, v in os.environ.items() if k != "PYTHONDONTWRITEBYTECODE"}
    colcon = [sys.executable, "-m", "colcon", "--log-base", "log", "build"]
    done = subprocess.run(
        [*colcon, "--event-handlers", "console_direct+"],
        cwd=workspace,
        env=environment | {"COLCON_HOME": str(workspace), "AMENT_PREFIX_PATH": ""},
        capture_output=True,
        check=False,
        text=True,
        timeout=100,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return workspace / "install/cablesense_ros", done.stdout + done.stderr


@pytest.mark.parametrize(
    "place",
    [
        "lib/cablesense_ros/cablesense",
        "lib/cablesense_ros/estimator",
        "lib/cablesense_ros/page",
        "lib/cablesense_ros/sim",
        "share/ament_index/resource_index/packages/cablesense_ros",
        "share/cablesense_ros/package.xml",
        "share/cablesense_ros/config/arms/cdsm.yaml",
    ],
)
def test_every_file_lies_where_ros_seeks_it(build: tuple[Path, str], place: str) -> None:
    assert (build[0] / place).is_file()


@pytest.mark.parametrize("folder", ["config", "cablesense_ros/launch"])
def test_all_arms_models_parameters_and_launch_files_are_installed(
    build: tuple[Path, str], folder: str
) -> None:
    tracked = {n.relative_to(folder) for n in tracked_files() if n.is_relative_to(folder)}
    installed = build[0] / "share/cablesense_ros" / Path(folder).name
    assert {p.relative_to(installed) for p in installed.rglob("*") if p.is_file()} == tracked


def test_colcon_takes_pytest_for_the_tests() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)
        import setuptools  # brings distutils, which Python 3.12 lacks

        declared = setuptools.distutils.core.run_setup(CHECKOUT / "setup.py", stop_after="init")
    assert has_test_dependency({"extras_require": declared.extras_require}, "pytest")


def test_programs_can_be_run(build: tuple[Path, str]) -> None:
    for program in (build[0] / "lib/cablesense_ros").iterdir():
        assert os.access(program, os.X_OK), program


def test_colcon_has_nothing_to_complain_of(build: tuple[Path, str]) -> None:
    assert "warning" not in build[1].lower(), build[1]


def test_installed_packages_find_the_installed_arm_files(
    build: tuple[Path, str], tmp_path: Path
) -> None:
    (site_packages,) = build[0].glob("**/cablesense_sim/..")
    script = (
        "import cablesense_training, cablesense_ros\n"
        "from cablesense_base.installation import config_path\n"
        "print(cablesense_training.__file__)\n"
        "print(cablesense_ros.__file__)\n"
        "print(config_path('arms/cdsm.yaml'))\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", script],
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": str(site_packages), "AMENT_PREFIX_PATH": ""},
        capture_output=True,
        check=True,
        text=True,
        timeout=60,
    )
    for line in done.stdout.splitlines():
        assert Path(line).is_relative_to(build[0]), line
