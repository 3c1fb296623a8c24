"""The check of a running arm: the sim node, an arm that is not there, one of other names."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import threading

import pytest
from sensor_msgs.msg import JointState

from cablesense_online.sensor_check import CommissioningError
from cablesense_ros import recorder
from cablesense_sim.arm import open_arm
from tests.helpers.checkout import CHECKOUT

SHORT_WAITS = (
    "from cablesense_ros import recorder as capture; "
    "capture._FIRST_SAMPLE_S, capture._PULLING_S, capture._RELEASED_S = 30.0, 0.5, 0.5; "
    "from cablesense_ros.cli.app import main; main()"
)
HEARING = (
    "import signal; signal.signal(signal.SIGINT, signal.default_int_handler); "
    "from cablesense_ros import recorder as capture; "
    "capture._FIRST_SAMPLE_S = 60.0; "
    "from cablesense_ros.cli.app import main; main()"
)
"""A shell starts what runs in its background with Ctrl-C ignored, and tests may run there."""
CABLES = open_arm("cdsm").cable_names


def check(*arguments):
    command = [sys.executable, "-c", SHORT_WAITS, "sensors", "check"]
    return subprocess.run(
        [*command, *arguments], capture_output=True, text=True, cwd=CHECKOUT, timeout=60
    )


@pytest.fixture(scope="module")
def sim(start_for_all):
    return start_for_all("sim", "/left")


def test_a_running_sim_passes_and_a_cable_that_nobody_pulled_is_noted(sim):
    options = ("--namespace", "left", "--rate", "100")
    result = check("--seconds", "2", "--pull", "cable_3", *options, "--json")
    content = json.loads(result.stdout)
    assert {finding["kind"] for finding in content["findings"]} <= {"pull", "jitter", "lost"}
    assert content["timing"]["rate_hz"] == pytest.approx(100.0, rel=0.05)
    assert max(channel["noise_n"] for channel in content["channels"]) < 0.145
    assert content["pulls"][0]["verdict"] == "too weak"
    assert "pull cable_3 by hand" in result.stderr
    assert result.returncode == (0 if content["usable"] else 1)


def test_ctrl_c_ends_it_at_once(sim):
    words = ["sensors", "check", "--namespace", "left", "--seconds", "60"]
    process = subprocess.Popen(
        [sys.executable, "-c", HEARING, *words], stderr=subprocess.PIPE, text=True, cwd=CHECKOUT
    )
    try:
        assert "leave the arm alone" in process.stderr.readline()
        process.send_signal(signal.SIGINT)
        assert process.wait(10) == 130, process.stderr.read()
        assert "Traceback" not in process.stderr.read()
    finally:
        process.kill()
        process.stderr.close()


def test_silence_is_refused_in_one_line(monkeypatch):
    monkeypatch.setattr(recorder, "_FIRST_SAMPLE_S", 0.5)
    with pytest.raises(CommissioningError, match=r"^nothing on cable_tensions in 0\.5 s: .*$"):
        recorder.capture_tensions(CABLES, 2.0, (), print)


def test_two_publishers_are_one_line_and_exit_code_2(graph):
    publishers = [graph.node.create_publisher(JointState, "/cable_tensions", 10) for _ in range(2)]
    ended = threading.Event()

    def publish():
        while not ended.wait(0.02):
            for publisher in publishers:
                publisher.publish(JointState(name=list(CABLES), effort=[50.0] * len(CABLES)))

    talking = threading.Thread(target=publish)
    talking.start()
    try:
        result = check("--seconds", "2")
    finally:
        ended.set()
        talking.join()
    assert result.returncode == 2
    assert "two publishers" in result.stderr
    assert "Traceback" not in result.stderr
