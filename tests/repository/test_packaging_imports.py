"""What the packages import is what setup.py declares: nothing by luck, nothing for nothing."""

import ast
import sys
from functools import cache
from importlib.metadata import distribution, packages_distributions
from pathlib import Path

import pytest
from catkin_pkg.package import parse_package
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from tests.helpers.checkout import CHECKOUT

PACKAGES = [
    "cablesense_base",
    "cablesense_msgs_py",
    "cablesense_sim",
    "cablesense_recording",
    "cablesense_contact",
    "training",
    "cablesense_gap",
    "examples",
    "paper",
    "cablesense_online",
    "cablesense_plants",
    "cablesense_ros",
]
_BROUGHT_BY = packages_distributions()


@cache
def imports_of(file: Path) -> set[str]:
    """Name the top-level modules that a file imports, at its head or later."""
    names: set[str] = set()
    for node in ast.walk(ast.parse(file.read_bytes())):
        if isinstance(node, ast.Import):
            names |= {alias.name.split(".")[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
            names.add(node.module.split(".")[0])
    return names


def imported(*folders: str) -> set[str]:
    """Name the top-level modules that the files under `folders` import."""
    files = [file for folder in folders for file in (CHECKOUT / folder).rglob("*.py")]
    names = set[str]().union(*map(imports_of, files))
    of_the_project = ("cablesense_", "examples", "paper", "tests")
    return {n for n in names - sys.stdlib_module_names if not n.startswith(of_the_project)}


def declared(*extras: str) -> set[str]:
    """Name the distributions that setup.py asks for with `extras`; "" stands for no extra."""
    requirements = [Requirement(line) for line in distribution("cablesense_ros").requires or []]
    return {
        canonicalize_name(requirement.name)
        for requirement in requirements
        for extra in extras
        if not requirement.marker or requirement.marker.evaluate({"extra": extra})
    }


def distributions_of(module: str) -> set[str]:
    """Name the distributions that bring a module."""
    return {canonicalize_name(name) for name in _BROUGHT_BY.get(module, [module])}


@pytest.fixture(scope="module")
def ros_modules() -> set[str]:
    """Name the modules that a ROS installation, or the ros extra, brings."""
    package = parse_package(CHECKOUT)
    return {depend.name for depend in (*package.exec_depends, *package.test_depends)}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("folders", "extras"),
    [
        (["cablesense_base", "cablesense_msgs_py"], [""]),
        # machines that MuJoCo describes need it
        (["cablesense_contact"], ["", "sim"]),
        (["cablesense_sim"], ["", "sim"]),
        (["cablesense_recording"], ["", "gap"]),
        (["training"], ["", "train"]),
        (["cablesense_gap"], ["", "gap"]),
        (["cablesense_plants"], ["", "gap"]),
        (["examples", "paper"], ["", "gap", "train", "demo"]),
        (["cablesense_online"], ["", "page", "robot", "gap"]),
        (["cablesense_ros"], ["", "demo", "gap", "train"]),
        (["tests", "benchmarks"], ["", "demo", "train", "gap", "dev"]),
    ],
    ids=lambda value: "+".join(value),
)
def test_every_import_is_declared(
    folders: list[str], extras: list[str], ros_modules: set[str]
) -> None:
    names_here = {path.stem for folder in folders for path in (CHECKOUT / folder).rglob("*")}
    for module in imported(*folders) - names_here - (ros_modules if "demo" in extras else set()):
        assert distributions_of(module) & declared(*extras), f"{module}: declare it in setup.py"


@pytest.mark.slow
def test_every_declared_distribution_is_imported() -> None:
    used = {name for module in imported(*PACKAGES) for name in distributions_of(module)}
    by_others = {"onnxscript", "ros-jazzy-common-interfaces", "ros-jazzy-rclpy"}
    assert declared("", "demo", "train", "gap") - by_others <= used


def test_the_ros_manifest_names_every_message_package(ros_modules: set[str]) -> None:
    messages = {name for name in imported("cablesense_ros") if name.endswith("_msgs")}
    assert messages <= ros_modules
