"""No test draws on a screen, sends a ROS message off this machine or takes one of another run.

Nor does a test spread small matrices over threads, or fail because the machine is busy.
"""

import os

import hypothesis
from xdist.scheduler import LoadFileScheduling

from cablesense_ros.discovery import free_domain

os.environ["MPLBACKEND"] = "Agg"
os.environ.setdefault("OMP_NUM_THREADS", "1")  # threads that wait for each other on a busy core
os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
os.environ["ROS_DOMAIN_ID"] = str(free_domain())

hypothesis.settings.register_profile("any machine", deadline=None)
hypothesis.settings.register_profile("fast", deadline=None, max_examples=15)
hypothesis.settings.load_profile("any machine")


class _RealTimeOnOneWorker(LoadFileScheduling):
    """Tests of real nodes follow one another; others stay with those of their file."""

    def _split_scope(self, nodeid):
        return "real time" if nodeid.startswith("tests/ros/") else super()._split_scope(nodeid)


def pytest_xdist_make_scheduler(config, log):
    return _RealTimeOnOneWorker(config, log)
