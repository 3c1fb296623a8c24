"""The command in this process: what it prints and how it ends, without a second of imports."""

import signal
import sys
from typing import NamedTuple

import pytest

from cablesense_ros.cli.app import main


class Ended(NamedTuple):
    """How a command ended."""

    returncode: int
    stdout: str
    stderr: str


@pytest.fixture
def command(monkeypatch, capsys, tmp_path):
    """Runs `cablesense` with arguments, in a folder of the test's own."""
    monkeypatch.chdir(tmp_path)
    handlers = {
        one: signal.getsignal(one) for one in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
    }

    def run(*arguments):
        monkeypatch.setattr(sys, "argv", ["cablesense", *map(str, arguments)])
        with pytest.raises(SystemExit) as ended:
            main()
        return Ended(ended.value.code or 0, *capsys.readouterr())

    yield run
    for one, handler in handlers.items():
        signal.signal(one, handler)
