"""The short names of `cablesense_sim`: all there, and imported when they are used."""

import subprocess
import sys

import pytest

import cablesense_sim


def test_every_name_is_there():
    assert {"open_arm", "Effect", "solve_equilibrium", "replay_arm"} <= set(dir(cablesense_sim))
    for name in dir(cablesense_sim):
        assert getattr(cablesense_sim, name).__doc__
    with pytest.raises(AttributeError, match="Winch"):
        _ = cablesense_sim.Winch


def test_to_import_the_package_imports_no_heavy_library():
    code = "import sys, cablesense_sim; print({'mujoco', 'numpy', 'scipy'} & set(sys.modules))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "set()"
