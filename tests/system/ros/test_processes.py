"""Children live and die together: tiny commands stand in for the nodes."""

import os
import signal
import subprocess
import sys
import textwrap
from pathlib import Path

import pytest

from cablesense_ros.processes import Process, ProcessError, Processes, node_command, wait_until
from tests.helpers.waiting import until

PATIENCE_S = 30.0
SLEEPER = "import time; print('up', flush=True); time.sleep(60)"
STUBBORN = (
    "import signal, time; signal.signal(signal.SIGTERM, signal.SIG_IGN);"
    "print('up', flush=True); time.sleep(60)"
)


def python(code):
    return [sys.executable, "-c", code]


def alive(pid):
    try:
        with open(f"/proc/{pid}/stat") as stat:  # noqa: PTH123
            return stat.read().rsplit(")", 1)[1].split()[0] != "Z"
    except FileNotFoundError:
        return False


def test_children_end_with_the_block_and_leave_no_zombies(tmp_path):
    with Processes({"a": python(SLEEPER), "b": python(SLEEPER)}, tmp_path) as processes:
        pids = {name: child.pid for name, child in processes.items()}
        for name in pids:
            processes.wait_for_line(name, "up", PATIENCE_S)
    assert set(pids) == {"a", "b"}
    assert all(not os.path.exists(f"/proc/{pid}") for pid in pids.values())  # noqa: PTH110


def test_a_child_that_dies_is_named_with_its_code_and_last_words(tmp_path):
    dying = python("import sys; print('no such arm'); sys.exit(3)")
    with (
        Processes({"page": python(SLEEPER), "sim": dying}, tmp_path) as processes,
        pytest.raises(ProcessError, match=r"sim ended with code 3 \(no such arm\)") as caught,
    ):
        processes.wait_until(lambda: None, PATIENCE_S, "none ended")
    assert caught.value.exit_code == 1
    until(lambda: not alive(processes["page"].pid), "the end of the other")


def test_what_ignores_the_request_to_end_is_killed(tmp_path, monkeypatch):
    monkeypatch.setattr("cablesense_ros.processes.GRACE_S", 0.5)
    with Processes({"page": python(STUBBORN)}, tmp_path) as processes:
        processes.wait_for_line("page", "up", PATIENCE_S)
    assert not alive(processes["page"].pid)


def test_a_line_that_does_not_come_is_an_error_that_says_where_the_logs_are(tmp_path):
    with (
        Processes({"page": python(SLEEPER)}, tmp_path) as processes,
        pytest.raises(ProcessError, match=r"page was not ready within 0.3 s; logs are in"),
    ):
        processes.wait_for_line("page", "page: ", 0.3)


@pytest.mark.parametrize(
    ("number", "code"), [(signal.SIGINT, -signal.SIGINT), (signal.SIGKILL, -signal.SIGKILL)]
)
def test_children_die_with_their_parent(tmp_path, number, code):
    parent = textwrap.dedent(
        f"""
        import signal, sys
        from pathlib import Path
        from cablesense_ros.processes import Processes
        signal.signal(signal.SIGINT, signal.default_int_handler)
        child = [sys.executable, "-c", {SLEEPER!r}]
        with Processes({{"a": child}}, Path({str(tmp_path)!r})) as processes:
            processes.wait_for_line("a", "up", {PATIENCE_S})
            print(processes["a"].pid, flush=True)
            processes.wait_until(lambda: None, 60.0, "not ended")
        """
    )
    process = subprocess.Popen(
        [sys.executable, "-c", parent],
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
    )
    with process:
        pid = int(process.stdout.readline())
        assert alive(pid)
        process.send_signal(number)
        assert process.wait(PATIENCE_S) == code
    until(lambda: not alive(pid), "the end of the child")


def test_one_process_is_killed_started_again_and_stopped(tmp_path):
    with Process("a", python(SLEEPER), tmp_path / "a.log") as process:
        wait_until(lambda: "up" in process.log, PATIENCE_S, "not up")
        process.kill()
        assert not process.alive
        with pytest.raises(ProcessError, match=r"a ended by signal SIGKILL \(up\)"):
            process.check()
        process.start()
        wait_until(lambda: process.log.count("up") == 2, PATIENCE_S, "not up again")
        assert process.stop() == -signal.SIGINT
    assert not process.alive


def test_parameters_keep_their_kind_on_the_command_line():
    command = node_command(
        "sim", {"noise": True, "rate_hz": 100.0, "arm": "1", "out": Path("x")}, namespace="/left"
    )
    assert command[1:] == [
        "-m",
        "cablesense_ros.sim_node",
        "--ros-args",
        "-r",
        "__ns:=/left",
        "-p",
        "noise:=true",
        "-p",
        "rate_hz:=100.0",
        "-p",
        'arm:="1"',
        "-p",
        'out:="x"',
    ]
