"""A wrong parameter ends a node with one line; a wrong file leaves it unconfigured.

A command that the arm cannot do is refused by each node that takes commands.
"""

import math
from importlib import import_module

import pytest

pytest.importorskip("rclpy", reason="needs ROS 2, or its wheels", exc_type=ImportError)

import rclpy
from ros_graph import Graph, NodeProcess
from sensor_msgs.msg import JointState

from cablesense_ros.can_driver_node import CanDriverNode
from cablesense_ros.estimator_node import EstimatorNode
from cablesense_ros.node_process import FAILURE
from cablesense_ros.processes import node_command
from cablesense_sim.arm import open_arm

pytestmark = [
    pytest.mark.ros,
    pytest.mark.slow,
    pytest.mark.filterwarnings("ignore::DeprecationWarning"),
]


ARM = open_arm("cdsm")


@pytest.mark.parametrize(
    ("node", "parameters", "reason"),
    [
        ("sim", {"joint_speed_deg_s": -5.0}, "parameter joint_speed_deg_s"),
        ("sim", {"noise": False, "seed": 3}, "seed has no effect without noise"),
        ("sim", {"arm": "none"}, "bundled arms are"),
        ("estimator", {"joint_speed_deg_s": -5.0}, "0.1 to 360"),
        ("can_driver", {"bitrate_bit_s": -5}, "0 to 1e+06"),
        ("can_emulator", {"fault": "explosion"}, "unknown fault"),
        ("can_emulator", {"recording": "none.csv"}, "no such file"),
        ("can_emulator", {"channel": "/none/of/that"}, "no link to"),
        ("can_emulator", {"loop": True}, "loop has no effect without recording"),
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
    ("make", "parameters", "reason"),
    [
        (EstimatorNode, {"model": "none.onnx"}, "none.onnx"),
        (CanDriverNode, {"map": "none"}, "bundled channel maps are"),
        (CanDriverNode, {"calibration": "none.yaml"}, "none.yaml: cannot be read"),
        (CanDriverNode, {"interface": "none"}, "unknown to python-can"),
    ],
)
def test_a_wrong_file_leaves_a_lifecycle_node_unconfigured(make, parameters, reason, capfd):
    rclpy.init(args=node_command("any", parameters)[3:])
    node = make()
    try:
        node.autostart()
        (status,) = node._statuses()
        assert "not configured" in status.message
    finally:
        node.destroy_node()
        rclpy.try_shutdown()
    printed = capfd.readouterr().err
    assert "cannot configure" in printed
    assert reason in printed
    assert "Traceback" not in printed


@pytest.mark.parametrize(
    ("step", "parameters"),
    [
        ("activate", {"qos_overrides./cable_tensions.subscription.depth": -5}),
        ("configure", {"qos_overrides./estimator/wrench.publisher.depth": -5}),
    ],
)
def test_what_no_one_foresaw_is_told_and_the_step_can_be_tried_again(step, parameters, capfd):
    rclpy.init(args=node_command("any", parameters)[3:])
    node = EstimatorNode()
    try:
        configured = node.trigger_configure()
        if step == "configure":
            assert configured == FAILURE
        for _ in range(2 * (step == "activate")):
            assert node.trigger_activate() == FAILURE
        assert not node._active
        assert not [one for one in node.subscriptions if one.topic_name == "/cable_tensions"]
    finally:
        node.destroy_node()
        rclpy.try_shutdown()
    printed = capfd.readouterr().err
    assert f"cannot {step}:\nTraceback" in printed


def test_what_the_arm_cannot_do_is_refused_with_one_warning_a_second():
    graph, node = Graph(), NodeProcess("cablesense_ros.sim_node")
    try:
        graph.until(graph.command.get_subscription_count, "a subscriber of commands")
        for _ in range(20):
            for angle_rad in (math.nan, math.radians(1e6), 0.6):
                message = JointState(name=list(ARM.joint_names), position=[0.0, angle_rad] * 4)
                graph.command.publish(message)
        for reason in ("finite and within", "guide plates touch"):
            graph.until(lambda reason=reason: reason in node.log, reason)
        graph.spin(0.3)
        assert node.log.count("refused") <= 4
        graph.until(lambda: graph.tensions, "tensions")
        assert max(graph.tensions[-1].effort) < 100.0
    finally:
        node.stop()
        graph.close()
