"""Children live and die together: tiny commands stand in for the nodes."""

import os
import signal
import subprocess
import sys
import textwrap
import time

import pytest

from cablesense_ros.demo.processes import ChildCommand, ChildError, Processes

SLEEPER = "import time; print('up', flush=True); time.sleep(60)"
STUBBORN = (
    "import signal, time; signal.signal(signal.SIGTERM, signal.SIG_IGN);"
    "print('up', flush=True); time.sleep(60)"
)


def python(name, code):
    return ChildCommand(name, [sys.executable, "-c", code])


def alive(pid):
    try:
        with open(f"/proc/{pid}/stat") as stat:  # noqa: PTH123
            return stat.read().rsplit(")", 1)[1].split()[0] != "Z"
    except FileNotFoundError:
        return False


def gone(pid, within_s=5.0):
    until = time.monotonic() + within_s
    while alive(pid) and time.monotonic() < until:
        time.sleep(0.02)
    return not alive(pid)


def test_children_end_with_the_block_and_leave_no_zombies(tmp_path):
    with Processes([python("a", SLEEPER), python("b", SLEEPER)], tmp_path) as processes:
        pids = processes.pids
        for name in pids:
            processes.wait_for_line(name, "up", 10.0)
    assert set(pids) == {"a", "b"}
    assert all(not os.path.exists(f"/proc/{pid}") for pid in pids.values())  # noqa: PTH110


def test_a_child_that_dies_is_named_with_its_code_and_last_words(tmp_path):
    dying = python("sim", "import sys; print('no such arm'); sys.exit(3)")
    with (
        Processes([python("page", SLEEPER), dying], tmp_path) as processes,
        pytest.raises(ChildError, match=r"sim ended with code 3 \(no such arm\)") as caught,
    ):
        processes.run_until_child_ends()
    assert caught.value.exit_code == 1
    assert gone(processes.pids["page"])


def test_a_child_that_is_killed_is_named_with_the_signal(tmp_path):
    with Processes([python("estimator", SLEEPER)], tmp_path) as processes:
        os.kill(processes.pids["estimator"], signal.SIGKILL)
        with pytest.raises(ChildError, match="estimator ended by signal SIGKILL"):
            processes.run_until_child_ends()


def test_what_ignores_the_request_to_end_is_killed(tmp_path):
    start = time.monotonic()
    with Processes([python("page", STUBBORN)], tmp_path, grace_s=0.5) as processes:
        processes.wait_for_line("page", "up", 10.0)
    assert not alive(processes.pids["page"])
    assert time.monotonic() - start < 8.0


def test_grandchildren_do_not_outlive_the_block(tmp_path):
    code = (
        "import subprocess, sys, time;"
        f"child = subprocess.Popen([sys.executable, '-c', {SLEEPER!r}]);"
        "print('pid', child.pid, flush=True); time.sleep(60)"
    )
    with Processes([python("page", code)], tmp_path) as processes:
        grandchild = int(processes.wait_for_line("page", "pid ", 10.0))
        assert alive(grandchild)
    assert gone(grandchild)


def test_a_command_that_does_not_exist_ends_those_that_started(tmp_path):
    processes = Processes(
        [python("a", SLEEPER), ChildCommand("b", ["/nonexistent/program"])], tmp_path
    )
    with pytest.raises(FileNotFoundError), processes:
        pass
    assert gone(processes.pids["a"])


def test_a_line_that_does_not_come_is_an_error_that_says_where_the_logs_are(tmp_path):
    with (
        Processes([python("page", SLEEPER)], tmp_path) as processes,
        pytest.raises(ChildError, match=r"page was not ready within 0.3 s; logs are in"),
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
        from cablesense_ros.demo.processes import ChildCommand, Processes
        signal.signal(signal.SIGINT, signal.default_int_handler)
        child = ChildCommand("a", [sys.executable, "-c", {SLEEPER!r}])
        with Processes([child], Path({str(tmp_path)!r})) as processes:
            processes.wait_for_line("a", "up", 10.0)
            print(processes.pids["a"], flush=True)
            processes.run_until_child_ends()
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
        assert process.wait(10.0) == code
    assert gone(pid)
