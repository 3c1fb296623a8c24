"""What tests of real nodes share; each restores the environment and the signals' handlers."""

import os
import signal
from unittest import mock

import pytest

ENDS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


@pytest.fixture(autouse=True)
def surroundings_restored():
    handlers = {one: signal.getsignal(one) for one in ENDS}
    with mock.patch.dict(os.environ):
        yield
    for one, handler in handlers.items():
        signal.signal(one, handler)


@pytest.fixture(scope="module")
def graph():
    """A node in the process of the tests."""
    pytest.importorskip("rclpy")
    from ros_graph import Graph

    talking = Graph()
    yield talking
    talking.close()
