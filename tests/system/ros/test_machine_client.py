"""A client waits for the nodes that must read its first command, whoever else reads commands."""

from contextlib import ExitStack

from rclpy.node import Node
from sensor_msgs.msg import JointState

from cablesense_online.page.live_machine import LiveMachine
from cablesense_online.page.shown_arm import ShownArm
from cablesense_ros.machine_client import MachineClient
from cablesense_sim.arm import open_arm

ARM = open_arm("cdsm")
TOPIC = "/joint_commands"


def reader(name, stack):
    node = Node(name)
    stack.callback(node.destroy_node)
    node.create_subscription(JointState, TOPIC, lambda message: None, 10)


def test_other_readers_do_not_stand_for_those_that_are_awaited(graph):
    live = LiveMachine(ShownArm(ARM), joint_speed_rad_s=0.35)
    client = MachineClient(graph.node, live, "estimator", ["sim", "estimator"])
    with ExitStack() as stack:
        for name in ("sim", "plotter", "echo"):
            reader(name, stack)
        graph.until(lambda: len(graph.node.get_subscriptions_info_by_topic(TOPIC)) > 3, "readers")
        assert not client.connected
        reader("estimator", stack)
        graph.until(lambda: client.connected, "the estimator")
