"""No test draws on a screen, sends a ROS message off this machine or hears another test run.

Nor does a test spread small matrices over threads, or fail because the machine is busy.
"""

import os

import hypothesis

from cablesense_ros.discovery import free_domain

os.environ["MPLBACKEND"] = "Agg"
os.environ.setdefault("OMP_NUM_THREADS", "1")  # threads that wait for each other on a busy core
os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
os.environ["ROS_DOMAIN_ID"] = str(free_domain())

from model_fixtures import model_files, temporal_model_file  # noqa: F401 (fixtures)

hypothesis.settings.register_profile("any machine", deadline=None)
hypothesis.settings.load_profile("any machine")
