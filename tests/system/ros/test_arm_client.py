"""A client waits for the nodes that must read its first command, whoever else reads commands."""

from contextlib import ExitStack

from rclpy.node import Node
from sensor_msgs.msg import JointState

from cablesense_online.page.live_arm import LiveArm
from cablesense_ros.arm_client import ArmClient
from cablesense_sim.arm import open_arm

ARM = open_arm("cdsm")
TOPIC = "/joint_commands"


def reader(name, stack):
    node = Node(name)
    stack.callback(node.destroy_node)
    node.create_subscription(JointState, TOPIC, lambda message: None, 10)


def test_other_readers_do_not_stand_for_those_that_are_awaited(graph):
    live = LiveArm(ARM, joint_speed_rad_s=0.35)
    client = ArmClient(graph.node, ARM, live, "estimator", ["sim", "estimator"])
    with ExitStack() as stack:
        for name in ("sim", "plotter", "echo"):
            reader(name, stack)
        graph.until(lambda: len(graph.node.get_subscriptions_info_by_topic(TOPIC)) > 3, "readers")
        assert not client.connected
        reader("estimator", stack)
        graph.until(lambda: client.connected, "the estimator")
