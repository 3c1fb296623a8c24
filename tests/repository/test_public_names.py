"""The short names of the packages: all there, and imported when they are used."""

import subprocess
import sys

import pytest

import cablesense_contact
import cablesense_gap
import cablesense_online
import cablesense_recording
import cablesense_sim
import cablesense_training


@pytest.mark.parametrize(
    "package",
    [
        cablesense_sim,
        cablesense_recording,
        cablesense_contact,
        cablesense_training,
        cablesense_gap,
        cablesense_online,
    ],
    ids=lambda package: package.__name__,
)
def test_every_name_is_there(package):
    assert package.__all__
    for name in package.__all__:
        assert getattr(package, name).__doc__
    with pytest.raises(AttributeError, match="Winch"):
        _ = package.Winch


def test_to_import_the_package_imports_no_heavy_library():
    code = "import sys, cablesense_sim; print({'mujoco', 'numpy', 'scipy'} & set(sys.modules))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "set()"
