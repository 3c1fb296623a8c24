"""Bundled files are found in a checkout, in a pip installation and in a colcon workspace."""

import shutil
import sys
from pathlib import Path

import pytest

from cablesense_base import CableSenseError, installation
from cablesense_base.installation import config_path


def make_installation(prefix: Path, site_packages: str) -> Path:
    """Lay out an installation under `prefix`; give the place of its config_files.py."""
    arms = prefix / "share/cablesense_ros/config/arms"
    arms.mkdir(parents=True)
    (arms / "cdsm.yaml").write_text("name: installed\n")
    package = prefix / site_packages / "cablesense_sim"
    package.mkdir(parents=True)
    return Path(shutil.copy(installation.__file__, package))


@pytest.fixture
def nowhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Cut every installation off: no checkout, no ament prefix, an empty Python prefix."""
    module = tmp_path / "a/b/c/d/cablesense_sim/config_files.py"
    module.parent.mkdir(parents=True)
    module.touch()
    monkeypatch.setattr(installation, "__file__", str(module))
    monkeypatch.delenv("AMENT_PREFIX_PATH", raising=False)
    monkeypatch.setattr(sys, "prefix", str(tmp_path / "python"))
    return tmp_path


def test_the_checkout_has_its_own_files() -> None:
    found = config_path("arms/cdsm.yaml")
    assert found.is_absolute()
    assert found.read_text(encoding="utf-8").lstrip().startswith("#")
    assert config_path("arms").is_dir()


@pytest.mark.parametrize(
    "site_packages", ["lib/python3.11/site-packages", "local/lib/python3.12/dist-packages"]
)
def test_an_installation_is_found_around_the_module(
    nowhere: Path, monkeypatch: pytest.MonkeyPatch, site_packages: str
) -> None:
    module = make_installation(nowhere / "install/cablesense_ros", site_packages)
    monkeypatch.setattr(installation, "__file__", str(module))
    assert config_path("arms/cdsm.yaml").read_text() == "name: installed\n"


def test_the_second_ament_prefix_is_searched_too(
    nowhere: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    make_installation(nowhere / "ws", "lib/python3.11/site-packages")
    monkeypatch.setenv("AMENT_PREFIX_PATH", f"{nowhere / 'other'}:{nowhere / 'ws'}")
    assert config_path("arms/cdsm.yaml").is_relative_to(nowhere / "ws")


def test_a_pip_installation_is_found_by_the_python_prefix(nowhere: Path) -> None:
    make_installation(nowhere / "python", "lib/python3.11/site-packages")
    assert config_path("arms/cdsm.yaml").is_relative_to(nowhere / "python")


def test_a_config_folder_of_another_project_does_not_pass_for_ours(nowhere: Path) -> None:
    foreign = nowhere / "a/b/c/d/config/arms"
    foreign.mkdir(parents=True)
    (foreign / "cdsm.yaml").touch()
    with pytest.raises(CableSenseError, match="no bundled file"):
        config_path("arms/cdsm.yaml")


def test_a_missing_file_says_where_it_was_sought(nowhere: Path) -> None:
    with pytest.raises(CableSenseError) as caught:
        config_path("arms/none.yaml")
    assert "'arms/none.yaml'" in str(caught.value)
    assert str(nowhere / "python/share/cablesense_ros/config") in str(caught.value)


@pytest.mark.parametrize("name", ["", "/etc/passwd", "../setup.py", "arms/../../setup.py"])
def test_a_path_out_of_the_folder_is_refused(name: str) -> None:
    with pytest.raises(CableSenseError, match="inside config/"):
        config_path(name)
