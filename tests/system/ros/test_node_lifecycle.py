"""What all nodes share: parameters, refusals, lifecycle, simulated time, the end by signals."""

import json
import math
import re
import signal
import subprocess
import sys
import threading
import time
from collections import deque
from contextlib import contextmanager
from importlib import import_module
from itertools import cycle
from pathlib import Path
from unittest import mock

import pytest
import rclpy
from geometry_msgs.msg import WrenchStamped
from lifecycle_msgs.msg import Transition
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, ReliabilityPolicy
from rclpy.serialization import serialize_message
from rclpy.utilities import try_shutdown
from sensor_msgs.msg import JointState

from cablesense_base import CableSenseError
from cablesense_contact import LawModel, find_model
from cablesense_contact.calibration import Calibrator
from cablesense_contact.calibration_file import write_calibration
from cablesense_contact.felt_arm import FeltArm
from cablesense_msgs_py import topics
from cablesense_msgs_py.qos import RECORDED_TOPICS, recorded_topic, resolved
from cablesense_msgs_py.topics import ContractError
from cablesense_online.inputs import REPLAYED_FROM
from cablesense_online.settings import LIVE_SETTINGS
from cablesense_ros import node_process
from cablesense_ros.can_driver_node import CanDriverNode
from cablesense_ros.endpoints import RefusalLog
from cablesense_ros.estimator_node import EstimatorNode
from cablesense_ros.node_process import (
    FAILURE,
    NodeParameter,
    ParameterError,
    declare_parameters,
    parameter_table,
)
from cablesense_ros.processes import node_command
from cablesense_ros.sim_node import SimNode
from cablesense_sim.arm import open_arm
from tests.helpers.waiting import until

ARM = open_arm("cdsm")
RATE = NodeParameter("rate_hz", 10.0, "A rate, Hz.", (1.0, 100.0))
MODE = NodeParameter("mode", "slow", "A mode.", choices=("slow", "fast"))
FOREVER_S = 1e9
"""From this lease on, DDS means none."""
NODES = ["sim", "estimator", "can_driver", "can_emulator", "breather", "commissioner", "page"]


@pytest.fixture
def make_node():
    """Makes a node. It begins ROS with the node's arguments, so call it once in a test."""
    nodes = []

    def make(kind=Node, *arguments, given=None, **overrides):
        rclpy.init(args=node_command("any", given)[3:])
        if kind is Node:
            values = [Parameter(name, value=value) for name, value in overrides.items()]
            arguments = ("parameters",)
            overrides = {"parameter_overrides": values}
        nodes.append(kind(*arguments, **overrides))
        return nodes[-1]

    yield make
    for node in nodes:
        node.destroy_node()
    try_shutdown()


def test_a_replay_knows_every_topic_that_a_live_estimator_takes(make_node):
    """Forgotten in `REPLAYED_FROM`, a new input would be missing from every replay."""
    node = make_node(EstimatorNode, given={"autostart": True})
    node.autostart()
    taken = {one.topic_name for one in node.subscriptions}
    of_arms = REPLAYED_FROM.keys() - {topics.JOINT_STATES}  # of machines with measured joints
    assert taken - {"/parameter_events", "/clock"} == {resolved(topic) for topic in of_arms}


@pytest.mark.parametrize(
    ("kind", "given"),
    [
        (EstimatorNode, {"autostart": True}),
        (SimNode, {}),
        (CanDriverNode, {"interface": "virtual", "channel": "offered"}),
    ],
)
def test_a_node_offers_the_quality_that_the_table_of_topics_has(make_node, kind, given):
    node = make_node(kind, given=given)
    getattr(node, "autostart", lambda: None)()
    published = {one.topic_name: recorded_topic(one.topic_name) for one in node.publishers}
    known = {name: topic for name, topic in published.items() if topic}
    assert known

    def offered(name):
        """The qualities of the node's own publishers of a topic that the graph knows."""
        publishers = node.get_publishers_info_by_topic(name)
        return [one.qos_profile for one in publishers if one.node_name == node.get_name()]

    for name, topic in known.items():
        # the graph follows a moment later
        qualities = until(lambda name=name: offered(name), name)
        listed = RECORDED_TOPICS[topic].offered
        for offers in qualities:
            assert (offers.reliability == ReliabilityPolicy.RELIABLE) is listed.reliable
            lasts = offers.durability == DurabilityPolicy.TRANSIENT_LOCAL
            assert lasts is listed.transient_local
            lease_s = offers.liveliness_lease_duration.nanoseconds * 1e-9
            asked_s = lease_s if lease_s < FOREVER_S else 0.0
            assert asked_s == pytest.approx(listed.lease_s)


