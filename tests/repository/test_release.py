"""A release: what its wheels and source distributions hold, and that they work where they land."""

import json
import os
import re
import subprocess
import sys
import tarfile
import tomllib
import zipfile
from email import message_from_bytes
from email.message import Message
from importlib.metadata import distribution
from pathlib import Path

import pytest
import yaml
from catkin_pkg.package import parse_package

from tests.helpers.checkout import CHECKOUT

VERSION = distribution("cablesense_ros").version
DEMO = ("demo", "--headless", "--duration", "4", "--no-commission", "--json")
"""Without the commissioning, which has tests of its own and wants processors that are not busy."""
pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def release(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Build a release; give the folder of its files."""
    folder = tmp_path_factory.mktemp("release")
    subprocess.run(
        [sys.executable, str(CHECKOUT / ".ci/release"), str(folder)],
        check=True,
        capture_output=True,
        timeout=150,
    )
    return folder


@pytest.fixture(scope="module")
def wheel(release: Path) -> Path:
    """The wheel of the code."""
    return release / f"cablesense_ros-{VERSION}-py3-none-any.whl"


@pytest.fixture(scope="module")
def environment(
    release: Path, tmp_path_factory: pytest.TempPathFactory
) -> tuple[Path, dict[str, str]]:
    """Install both wheels; give the folder of programs, and the variables to run them with.

    What they depend on is taken from here: pip would fetch nearly a gigabyte.
    """
    venv = tmp_path_factory.mktemp("installed") / "venv"
    subprocess.run([sys.executable, "-m", "venv", "--without-pip", str(venv)], check=True)
    pip = [sys.executable, "-m", "pip", "--python", str(venv / "bin/python"), "install"]
    wheels = sorted(map(str, release.glob("*.whl")))
    clean = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    subprocess.run(
        [*pip, "--quiet", "--no-deps", *wheels], check=True, capture_output=True, env=clean
    )
    others = os.pathsep.join(path for path in sys.path if path.endswith("site-packages"))
    return venv / "bin", {**clean, "PYTHONPATH": others}


def metadata_of(wheel: Path) -> Message:
    """Read the metadata of a wheel."""
    with zipfile.ZipFile(wheel) as archive:
        (name,) = [name for name in archive.namelist() if name.endswith(".dist-info/METADATA")]
        return message_from_bytes(archive.read(name))


def test_a_release_is_two_wheels_and_two_source_distributions(release: Path) -> None:
    names = {path.name for path in release.iterdir()}
    assert names == {
        f"cablesense-{VERSION}-py3-none-any.whl",
        f"cablesense-{VERSION}.tar.gz",
        f"cablesense_ros-{VERSION}-py3-none-any.whl",
        f"cablesense_ros-{VERSION}.tar.gz",
    }


def test_every_place_has_the_same_version() -> None:
    citation = yaml.safe_load((CHECKOUT / "CITATION.cff").read_text(encoding="utf-8"))
    project = tomllib.loads((CHECKOUT / "distribution/pyproject.toml").read_text(encoding="utf-8"))
    versions = {
        citation["version"],
        project["project"]["version"],
        parse_package(CHECKOUT).version,
        parse_package(CHECKOUT / "cablesense_msgs").version,
    }
    assert versions == {VERSION}
    extras = project["project"]["optional-dependencies"]
    named = [
        *project["project"]["dependencies"],
        *(one for extra in extras.values() for one in extra),
    ]
    assert all(one.endswith(f"=={VERSION}") for one in named)


def test_the_distribution_without_code_asks_for_extras_that_are_there(release: Path) -> None:
    whole = metadata_of(release / f"cablesense-{VERSION}-py3-none-any.whl")
    ours = metadata_of(release / f"cablesense_ros-{VERSION}-py3-none-any.whl")
    wanted = whole.get_all("Requires-Dist") or []
    extras = {extra for one in wanted for extra in re.findall(r"\[(\w+)\]", one)}
    assert extras == {"demo", "gap", "train"}
    assert extras <= set(ours.get_all("Provides-Extra") or [])


def test_the_description_has_no_link_that_leads_nowhere(wheel: Path) -> None:
    metadata = metadata_of(wheel)
    assert metadata["Description-Content-Type"] == "text/markdown"
    description = metadata.get_payload()
    assert description.startswith("# CableSense")
    assert re.findall(r"\]\((?!https?:)", description) == []


def test_a_source_distribution_has_what_its_wheel_is_made_of(release: Path) -> None:
    folder = f"cablesense_ros-{VERSION}"
    with tarfile.open(release / f"{folder}.tar.gz") as archive:
        names = set(archive.getnames())
    for name in ("LICENSE", "NOTICE", "README.md", "CHANGELOG.md", "CITATION.cff", "package.xml"):
        assert f"{folder}/{name}" in names
    assert f"{folder}/training/law/build.py" in names


def test_a_wheel_carries_all_rooms_and_the_config(wheel: Path) -> None:
    names = zipfile.ZipFile(wheel).namelist()
    for package in ("msgs_py", "sim", "training", "gap", "ros"):
        assert f"cablesense_{package}/__init__.py" in names
    for data in ("diagnosis/calibration.json", "report/report.html", "report/page.css"):
        assert f"cablesense_gap/{data}" in names
    assert {"cablesense_ros/parameters.yaml", "cablesense_online/page/panel.html"} <= set(names)
    for folder in CHECKOUT.glob("training/*/__init__.py"):
        assert f"cablesense_training/{folder.parent.name}/__init__.py" in names
    for shared in ("cablesense_ros/config/arms/cdsm.yaml", "man/man1/cablesense.1"):
        assert any(name.endswith(f"share/{shared}") for name in names), shared
    assert {Path(n).name for n in names if ".dist-info/" in n} >= {"LICENSE", "NOTICE"}
    assert not any(n.startswith(("tests/", "paper/", "examples/")) for n in names)


@pytest.mark.ros
@pytest.mark.timeout(400)
def test_an_installed_wheel_plays_the_demo(
    environment: tuple[Path, dict[str, str]], tmp_path: Path
) -> None:
    """The statics of arms are compiled in the new environment first, which the demo says."""
    programs, variables = environment
    packages = programs.parent.glob("lib/*/site-packages/cablesense_sim/__pycache__/*.nbi")
    is_fresh = not any(packages)  # a repetition of this test finds compiled code
    done = subprocess.run(
        [str(programs / "cablesense"), *DEMO],
        cwd=tmp_path,
        env=variables,
        capture_output=True,
        check=False,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["arm"]
    assert ("compiles the statics" in done.stderr) == is_fresh
    for log in (tmp_path / "out/demo/logs").iterdir():
        assert "compiles the statics" not in log.read_text(encoding="utf-8"), log.name


def test_an_installed_wheel_estimates(
    environment: tuple[Path, dict[str, str]], tmp_path: Path
) -> None:
    programs, variables = environment
    done = subprocess.run(
        [str(programs / "cablesense"), "evaluate", "--table2", "--json"],
        cwd=tmp_path,
        env=variables,
        capture_output=True,
        check=False,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    rows = json.loads(done.stdout)["rows"]
    assert [row["segment"] for row in rows] == [row["true_segment"] for row in rows]


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_an_installed_wheel_completes_in_shells(
    environment: tuple[Path, dict[str, str]], tmp_path: Path, shell: str
) -> None:
    programs, variables = environment
    # else Typer prints that of the shell in which the tests run, which in CI is none
    named = {**variables, "_TYPER_COMPLETE_TEST_DISABLE_SHELL_DETECTION": "1"}
    done = subprocess.run(
        [str(programs / "cablesense"), "--show-completion", shell],
        cwd=tmp_path,
        env=named,
        capture_output=True,
        check=True,
        text=True,
    )
    assert "_CABLESENSE_COMPLETE" in done.stdout


def test_the_manual_page_has_every_verb_and_says_nothing_that_troff_takes_amiss() -> None:
    page = subprocess.run(
        [sys.executable, str(CHECKOUT / ".ci/man")], check=True, capture_output=True, text=True
    ).stdout
    for verb in ("demo", "export", "info", "gap diagnose", "sensors check", "replay"):
        assert f".SS cablesense {verb}\n" in page
    requests = {line.split()[0] for line in page.splitlines() if line.startswith((".", "'"))}
    assert requests == {".TH", ".SH", ".SS", ".TP", ".PP"}
    assert r"\-\-headless" in page
