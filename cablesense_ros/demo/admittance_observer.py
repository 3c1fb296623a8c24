"""The node of a headless demo of the controller: moves the wall, and writes down what happens."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from contextlib import suppress
from typing import Any

import numpy as np
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import WrenchStamped
from numpy.typing import NDArray
from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue
from rcl_interfaces.srv import SetParameters
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray

from cablesense_msgs_py import qos, topics
from cablesense_msgs_py.errors import CableSenseError
from cablesense_msgs_py.frames import Frames
from cablesense_msgs_py.joint_state import joint_command_rad
from cablesense_msgs_py.load import read_load
from cablesense_msgs_py.named_values import NamedOrder
from cablesense_ros.admittance.elastic_wall import Approach
from cablesense_ros.admittance.estimate_watch import EstimateWatch, WatchSettings
from cablesense_ros.admittance.estimator_messages import read_wrench
from cablesense_ros.contract_inputs import of_node
from cablesense_ros.demo.admittance_record import AdmittanceRecord
from cablesense_ros.discovery import prefer_quick_discovery
from cablesense_ros.qos_profiles import qos_profile
from cablesense_sim.arm import Arm

Array = NDArray[np.float64]

RECORD_EVERY_S = 0.04
PRESS_AT_S = 1.0
_STATUS = "admittance: control"


class AdmittanceObserver:
    """Listens in a thread of its own until `close`."""

    def __init__(self, arm: Arm) -> None:
        prefer_quick_discovery()
        rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
        self._node = Node("demo")
        self._frames = Frames(arm.segment_count)
        self._joints = NamedOrder(arm.joint_names, "joints")
        self._lock = threading.Lock()
        self._command = np.zeros(arm.joint_count)
        self._watch = EstimateWatch(
            self._command, WatchSettings(resume_after_s=0.0), time.monotonic()
        )
        self._true_n = self._estimated_n = 0.0
        self._control = ""
        for kind, topic, handle in (
            (WrenchStamped, topics.APPLIED_WRENCH, self._on_load),
            (JointState, topics.JOINT_COMMANDS, self._on_command),
            (WrenchStamped, of_node("estimator", topics.WRENCH), self._on_wrench),
            (
                Float64MultiArray,
                of_node("estimator", topics.CONTACT_PROBABILITIES),
                self._on_probabilities,
            ),
            (DiagnosticArray, topics.DIAGNOSTICS, self._on_diagnostics),
        ):
            self._node.create_subscription(kind, topic, handle, qos_profile(qos.COMMAND))
        self._wall = self._node.create_client(SetParameters, "obstacle/set_parameters")
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self._node)
        self._thread = threading.Thread(target=self._spin, name="demo observer", daemon=True)
        self._thread.start()

    @property
    def ready(self) -> bool:
        """Whether the wall can be moved and the controller trusts the estimator."""
        return self._wall.service_is_ready() and self._control in ("free", "contact", "blind")

    def move_wall(self, depth_m: float) -> None:
        """Set where the wall stops."""
        value = ParameterValue(type=ParameterType.PARAMETER_DOUBLE, double_value=depth_m)
        request = SetParameters.Request(parameters=[Parameter(name="depth_m", value=value)])
        self._wall.call_async(request)

    def close(self) -> None:
        """End the node and its thread."""
        self._executor.shutdown()
        self._thread.join(timeout=2.0)
        self._node.destroy_node()
        rclpy.try_shutdown()

    def moment(self) -> tuple[Any, ...]:
        """True and estimated force, command and sight, now."""
        with self._lock:
            sight = self._watch.look(time.monotonic())
            return self._true_n, self._estimated_n, self._command, sight

    def _on_load(self, message: WrenchStamped) -> None:
        with suppress(CableSenseError):
            self._true_n = float(np.linalg.norm(read_load(message, self._frames).force_base_n))

    def _on_command(self, message: JointState) -> None:
        with suppress(CableSenseError), self._lock:
            self._command = joint_command_rad(message, self._joints)
            self._watch.commanded(self._command, time.monotonic())

    def _on_wrench(self, message: WrenchStamped) -> None:
        with suppress(CableSenseError), self._lock:
            felt = read_wrench(message, self._frames)
            self._estimated_n = float(np.linalg.norm(felt.force_n))
            self._watch.heard_wrench(bool(felt.segment), 0.0, time.monotonic())

    def _on_probabilities(self, _: Float64MultiArray) -> None:
        with self._lock:
            self._watch.heard_probabilities(time.monotonic())

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status:
            if status.name == _STATUS:
                self._control = status.message.partition(";")[0]

    def _spin(self) -> None:
        with suppress(ExternalShutdownException):
            self._executor.spin()


def play_wall(
    observer: AdmittanceObserver,
    press_m: float,
    leave_m: float,
    approach: Approach,
    unyielding_stiffness_n_m: float,
    duration_s: float,
    check: Callable[[], None],
) -> AdmittanceRecord:
    """Press for half of the time, then leave; the record in real time.

    Args:
        observer: moves the wall and watches.
        press_m: where the wall stops, along its normal, to press.
        leave_m: where it stops to leave.
        approach: as the obstacle's, to know where the wall is.
        unyielding_stiffness_n_m: wall and arm in series.
        duration_s: of the whole.
        check: called at every step; raises to end the play.
    """
    leaves_s = 0.5 * duration_s
    target_m, before_s = leave_m, 0.0
    start = time.monotonic()
    rows = []
    while (now_s := time.monotonic() - start) < duration_s:
        check()
        wanted_m = press_m if PRESS_AT_S <= now_s < leaves_s else leave_m
        if wanted_m != target_m:
            target_m = wanted_m
            observer.move_wall(target_m)
        advance_m = approach.towards(target_m, now_s - before_s)
        before_s = now_s
        unyielding_n = max(0.0, unyielding_stiffness_n_m * advance_m)
        rows.append((now_s, unyielding_n, *observer.moment()))
        time.sleep(RECORD_EVERY_S)
    times, unyielding, true, estimated, commands, sights = zip(*rows, strict=True)
    return AdmittanceRecord(
        times_s=np.array(times),
        true_n=np.array(true),
        unyielding_n=np.array(unyielding),
        estimated_n=np.array(estimated),
        commands_rad=np.array(commands),
        sights=tuple(sights),
        leaves_s=leaves_s,
    )