def test_a_parameter_shows_its_description_and_range(make_node):
    node = make_node()
    speed = NodeParameter("joint_speed_deg_s", 180.0, "Speed, deg/s.")
    given = declare_parameters(node, [RATE, speed])
    assert given["rate_hz"] == 10.0
    assert given["joint_speed_rad_s"] == pytest.approx(math.pi)
    descriptor = node.describe_parameter("rate_hz")
    assert descriptor.description == "A rate, Hz."
    assert descriptor.floating_point_range[0].to_value == 100.0
    assert descriptor.read_only


@pytest.mark.parametrize("default", [[1.0, 2.0], ["joint_1"], {}, None])
def test_a_table_with_a_parameter_of_another_type_is_refused(monkeypatch, tmp_path, default):
    text = f"shared: {{}}\nsim:\n  joints: {{default: {json.dumps(default)}, description: Some.}}"
    (tmp_path / "parameters.yaml").write_text(text, encoding="utf-8")
    monkeypatch.setattr(node_process, "files", lambda _: tmp_path)
    with pytest.raises(ParameterError, match=r"parameter joints: its default .* must be true or"):
        parameter_table("sim")


@pytest.mark.parametrize("value", [0.5, 1e9, math.nan, math.inf, 50, "fast", True])
def test_a_wrong_value_at_start_is_refused_with_what_would_be_right(make_node, value):
    with pytest.raises(ParameterError, match=r"rate_hz.*decimal point from 1 to 100"):
        declare_parameters(make_node(rate_hz=value), [RATE])


@pytest.mark.parametrize(
    ("name", "value"),
    [("rate_hz", math.nan), ("rate_hz", math.inf), ("rate_hz", 1000.0), ("mode", "idle")],
)
def test_a_wrong_value_later_is_refused(make_node, name, value):
    node = make_node()
    before = declare_parameters(node, [RATE, MODE], configured=lambda: False)
    (result,) = node.set_parameters([Parameter(name, value=value)])
    assert not result.successful
    assert node.get_parameter(name).value == before[name]


def test_what_is_read_once_is_refused_from_then_on_with_the_reason(make_node):
    node = make_node()
    configured = []
    gain = NodeParameter("gain", 1.0, "A gain.", (0.0, 9.0), live=True)
    declare_parameters(node, [RATE, gain], configured=lambda: bool(configured))
    faster = Parameter("rate_hz", value=20.0)
    assert node.set_parameters([faster])[0].successful
    configured.append(True)
    assert node.set_parameters([faster])[0].successful  # nothing changes
    (refused,) = node.set_parameters([Parameter("rate_hz", value=30.0)])
    assert "rate_hz is read when the node is configured" in refused.reason
    assert node.set_parameters([Parameter("gain", value=2.0)])[0].successful


@pytest.mark.parametrize("node", NODES)
def test_every_parameter_of_the_nodes_is_described_and_every_number_bounded(node):
    for parameter in parameter_table(node):
        assert parameter.description.endswith(".")
        if type(parameter.default) in (int, float):
            low, high = parameter.bounds
            assert low <= parameter.default <= high
            assert type(low) is type(high) is type(parameter.default)
    if node == "estimator":
        assert set(LIVE_SETTINGS) <= {one.name for one in parameter_table(node) if one.live}


def test_a_refusal_of_one_kind_does_not_hide_another_in_the_same_second():
    class Log(list):
        get_logger = lambda self: self  # noqa: E731
        warning = list.append

    log = Log()
    refuse = RefusalLog(log)
    for topic in ("joint_commands", "applied_wrench"):
        for error in (ContractError("no name"), ContractError("no name"), CableSenseError("far")):
            refuse(topic, error)
    assert log == [
        f"{topic}: message refused: {why}"
        for topic in ("joint_commands", "applied_wrench")
        for why in ("no name", "far")
    ]


