"""Container and workspace files, as far as they can be checked without a container engine."""

import json
import re
import shlex
import subprocess
import tomllib
from pathlib import Path

import pytest
from catkin_pkg.package import parse_package

from tests.helpers.checkout import CHECKOUT
from tests.repository.test_packaging_imports import declared

IMAGES = ("Dockerfile", ".devcontainer/Dockerfile")
INSTRUCTIONS = {"FROM", "SHELL", "RUN", "WORKDIR", "ENV", "COPY", "ENTRYPOINT", "CMD", "USER"}
DEVELOPMENT = (CHECKOUT / "docs/development.md").read_text(encoding="utf-8")
OF_A_SHELL = (". ", "ros2 run", "export ")
"""Lines of the docs that an image has as its environment or its command."""


def instructions(image: str) -> list[tuple[str, str]]:
    """List the instructions of a Dockerfile, each with its text on one line."""
    lines = (CHECKOUT / image).read_text(encoding="utf-8").splitlines()
    text = "\n".join(line for line in lines if not line.startswith("#"))
    joined = re.sub(r"\\\n\s*", "", text)
    given = [line.partition(" ") for line in joined.splitlines() if line]
    return [(name, rest.strip()) for name, _, rest in given]


def runs(image: str, stage: str = "") -> list[str]:
    """List the shell commands of an image, or of one stage and the one that it begins with."""
    of_stages: dict[str, list[str]] = {}
    commands: list[str] = []
    for name, text in instructions(image):
        if name == "FROM":
            base, _, own_name = text.partition(" AS ")
            commands = list(of_stages.get(base, []))
            of_stages[own_name] = commands
        elif name == "RUN":
            commands.append(text)
    return of_stages[stage] if stage else commands


def commands_of(section: str) -> list[str]:
    """List the commands in the code blocks of one section of the page on development."""
    (text,) = re.findall(rf"^## {re.escape(section)}\n(.*?)(?=^## |\Z)", DEVELOPMENT, re.M | re.S)
    blocks = re.findall(r"^```\n(.*?)^```", text, re.MULTILINE | re.DOTALL)
    return [line for block in blocks for line in block.splitlines()]


@pytest.mark.parametrize("image", IMAGES)
def test_every_instruction_is_known_and_what_it_copies_is_there(image: str) -> None:
    given = instructions(image)
    assert given[0][0] == "FROM"
    stages: set[str] = set()
    for name, text in given:
        assert name in INSTRUCTIONS, name
        if name == "FROM":
            base, _, own_name = text.partition(" AS ")
            assert base in stages or re.fullmatch(r"[a-z]+:[a-z0-9.]+", base), base
            stages.add(own_name)
        if name == "COPY":
            source, _ = shlex.split(text)
            assert (CHECKOUT / source).exists(), source
        if name in ("SHELL", "ENTRYPOINT", "CMD"):
            assert all(isinstance(word, str) for word in json.loads(text))


@pytest.mark.parametrize("image", IMAGES)
def test_every_command_is_sound_shell(image: str) -> None:
    scripts = [*runs(image), (CHECKOUT / "docker/entrypoint.sh").read_text(encoding="utf-8")]
    for script in scripts:
        subprocess.run(["bash", "-n"], input=script, text=True, check=True)


@pytest.mark.parametrize(
    ("stage", "section"),
    [("full", "With ROS 2 Jazzy installed"), ("robot", "On a robot's computer")],
)
def test_a_stage_runs_the_commands_of_the_docs(stage: str, section: str) -> None:
    said = " \n".join(runs("Dockerfile", stage))
    plain = re.sub(r" (-y|--no-cache-dir)(?= )", "", said)
    wanted = [line for line in commands_of(section) if not line.startswith(OF_A_SHELL)]
    assert wanted
    for command in wanted:
        for part in command.split(" && "):
            assert part in plain, part
    exported = [line for line in commands_of(section) if line.startswith("export ")]
    environment = {text for name, text in instructions("Dockerfile") if name == "ENV"}
    assert {line.removeprefix("export ") for line in exported} <= environment


def test_the_dev_container_sets_up_as_contributing_says() -> None:
    text = (CHECKOUT / ".devcontainer/devcontainer.json").read_text(encoding="utf-8")
    container = json.loads(text)
    assert container["postCreateCommand"] == "make setup"
    image = Path(".devcontainer") / container["build"]["dockerfile"]
    contributing = (CHECKOUT / "CONTRIBUTING.md").read_text(encoding="utf-8")
    (needed,) = re.findall(r"^apt-get install ([^#\n]+)", contributing, re.MULTILINE)
    (installed,) = re.findall(r"--no-install-recommends ([^&]+)", " ".join(runs(str(image))))
    without_browser = set(needed.split()) - {"chromium"}  # Ubuntu has it as a snap alone
    assert without_browser <= set(installed.split())


def test_pixi_brings_the_ros_packages_of_the_manifest_and_extras_that_are_there() -> None:
    pixi = tomllib.loads((CHECKOUT / "pixi.toml").read_text(encoding="utf-8"))
    depends = parse_package(CHECKOUT).exec_depends
    of_ros = {depend.name for depend in depends if not depend.name.startswith("python3-")}
    brought = {name for name in pixi["dependencies"] if name.startswith("ros-jazzy-")}
    named = {f"ros-jazzy-{name.replace('_', '-')}" for name in of_ros}
    assert brought - named == {"ros-jazzy-ros2cli-common-extensions"}
    assert named <= brought
    extras = pixi["pypi-dependencies"]["cablesense_ros"]["extras"]
    assert all(declared(extra) for extra in extras)
    assert "ros" not in extras
    readme = (CHECKOUT / "README.md").read_text(encoding="utf-8")
    for command in pixi["tasks"].values():
        assert command.removesuffix(" --headless") in readme
