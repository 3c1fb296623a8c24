"""No test draws on a screen, sends a ROS message off this machine or takes one of another run.

Nor does a test spread small matrices over threads, or fail because the machine is busy.
"""

import gc
import os
import signal
from collections import Counter
from pathlib import Path

import hypothesis
import pytest

from cablesense_ros.processes import free_domain

gc.disable()  # while modules are imported, nearly all of which stays: a third of that time

# under nohup, or behind a shell's &, all that tests start would ignore these
signal.signal(signal.SIGHUP, signal.SIG_DFL)
signal.signal(signal.SIGINT, signal.default_int_handler)
os.environ["MPLBACKEND"] = "Agg"
os.environ.setdefault("MUJOCO_GL", "egl")  # before MuJoCo is imported: it draws without a window
os.environ.setdefault("OMP_NUM_THREADS", "1")  # threads that wait for each other on a busy core
os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
os.environ["ROS_DOMAIN_ID"] = str(free_domain())

hypothesis.settings.register_profile("any machine", deadline=None, max_examples=50)
hypothesis.settings.register_profile("fast", deadline=None, max_examples=15)
hypothesis.settings.load_profile("any machine")


BEHIND = 5
"""Niceness of workers whose tests only compute, beside real nodes that must answer in time."""

SYSTEM = Path(__file__).parent / "system"
NODES = "real nodes"
EXPORTS = "exports"
LINTERS = "test_lint.py"


def _group_of(item):
    """Tests of one group run in one worker: those of a file, which share fixtures, and more.

    Real nodes follow one another, as they must answer in time. The first export of a network takes
    a process seconds more than the others: they share one.
    """
    if _is_of_nodes(item):
        return NODES
    return EXPORTS if item.get_closest_marker("exports") else item.nodeid.split("::")[0]


def _is_of_nodes(item):
    """Whether it starts nodes that must answer in time; a browser waits for what it is shown.

    Elsewhere than under tests/system, a test stays with others that use what is installed for it.
    """
    starts_nodes = item.get_closest_marker("ros") and not item.get_closest_marker("browser")
    return bool(starts_nodes and item.path.is_relative_to(SYSTEM))


@pytest.hookimpl(tryfirst=True)  # before xdist reads the groups
def pytest_collection_modifyitems(config, items):
    """Groups for `--dist loadgroup`: first real nodes and the browser, then what takes long.

    A test that waits for other processes is repeated once where it fails, and is listed as RERUN:
    a machine with other work may keep one of them waiting for as long as it likes.
    """
    for item in items:
        item.add_marker(pytest.mark.xdist_group(_group_of(item)))
        if item.get_closest_marker("ros"):
            item.add_marker(pytest.mark.flaky(reruns=1))
    if hasattr(config, "workerinput"):
        slow = Counter(item.path for item in items if item.get_closest_marker("slow"))
        items.sort(
            key=lambda item: (
                not _is_of_nodes(item),
                not item.get_closest_marker("browser"),
                _group_of(item) != EXPORTS,
                item.path.name != LINTERS,
                -slow[item.path],
                item.path,
            )
        )


def pytest_collection_finish():
    """From here on garbage is collected, without looking at what stays."""
    gc.freeze()
    gc.enable()


def pytest_runtest_setup(item):
    """Whoever has other tests than those of real nodes lets these go first."""
    if hasattr(item.config, "workerinput") and not item.get_closest_marker("ros"):
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