@pytest.mark.parametrize(
    ("node", "parameters", "reason"),
    [
        ("sim", {"joint_speed_deg_s": -5.0}, "parameter joint_speed_deg_s"),
        ("sim", {"noise": False, "seed": 3}, "seed has no effect without noise"),
        ("sim", {"arm": "none"}, "bundled arms are"),
        ("can_driver", {"bitrate_bit_s": -5}, "0 to 1e+06"),
        ("can_emulator", {"fault": "explosion"}, "unknown fault"),
        ("can_emulator", {"channel": "/none/of/that"}, "no link to"),
        ("can_emulator", {"bitrate_bit_s": 500_000}, "bitrate_bit_s has no effect on slcan_port"),
    ],
)
def test_a_wrong_parameter_ends_a_node_with_one_line(node, parameters, reason, tmp_path, capfd):
    if node == "can_emulator":
        parameters = {"channel": tmp_path / "adapter", **parameters}
    main = import_module(f"cablesense_ros.{node}_node").main
    assert main(node_command(node, parameters)[3:]) == 2
    printed = capfd.readouterr().err
    assert printed.startswith("cannot start: ")
    assert printed.count("\n") == 1
    assert reason in printed


@pytest.mark.parametrize(
    ("kind", "parameters", "reason"),
    [
        (EstimatorNode, {"model": "none.onnx"}, "none.onnx"),
        (CanDriverNode, {"map": "none"}, "bundled channel maps are"),
        (CanDriverNode, {"sensor_calibration_file": "none.yaml"}, "none.yaml: cannot be read"),
        (CanDriverNode, {"interface": "none"}, "unknown to python-can"),
    ],
)
def test_a_wrong_file_leaves_a_lifecycle_node_unconfigured(
    make_node, kind, parameters, reason, capfd
):
    node = make_node(kind, given=parameters)
    node.autostart()
    (status,) = node._statuses()
    assert "not configured" in status.message
    printed = capfd.readouterr().err
    assert "cannot configure" in printed
    assert reason in printed
    assert "Traceback" not in printed


def test_a_calibration_of_another_arm_leaves_the_estimator_unconfigured(
    make_node, tmp_path, capfd
):
    other = open_arm("cdsm_lab")
    law = LawModel(find_model("cdsm_lab_anywhere"), other)
    path = tmp_path / "other.calibration"
    write_calibration(path, Calibrator(FeltArm(other), law).by_tolerances())
    node = make_node(EstimatorNode, given={"arm": "cdsm", "calibration_file": path})
    node.autostart()
    assert "not configured" in node._statuses()[0].message
    (line,) = capfd.readouterr().err.strip().splitlines()
    assert f"cannot configure: {path}: is of arm cdsm_lab" in line


def test_depth_and_reliability_of_the_streams_can_be_overridden_and_nothing_else(make_node):
    best_effort = {"qos_overrides./estimator/wrench.publisher.reliability": "best_effort"}
    node = make_node(EstimatorNode, given=best_effort)
    node.autostart()
    assert set(node.get_parameters_by_prefix("qos_overrides")) == {
        f"{end}.{policy}"
        for end in ("/cable_tensions.subscription", "/estimator/wrench.publisher")
        for policy in ("depth", "reliability")
    }
    (wrench,) = until(lambda: node.get_publishers_info_by_topic("/estimator/wrench"))
    assert wrench.qos_profile.reliability == ReliabilityPolicy.BEST_EFFORT


def test_an_estimator_without_the_package_of_its_own_message_has_the_standard_topics(make_node):
    with mock.patch("cablesense_ros.estimator_outputs.message_class", return_value=None):
        node = make_node(EstimatorNode)
        node.autostart()
    until(lambda: node.count_publishers("/estimator/wrench"))  # the graph follows a moment later
    until(lambda: node.count_publishers("/estimator/status"))
    assert node.count_publishers("/estimator/estimate") == 0


