"""Sim, a channel that fails, estimator and controller as processes: an untouched arm stays."""

import numpy as np
import pytest
from rclpy.qos import qos_profile_sensor_data
from ros_graph import Graph, NodeProcess
from sensor_msgs.msg import JointState

from cablesense_msgs_py.messages import Level

pytestmark = [
    pytest.mark.ros,
    pytest.mark.slow,
    pytest.mark.filterwarnings("ignore::DeprecationWarning"),
]

MOVES_DEG = 0.5
HEALTHY = "healthy_tensions"


def scaled(reading):
    reading[0] *= 2.0


def exchanged(reading):
    reading[[2, 7]] = reading[[7, 2]]


def off(reading):
    reading[10] += 5.0


def dead(reading):
    reading[:] = 0.0


class FailingChannel(Graph):
    """Passes the sim's tensions on with a fault, and receives every command."""

    def __init__(self):
        super().__init__()
        self.fault = None
        self.commands, self._read = [], 0
        self._out = self.node.create_publisher(JointState, "/cable_tensions", 10)
        listen = self.node.create_subscription
        listen(JointState, f"/{HEALTHY}", self._pass_on, qos_profile_sensor_data)
        listen(JointState, "/joint_commands", self._on_command, 100)

    def _pass_on(self, message):
        if self.fault is not None:
            reading = np.array(message.effort)
            self.fault(reading)
            message.effort = reading.tolist()
        self._out.publish(message)

    def _on_command(self, message):
        self.commands.append(np.array(message.position))

    def logs(self, process, words):
        """Spin until a node logs words, after those that were waited for before."""
        self.until(lambda: words in process.log[self._read :], words)
        self._read = process.log.index(words, self._read) + len(words)

    def level_of(self, status):
        found = self.statuses.get(status)
        return None if found is None else Level(found.level[0])


@pytest.mark.timeout(240)
def test_no_fault_of_a_channel_moves_an_untouched_arm():
    graph = FailingChannel()
    processes = [
        NodeProcess("cablesense_ros.sim_node", remaps={"cable_tensions": HEALTHY}),
        NodeProcess("cablesense_ros.estimator_node"),
        NodeProcess("cablesense_ros.admittance_node", resume_after_s=0.5),
    ]
    estimator, admittance = processes[1:]
    try:
        graph.until(lambda: "tare taken" in estimator.log, "the tare")
        for fault in (scaled, exchanged, off, dead):
            graph.logs(admittance, "estimates are trusted")
            graph.fault = fault
            graph.logs(admittance, "stopped")
            graph.statuses.clear()  # one of the fault before may stand there still
            graph.until(
                lambda: graph.level_of("estimator: plausibility") == Level.ERROR, "the diagnosis"
            )
            graph.spin(1.0)
            graph.fault = None
        turned_rad = max((np.abs(command).max() for command in graph.commands), default=0.0)
    finally:
        codes = [process.stop() for process in processes]
        graph.close()
    assert np.rad2deg(turned_rad) <= MOVES_DEG
    assert codes == [0, 0, 0], [process.log for process in processes]
