"""A real `colcon build` of the tracked files lays out what `ros2 run` and `ros2 launch` seek."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from tests.helpers.checkout import CHECKOUT

pytestmark = pytest.mark.slow


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
        env=environment | {"COLCON_HOME": str(workspace)},
        capture_output=True,
        check=False,
        text=True,
        timeout=100,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return workspace / "install/cablesense_ros", done.stdout + done.stderr


def test_every_file_lies_where_ros_seeks_it(build: tuple[Path, str]) -> None:
    share = build[0] / "share/cablesense_ros"
    programs = build[0] / "lib/cablesense_ros"
    assert (share / "package.xml").is_file()
    assert (share.parent / "ament_index/resource_index/packages/cablesense_ros").is_file()
    assert {"cablesense", "estimator", "page", "sim"} <= {path.name for path in programs.iterdir()}
    assert all(os.access(program, os.X_OK) for program in programs.iterdir())
    for folder in ("config", "cablesense_ros/launch"):
        tracked = {n.relative_to(folder) for n in tracked_files() if n.is_relative_to(folder)}
        placed = share / Path(folder).name
        assert {p.relative_to(placed) for p in placed.rglob("*") if p.is_file()} == tracked
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
        env={**os.environ, "PYTHONPATH": str(site_packages)},
        capture_output=True,
        check=True,
        text=True,
        timeout=60,
    )
    for line in done.stdout.splitlines():
        assert Path(line).is_relative_to(build[0]), line