def test_what_no_one_foresaw_is_told_and_the_step_can_be_tried_again(make_node, capfd):
    wrong = {"qos_overrides./cable_tensions.subscription.depth": -5}
    node = make_node(EstimatorNode, given=wrong)
    node.trigger_configure()
    for _ in range(2):
        assert node.trigger_activate() == FAILURE
    assert not node._active
    assert not [one for one in node.subscriptions if one.topic_name == "/cable_tensions"]
    assert "cannot activate:\nTraceback" in capfd.readouterr().err


def test_what_the_arm_cannot_do_is_refused_and_signals_after_the_first_do_not_cut_the_end_short(
    graph, start
):
    sim = start("sim")
    graph.until(graph.command.get_subscription_count, "a subscriber of commands")
    for _ in range(20):
        for angle_rad in (math.nan, math.radians(1e6), 0.6):
            message = JointState(name=list(ARM.joint_names), position=[0.0, angle_rad] * 4)
            graph.command.publish(message)
    for reason in ("finite and within", "guide plates touch"):
        graph.until(lambda reason=reason: reason in sim.log, reason)
    assert sim.log.count("refused") <= 4  # one warning a second
    graph.until(lambda: graph.tensions, "tensions")
    assert max(graph.tensions[-1].effort) < 100.0
    for number in (signal.SIGTERM, signal.SIGHUP, signal.SIGINT):
        sim.signal(number)
        time.sleep(0.02)
    assert sim.wait() == 0, sim.log


def test_huge_messages_are_refused_unread_and_leave_no_memory_behind(graph, start):
    process = start("estimator", "/flooded")
    samples, commands = (
        graph.node.create_publisher(JointState, f"/flooded/{topic}", 100)
        for topic in ("cable_tensions", "joint_commands")
    )
    for publisher in (samples, commands):
        graph.until(publisher.get_subscription_count, "the estimator")
    commands.publish(JointState(name=["x"] * 100_000))
    huge = serialize_message(JointState(effort=[0.0] * 1_000_000))

    def flooded_mb():
        for _ in range(50):
            samples.publish(huge)
            graph.spin(0.02)
        graph.spin(2.0)
        return _resident_mb(process.pid)

    first_mb = flooded_mb()
    for topic in ("cable_tensions: sample refused", "joint_commands: message refused"):
        graph.until(
            lambda topic=topic: re.search(rf"{topic}: \d+ bytes; a message", process.log),
            f"{topic} in the log",
        )
    # a flood is 400 MB, which may wait in the middleware; two more would show what is not freed
    flooded_mb()
    assert flooded_mb() < first_mb + 500
    for publisher in (samples, commands):
        graph.node.destroy_publisher(publisher)


def _resident_mb(pid):
    return int(Path(f"/proc/{pid}/statm").read_text().split()[1]) * 4096 / 1e6


def test_without_a_clock_zero_wrenches_come_and_diagnostics_say_why(graph, start):
    process = start("estimator", "/simulated", use_sim_time=True)
    wrenches = graph.listen(WrenchStamped, "/simulated/estimator/wrench")
    graph.until(lambda: len(wrenches) > 10, "zero wrenches, though no time passes")
    graph.until(lambda: "/clock has not begun" in process.log, "the missing clock in the log")
    graph.until(lambda: "simulated/estimator: clock" in graph.statuses, "it in diagnostics")


@contextmanager
def subscribers_that_come_and_go(kind, topics):
    """Another participant, whose thread subscribes and unsubscribes all the time."""
    context = rclpy.Context()
    end = threading.Event()
    context.init()
    node = Node("restless", context=context)

    def subscribe():
        there = deque()
        for topic in cycle(topics):
            there.append(node.create_subscription(kind, topic, lambda _: None, 10))
            if len(there) > 2:
                node.destroy_subscription(there.popleft())
            if end.wait(0.003):
                return

    thread = threading.Thread(target=subscribe)
    thread.start()
    try:
        yield
    finally:
        end.set()
        thread.join()
        node.destroy_node()
        context.try_shutdown()


