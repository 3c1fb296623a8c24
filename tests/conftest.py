"""No test draws on a screen, sends a ROS message off this machine or takes one of another run.

Nor does a test spread small matrices over threads, or fail because the machine is busy.
"""

import os
import signal
import sys
from collections import Counter
from pathlib import Path

import hypothesis
import pytest
from xdist.scheduler import LoadFileScheduling

from cablesense_ros.processes import free_domain

sys.path.append(str(Path(__file__).parents[1] / "benchmarks"))  # they import each other by name
# under nohup, or behind a shell's &, all that tests start would ignore these
signal.signal(signal.SIGHUP, signal.SIG_DFL)
signal.signal(signal.SIGINT, signal.default_int_handler)
os.environ["MPLBACKEND"] = "Agg"
os.environ.setdefault("OMP_NUM_THREADS", "1")  # threads that wait for each other on a busy core
os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
os.environ["ROS_DOMAIN_ID"] = str(free_domain())

hypothesis.settings.register_profile("any machine", deadline=None, max_examples=50)
hypothesis.settings.register_profile("fast", deadline=None, max_examples=15)
hypothesis.settings.load_profile("any machine")


BEHIND = 5
"""Niceness of workers whose tests only compute, beside real nodes that must answer in time."""


def _in_real_time(nodeid):
    return nodeid.startswith("tests/ros/")


def _in_browser(nodeid):
    return nodeid.startswith("tests/ros/test_page_browser")


EXPORTING = (
    "tests/examples/test_examples_without_nodes.py",
    "tests/packaging/test_tutorial.py",
    "tests/training/test_export.py",
    "tests/training/test_five_by_four.py",
    "tests/training/test_law_export.py",
    "tests/training/test_train_model.py",
)
"""The first export of a network takes a process seconds more than the others: they share one."""


class _RealTimeOnTwoWorkers(LoadFileScheduling):
    """Tests of real nodes follow one another, beside those that a browser shows.

    Those that export networks are together as well, the others with those of their file.
    """

    def _split_scope(self, nodeid):
        if _in_real_time(nodeid) and not _in_browser(nodeid):
            return "real time"
        return "exports" if nodeid.startswith(EXPORTING) else super()._split_scope(nodeid)


def pytest_xdist_make_scheduler(config, log):
    return _RealTimeOnTwoWorkers(config, log)


def pytest_collection_modifyitems(config, items):
    """Of several workers the first two have the real nodes; then exports and long files come.

    A test that waits for other processes is repeated once where it fails, and is listed as RERUN:
    a machine with other work may keep one of them waiting for as long as it likes.
    """
    for item in items:
        if _in_real_time(item.nodeid) or item.get_closest_marker("ros"):
            item.add_marker(pytest.mark.flaky(reruns=1))
    if hasattr(config, "workerinput"):
        slow = Counter(item.path for item in items if item.get_closest_marker("slow"))
        items.sort(
            key=lambda item: (
                not _in_real_time(item.nodeid),
                _in_browser(item.nodeid),
                not item.nodeid.startswith(EXPORTING),
                -slow[item.path],
                item.path,
            )
        )


def pytest_runtest_setup(item):
    """Whoever has other tests than those of real nodes lets these go first."""
    if hasattr(item.config, "workerinput") and not _in_real_time(item.nodeid):
        os.nice(max(0, BEHIND - os.nice(0)))


@pytest.fixture
def dask_address():
    import distributed

    with distributed.LocalCluster(
        n_workers=2,
        threads_per_worker=1,
        processes=False,
        protocol="tcp",
        host="127.0.0.1",
        dashboard_address=":0",
    ) as cluster:
        yield cluster.scheduler_address
