"""Bundled files are found in a checkout, in a pip installation and in a colcon workspace."""

import pytest

from cablesense_base import CableSenseError, installation
from cablesense_base.installation import config_path

ARM = "arms/cdsm.yaml"


@pytest.fixture
def installed(tmp_path, monkeypatch):
    """Lays out an installation whose modules lie in a folder of the prefix."""

    def lay_out(site_packages):
        arms = tmp_path / "prefix/share/cablesense_ros/config/arms"
        arms.mkdir(parents=True)
        (arms / "cdsm.yaml").write_text("name: installed\n")
        module = tmp_path / "prefix" / site_packages / "cablesense_base/installation.py"
        monkeypatch.setattr(installation, "__file__", str(module))
        return module.parents[1]

    return lay_out


@pytest.mark.parametrize(
    "site_packages", ["lib/python3.11/site-packages", "local/lib/python3.12/dist-packages"]
)
def test_an_installation_is_found_around_the_module(installed, site_packages):
    foreign = installed(site_packages) / "config" / ARM
    foreign.parent.mkdir(parents=True)
    foreign.write_text("of another project")
    assert config_path(ARM).read_text() == "name: installed\n"


def test_a_missing_file_says_where_it_was_sought(installed):
    installed("lib/python3.11/site-packages")
    with pytest.raises(CableSenseError, match=r"arms/none.yaml .*prefix/share/cablesense_ros"):
        config_path("arms/none.yaml")


@pytest.mark.parametrize("name", ["", "/etc/passwd", "../setup.py", "arms/../../setup.py"])
def test_a_path_out_of_the_folder_is_refused(name):
    with pytest.raises(CableSenseError, match="inside config/"):
        config_path(name)