WRENCHES = [f"estimator/wrench{which}" for which in ("", "_base", "_lower", "_upper")]


def test_a_lifecycle_manager_brings_it_up_and_down_while_subscribers_come_and_go(graph, start):
    name = "/managed/estimator"
    process = start("estimator", "/managed", autostart=False)
    wrenches = []
    graph.node.create_subscription(WrenchStamped, f"{name}/wrench", wrenches.append, 10)
    topics = [f"/managed/{topic}" for topic in WRENCHES]
    with subscribers_that_come_and_go(WrenchStamped, topics):
        for _ in range(5):  # one or two ended an estimator without publishers that outlive it
            assert graph.change_state(name, Transition.TRANSITION_CONFIGURE), process.log
            assert not graph.call(f"{name}/tare").success
            assert graph.change_state(name, Transition.TRANSITION_ACTIVATE)
            wrenches.clear()
            graph.until(lambda: wrenches, "zero wrenches without a source")
            assert graph.change_state(name, Transition.TRANSITION_DEACTIVATE)
            assert graph.change_state(name, Transition.TRANSITION_CLEANUP)
    assert graph.change_state(name, Transition.TRANSITION_UNCONFIGURED_SHUTDOWN)


# holds Python's lock, as Fast DDS does when a participant is discovered at that moment
STUCK = """
import ctypes, sys
from rclpy.node import Node
from cablesense_ros import node_process

class Stuck(Node):
    def __init__(self):
        super().__init__("stuck")
        if sys.argv[1] == "in a callback":
            self.create_timer(0.1, self.destroy_node)
        print("up", flush=True)

    def destroy_node(self):
        ctypes.PyDLL(None).pause()

node_process._ENDED_WITHIN_S = 1
node_process._STUCK_AFTER_S = 2
raise SystemExit(node_process.run_node(Stuck))
"""


@pytest.mark.parametrize("where", ["in a callback", "at its end"])
def test_a_node_that_fast_dds_does_not_let_go_is_ended_by_an_alarm(where):
    with subprocess.Popen([sys.executable, "-c", STUCK, where], stdout=subprocess.PIPE) as process:
        assert process.stdout.readline() == b"up\n"
        if where == "at its end":
            process.send_signal(signal.SIGINT)
        assert process.wait(timeout=20.0) == -signal.SIGALRM


# samples come five times as fast as they are answered
OVERLOADED = """
import threading, time
from rclpy.node import Node
from sensor_msgs.msg import JointState
from cablesense_msgs_py.qos import PUBLISHER_QOS, SENSOR_QOS
from cablesense_online.followed_publisher import FollowedPublisher
from cablesense_ros import node_process
from cablesense_ros.endpoints import qos_profile, subscribe_to_those_waiting

class Overloaded(Node):
    def __init__(self):
        super().__init__("overloaded")
        self.samples = self.create_publisher(JointState, "samples", qos_profile(PUBLISHER_QOS))
        self.together = []
        subscribe_to_those_waiting(
            self, JointState, "samples", SENSOR_QOS, FollowedPublisher(),
            self.take, lambda problem: None, 8,
        )
        self.began_s = time.monotonic()
        self.create_timer(0.1, self.tell)
        threading.Thread(target=self.ask, daemon=True).start()

    def ask(self):
        while True:
            self.samples.publish(JointState())
            time.sleep(0.001)

    def take(self, raws):
        self.together.append(len(raws))
        time.sleep(0.005 * len(raws))

    def tell(self):
        if time.monotonic() > self.began_s + 5.0:
            print("a timer has its turn,", max(self.together), "came together", flush=True)

node_process._STUCK_AFTER_S = 2
raise SystemExit(node_process.run_node(Overloaded))
"""


def test_a_node_whose_samples_come_too_fast_goes_on_with_all_else_and_ends():
    command = [sys.executable, "-c", OVERLOADED]
    with subprocess.Popen(command, stdout=subprocess.PIPE) as process:
        try:
            assert process.stdout.readline() == b"a timer has its turn, 8 came together\n"
            process.send_signal(signal.SIGINT)
            assert process.wait(timeout=20.0) == 0
        finally:
            process.kill()
