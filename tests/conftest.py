"""No test draws on a screen, sends a ROS message off this machine or takes one of another run.

Nor does a test spread small matrices over threads, or fail because the machine is busy.
"""

import os
from pathlib import Path

import hypothesis
import pytest

from cablesense_ros.discovery import free_domain

os.environ["MPLBACKEND"] = "Agg"
os.environ.setdefault("OMP_NUM_THREADS", "1")  # threads that wait for each other on a busy core
os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
os.environ["ROS_DOMAIN_ID"] = str(free_domain())

hypothesis.settings.register_profile("any machine", deadline=None)
hypothesis.settings.load_profile("any machine")

_REAL_TIME = Path(__file__).parent / "ros"


@pytest.hookimpl(tryfirst=True)  # pytest-xdist reads the groups in the same hook
def pytest_collection_modifyitems(items):
    """Tests of real nodes follow one another; others stay with those of their file."""
    for item in items:
        real_time = item.path.is_relative_to(_REAL_TIME)
        item.add_marker(pytest.mark.xdist_group("real time" if real_time else item.path.name))
