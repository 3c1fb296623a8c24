"""A test leaves the environment and the handlers of signals as it found them."""

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
