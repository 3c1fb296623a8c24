"""Sim, estimator, wall and controller as processes: the force falls, and stops mean stop."""

import time

import numpy as np
import pytest
from geometry_msgs.msg import WrenchStamped
from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue
from rcl_interfaces.srv import SetParameters
from ros_graph import Graph, NodeProcess
from sensor_msgs.msg import JointState

from cablesense_sim.arm import open_arm

rclpy = pytest.importorskip("rclpy")


pytestmark = [
    pytest.mark.ros,
    pytest.mark.slow,
    pytest.mark.filterwarnings("ignore::DeprecationWarning"),
]

SIM, ESTIMATOR = "cablesense_ros.sim_node", "cablesense_ros.estimator_node"
OBSTACLE, ADMITTANCE = "cablesense_ros.obstacle_node", "cablesense_ros.admittance_node"
STALE_AFTER_S = 0.2
LATENESS_S = 0.1
HELD_N = 30.0
ARM = open_arm("cdsm")


class Loop(Graph):
    """Receives the true force and every command, with the time it came."""

    def __init__(self):
        super().__init__()
        self.forces, self.commands = [], []
        listen = self.node.create_subscription
        listen(WrenchStamped, "/applied_wrench", self._on_load, 100)
        listen(JointState, "/joint_commands", self._on_command, 100)

    def _on_load(self, message):
        force = message.wrench.force
        self.forces.append(
            (time.monotonic(), float(np.hypot(np.hypot(force.x, force.y), force.z)))
        )

    def _on_command(self, message):
        self.commands.append((time.monotonic(), np.array(message.position)))

    @property
    def force_n(self):
        return self.forces[-1][1] if self.forces else 0.0

    def forces_of_last(self, seconds):
        since = time.monotonic() - seconds
        return np.array([force for when, force in self.forces if when >= since])

    def advance_wall(self, depth_m):
        """Move the wall as `ros2 param set /obstacle depth_m …` does."""
        client = self.node.create_client(SetParameters, "/obstacle/set_parameters")
        self.until(client.service_is_ready, "the obstacle's parameters")
        value = ParameterValue(type=ParameterType.PARAMETER_DOUBLE, double_value=depth_m)
        request = SetParameters.Request(parameters=[Parameter(name="depth_m", value=value)])
        future = client.call_async(request)
        self.until(future.done, "the wall's new depth")
        assert future.result().results[0].successful
        self.node.destroy_client(client)


def started_estimator():
    return NodeProcess(ESTIMATOR, tare_samples=100)


@pytest.mark.timeout(180)
def test_the_force_falls_stays_low_and_a_killed_estimator_stops_the_arm():
    loop = Loop()
    processes = [
        NodeProcess(SIM, load_timeout_s=1.0),
        NodeProcess(
            OBSTACLE, segment=3, angle_deg=90.0, delay_s=0.0, depth_m=-0.005, speed_m_s=0.1
        ),
        NodeProcess(ADMITTANCE, stale_after_s=STALE_AFTER_S, resume_after_s=0.5),
    ]
    estimator = started_estimator()
    try:
        _falls_and_stays(loop, estimator, processes[2])
        _killed_and_back(loop, estimator, processes)
        _yields_to_another_commander(loop, processes[2])
        _lets_go_at_its_end(loop, processes[1])
    finally:
        estimator.kill()
        codes = [process.stop() for process in processes]
        loop.close()
    assert codes[:3] == [0, 0, 0], [process.log for process in processes]
    assert not any("Traceback" in process.log for process in processes)


def _falls_and_stays(loop, estimator, admittance):
    loop.until(lambda: "tare taken" in estimator.log, "the tare")
    loop.until(lambda: "estimates are trusted" in admittance.log, "the controller's trust")
    assert not loop.commands  # nothing touches: nothing moves
    loop.advance_wall(HELD_N / 10_000.0)
    loop.until(lambda: loop.force_n > 0.75 * HELD_N, "the wall to press")
    loop.until(lambda: loop.force_n < HELD_N / 8, "the force to fall below an eighth")
    loop.spin(1.5)
    settled = loop.forces_of_last(1.5)
    assert settled.max() < HELD_N / 8
    assert (np.diff(settled) < 0.5).all()  # what still moves, falls
    steps = np.diff([command[3] for _, command in loop.commands])
    assert (steps >= 0.0).all()  # one way only: no oscillation


def _killed_and_back(loop, estimator, processes):
    loop.advance_wall(2.0 * HELD_N / 10_000.0)
    count = len(loop.commands)
    loop.until(lambda: len(loop.commands) > count, "a step away from the advancing wall")
    estimator.kill()
    killed_s = time.monotonic()
    loop.spin(1.0)
    late = [when for when, _ in loop.commands if when > killed_s + STALE_AFTER_S + LATENESS_S]
    assert not late
    assert "stopped: no state of the force with a fresh stamp" in processes[2].log
    loop.until(
        lambda: "stopped" in loop.statuses["admittance: control"].message, "the diagnostics"
    )
    held = loop.commands[-1][1]
    loop.advance_wall(-0.005)  # a tare wants an untouched arm
    loop.until(lambda: loop.force_n == 0.0, "the wall to let go")
    processes.append(started_estimator())
    loop.until(lambda: "tare taken" in processes[-1].log, "the tare of the new estimator")
    repeated = [command for when, command in loop.commands if when > killed_s + 1.0]
    assert repeated  # the new estimator receives the pose
    assert all(np.array_equal(command, held) for command in repeated)
    loop.until(
        lambda: processes[2].log.count("estimates are trusted") == 2, "the controller's trust"
    )
    before = len(loop.commands)
    loop.advance_wall(2.0 * HELD_N / 10_000.0)
    loop.until(lambda: loop.force_n > 6.0, "the wall to press again")
    loop.until(lambda: loop.force_n < 5.0, "the force to fall again")
    assert len(loop.commands) > before


def _yields_to_another_commander(loop, admittance):
    position = [0.0, 0.05] + [0.0] * 6
    loop.command.publish(JointState(name=list(ARM.joint_names), position=position))
    loop.until(lambda: "that pose is home" in admittance.log, "the controller to give way")
    loop.commands.clear()
    loop.spin(0.8)
    assert all(np.array_equal(command, position) for _, command in loop.commands)


def _lets_go_at_its_end(loop, obstacle):
    loop.advance_wall(0.03)
    loop.until(lambda: loop.force_n > 5.0, "the wall to press on the arm elsewhere")
    assert obstacle.stop() == 0, obstacle.log
    loop.until(lambda: loop.force_n == 0.0, "the last message of the wall")
