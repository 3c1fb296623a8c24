"""What a stranger installs: reasons, pins, the ROS manifest, words of failure."""

import re
import subprocess
import sys
from importlib.metadata import distribution
from pathlib import Path

import pytest
from catkin_pkg.package import parse_package
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from tests.helpers.checkout import CHECKOUT


@pytest.fixture(scope="module")
def pins() -> dict[str, str]:
    """Give the exact version of every constrained distribution."""
    lines = (CHECKOUT / "constraints.txt").read_text(encoding="utf-8").splitlines()
    return dict(line.split("==") for line in lines if not line.startswith("#"))


@pytest.fixture(scope="module")
def direct() -> list[Requirement]:
    """List the direct requirements of all extras."""
    return [Requirement(line) for line in distribution("cablesense_ros").requires or []]


def test_every_direct_requirement_is_pinned(
    pins: dict[str, str], direct: list[Requirement]
) -> None:
    for requirement in direct:
        version = pins.get(canonicalize_name(requirement.name))
        assert version is not None, f"{requirement.name}: run `make lock`"
        assert requirement.specifier.contains(version), requirement


def test_every_pin_has_the_hashes_of_its_files(pins: dict[str, str]) -> None:
    hashed = (CHECKOUT / "constraints.hashes.txt").read_text(encoding="utf-8")
    entries = re.findall(r"^(\S+)==(\S+)((?: \\\n +--hash=sha256:[0-9a-f]{64})+)$", hashed, re.M)
    assert {name: version for name, version, _ in entries} == pins, "run `make lock`"


@pytest.mark.slow
def test_the_notice_names_every_copyleft_or_unstated_licence_of_what_is_installed() -> None:
    done = subprocess.run(
        [sys.executable, CHECKOUT / ".ci/notice"], check=True, capture_output=True, text=True
    )
    committed = (CHECKOUT / "NOTICE").read_text(encoding="utf-8")
    entry = re.compile(r"^- \S+ \S+:", re.MULTILINE)
    assert set(entry.findall(done.stdout)) <= set(entry.findall(committed)), "run `make lock`"
    for known in (r"python-can \S+: LGPL-3", r"certifi \S+: Mozilla", r"scipy \S+: GPL-3"):
        assert re.search(rf"^- {known}", committed, re.MULTILINE), known


def test_no_ros_package_is_asked_of_the_package_index_by_its_bare_name(
    direct: list[Requirement],
) -> None:
    ros = {depend.name for depend in parse_package(CHECKOUT).exec_depends}
    assert not {requirement.name for requirement in direct} & ros


def test_every_requirement_of_the_nodes_has_a_rosdep_key_or_is_named_for_pip(
    direct: list[Requirement],
) -> None:
    keys = [depend.name for depend in parse_package(CHECKOUT).exec_depends]
    by_rosdep = {re.sub(r"^python3-|-pip$", "", key) for key in keys if "python3-" in key}
    development = (CHECKOUT / "docs/development.md").read_text(encoding="utf-8")
    of_all, of_a_robot = re.findall(r"^pip install ('numpy<2'.*)$", development, re.MULTILINE)
    by_pip = {canonicalize_name(Requirement(word.strip("'")).name) for word in of_all.split()}
    assert set(of_a_robot.split()) <= set(of_all.split())
    names = {"pillow": "pil", "python-can": "can", "pyyaml": "yaml"}
    for requirement in direct:
        wanted = [requirement.marker is None] + [
            requirement.marker is not None and requirement.marker.evaluate({"extra": extra})
            for extra in ("robot", "page", "gap")
        ]
        name = canonicalize_name(requirement.name)
        assert not any(wanted) or {name, names.get(name, name)} & (by_rosdep | by_pip), name


def test_the_ros_manifest_is_sound_and_agrees_with_the_distribution() -> None:
    warnings: list[str] = []
    package = parse_package(CHECKOUT, warnings=warnings)
    package.validate(warnings=warnings)
    ours = distribution("cablesense_ros")
    messages = parse_package(CHECKOUT / "cablesense_msgs", warnings=warnings)
    messages.validate(warnings=warnings)
    assert warnings == []
    assert messages.get_build_type() == "ament_cmake"
    assert messages.version == package.version
    assert package.package_format == 3
    assert package.get_build_type() == "ament_python"
    assert (package.name, package.version) == (ours.metadata["Name"], ours.version)
    assert package.licenses == [ours.metadata["License"]]


@pytest.mark.parametrize(
    ("python", "remedy"),
    [
        ("", "Python 3.11 or 3.12, and found neither; name one"),
        ("false", "make PYTHON="),
        ("no_ensurepip", "apt-get install python3-venv"),
    ],
)
def test_a_set_up_without_a_fitting_python_says_what_to_do(
    tmp_path: Path, python: str, remedy: str
) -> None:
    venv = tmp_path / "venv"
    script = tmp_path / "no_ensurepip"
    script.write_text('#!/bin/sh\ncase "$2" in *ensurepip*) exit 1 ;; esac\n')
    script.chmod(0o755)
    python = str(script) if python == script.name else python
    done = subprocess.run(
        ["make", f"PYTHON={python}", f"VENV={venv}", f"{venv}/bin/python"],
        cwd=CHECKOUT,
        capture_output=True,
        check=False,
        text=True,
    )
    assert done.returncode != 0
    (said,) = [line for line in done.stderr.splitlines() if not line.startswith("make")]
    assert remedy in said
    assert not venv.exists()
