"""A machine that MuJoCo describes, as nodes: it gets known, and says where it is pushed."""

import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from geometry_msgs.msg import PointStamped, WrenchStamped

from cablesense_contact.calibration_file import read_calibration
from cablesense_contact.machine.felt_model import FeltModel
from cablesense_msgs_py.messages import ForceState
from cablesense_online.replay import RebuiltEstimator, RecordedRun
from cablesense_ros.cli.export import export
from cablesense_sim.machine.machine import open_machine
from tests.helpers.ros_graph import force

MACHINES = Path(__file__).parents[3] / "config" / "machines"
COMMISSIONING = "commissioner: commissioning"
NUMBERS_BYTES = 48
"""Force and torque at the end of a serialized wrench."""


@pytest.fixture(scope="module")
def arm(tmp_path_factory):
    """A machine file with its model beside it."""
    folder = tmp_path_factory.mktemp("arm")
    for name in ("seven_hinges.xml", "seven_hinges.yaml"):
        shutil.copy(MACHINES / name, folder)
    file = folder / "seven_hinges.yaml"
    export(out=folder / "seven_hinges.onnx", arm=str(file))
    return file


@pytest.fixture(scope="module")
def nodes(start_for_all, arm):
    sim = start_for_all("sim", arm=str(arm), built_seed=3, rate_hz=30.0)
    return sim, start_for_all("estimator", arm=str(arm), tare_samples=20)


def test_a_push_on_a_link_is_found_within_its_interval(graph, nodes):
    points = graph.listen(PointStamped, "/estimator/contact_point")
    lower = graph.listen(WrenchStamped, "/estimator/wrench_lower")
    upper = graph.listen(WrenchStamped, "/estimator/wrench_upper")
    graph.until(lambda: said(graph) is ForceState.FREE, "an arm that nothing touches")
    push(graph, "link_6", (0.0, 8.0, 6.0))
    graph.until(lambda: said(graph) is ForceState.CONTACT and points, "a contact")
    wrench = graph.wrenches[-2]
    assert wrench.header.frame_id == "link_6"
    size_n = np.linalg.norm(force(wrench))
    assert size_n == pytest.approx(10.0, abs=0.5)
    low_n, high_n = (np.linalg.norm(force(bounds[-1])) for bounds in (lower, upper))
    assert low_n < 10.0 < high_n
    # in the middle of where the link is touched, which is its default place
    assert points[-1].point.x == pytest.approx(0.06, abs=0.01)
    push(graph, "link_6", (0.0, 0.0, 0.0))


def test_what_was_recorded_is_answered_again(graph, nodes, arm, tmp_path):
    """In the frames of links; what came before the recording is in the last digits alone."""
    path = tmp_path / "run.mcap"
    command = [sys.executable, "-m", "cablesense_ros.cli.app", "record"]
    recording = subprocess.Popen([*command, "--out", path, "--duration", "5"])
    graph.until(lambda: graph.load.get_subscription_count() > 1, "the recorder")
    push(graph, "link_6", (0.0, 8.0, 6.0))
    graph.until(lambda: recording.poll() is not None, "the end of the recording")
    push(graph, "link_6", (0.0, 0.0, 0.0))
    assert recording.returncode == 0
    run = RecordedRun(path)
    rebuilt = RebuiltEstimator(run, str(arm))
    answers = [answer for answer in map(rebuilt.take, run.messages()) if answer is not None]
    repeated = [answer for answer in answers if answer.stamp_ns in run.answers]
    assert sum(bool(answer.answer.contact.segment) for answer in repeated) > 10
    for answer in repeated:
        recorded = run.answers[answer.stamp_ns]
        assert answer.wrench[:-NUMBERS_BYTES] == recorded[:-NUMBERS_BYTES]  # stamp and frame
        numbers = np.frombuffer(answer.wrench[-NUMBERS_BYTES:])
        recorded_numbers = np.frombuffer(recorded[-NUMBERS_BYTES:])
        np.testing.assert_allclose(numbers, recorded_numbers, atol=1e-9)


@pytest.mark.timeout(300)
def test_a_commissioning_stops_on_contact_and_ends_in_a_calibration(
    graph, start, nodes, arm, tmp_path
):
    file = tmp_path / "arm.calibration"
    settings = {"poses": 3, "bend_deg": 5.0, "rest_s": 0.0, "await_command": False}
    start("commissioner", arm=str(arm), calibration_file=str(file), **settings)
    graph.until(lambda: status(graph, COMMISSIONING), "the commissioner's diagnostics")
    answer = graph.call("/commissioner/commission")
    assert answer.success, answer.message
    assert answer.message.startswith("3 holds in 3 poses, about ")
    push(graph, "link_5", (0.0, 8.0, 6.0))
    graph.until(lambda: status(graph, COMMISSIONING).startswith("stopped"), "the stop")
    assert "touches link 5" in status(graph, COMMISSIONING)
    assert not file.exists()

    push(graph, "link_5", (0.0, 0.0, 0.0))
    graph.spin(1.0)
    assert graph.call("/commissioner/commission").success
    graph.until(lambda: "is known to" in status(graph, COMMISSIONING), "progress")
    graph.until(lambda: status(graph, COMMISSIONING).startswith("done"), "the end")
    calibration = read_calibration(file, FeltModel(open_machine(arm)))
    assert len(calibration.unloaded) == 3
    assert calibration.as_described
    tare = "estimator: tare"
    graph.until(lambda: "a commissioning in 3 poses" in status(graph, tare), "its use")


def push(graph, link, force_base_n):
    """Put a load on a link."""
    message = WrenchStamped()
    message.header.frame_id = link
    message.wrench.force.x, message.wrench.force.y, message.wrench.force.z = force_base_n
    graph.until(graph.load.get_subscription_count, "a subscriber of loads")
    graph.load.publish(message)


def status(graph, name):
    """The latest message of a status; empty before there is one."""
    latest = graph.statuses.get(name)
    return latest.message if latest else ""


def said(graph):
    """The state of the latest wrench but one; its state comes just after it."""
    return graph.state_of(graph.wrenches[-2]) if len(graph.wrenches) > 1 else None
