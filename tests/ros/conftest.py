"""What tests of real nodes share.

Each restores the environment and the signals' handlers, and each module ends the nodes that it
started, also where a test failed: one that outlived it would answer in the place of another.
"""

import os
import signal
from unittest import mock

import pytest

from cablesense_ros.processes import Process

ENDS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


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
    pytest.importorskip("rclpy")
    from ros_graph import Graph

    talking = Graph()
    yield talking
    talking.close()
