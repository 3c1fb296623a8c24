"""What tests of real nodes share.

Each restores the environment and the signals' handlers, and each module ends the nodes that it
started, also where a test failed: one that outlived it would answer in the place of another.
"""

import importlib.util
import logging
import os
import signal
from pathlib import Path
from unittest import mock

import pytest

from cablesense_ros.processes import Process

ENDS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
MARKS = (
    pytest.mark.ros,
    pytest.mark.slow,
    pytest.mark.filterwarnings("ignore::DeprecationWarning"),
)

if importlib.util.find_spec("rclpy") is None:  # needs ROS 2, or its wheels
    collect_ignore_glob = ["test_*.py"]


@pytest.hookimpl(tryfirst=True)  # before the tests are grouped by their markers
def pytest_collection_modifyitems(items):
    for item in items:
        if item.path.is_relative_to(Path(__file__).parent):
            for mark in MARKS:
                item.add_marker(mark)


@pytest.fixture(autouse=True)
def surroundings_restored():
    handlers = {one: signal.getsignal(one) for one in ENDS}
    with mock.patch.dict(os.environ):
        yield
    for one, handler in handlers.items():
        signal.signal(one, handler)


@pytest.fixture(autouse=True, scope="module")
def no_node_left():
    started = []

    def recorded(process, *args, init=Process.__init__, **kwargs):
        init(process, *args, **kwargs)
        started.append(process)

    with mock.patch.object(Process, "__init__", recorded):
        yield
    for process in started:
        if process.alive:
            process.kill()


@pytest.fixture(scope="module")
def graph():
    """A node in the process of the tests."""
    from tests.helpers.ros_graph import Graph

    talking = Graph()
    yield talking
    talking.close()


def nodes_that_end_well(tmp_path_factory):
    from tests.helpers.ros_graph import NodeProcess

    started = []

    def start(*given, **parameters):
        log = tmp_path_factory.mktemp("node") / "log"
        started.append(NodeProcess(log, *given, **parameters))
        return started[-1]

    yield start
    running = [node for node in started if node.alive]
    for node in running:
        node.signal(signal.SIGINT)
    for node in running:
        code = node.wait()
        if code == -signal.SIGALRM:  # the end that `run_node` documents; rare, and not ours
            logging.getLogger(__name__).warning("%s: Fast DDS did not let it go", node.name)
            code = 0
        assert code == 0, node.log
    for node in started:
        assert "Traceback" not in node.log


start = pytest.fixture(nodes_that_end_well, name="start")
"""Starts a node for a test; all must end well after it."""
start_for_all = pytest.fixture(nodes_that_end_well, scope="module", name="start_for_all")
"""Starts a node for the tests of a module."""
