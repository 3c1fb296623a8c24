"""The demo of a controller: a wall presses on the simulated arm, and the arm moves away."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import WrenchStamped
from rcl_interfaces.srv import SetParameters
from rclpy.node import Node
from rclpy.parameter import Parameter
from sensor_msgs.msg import JointState

from cablesense_base import Array
from cablesense_msgs_py import qos, topics
from cablesense_msgs_py.messages import (
    NamedOrder,
    joint_command_rad,
    read_force_state,
    read_load,
)
from cablesense_msgs_py.topics import Frames
from cablesense_online.admittance.estimate_watch import (
    ContactState,
    EstimateWatch,
    read_wrench,
)
from cablesense_online.admittance.law import AdmittanceSettings
from cablesense_online.admittance.wall import Approach, compliance_m_n
from cablesense_ros.arm_client import record
from cablesense_ros.endpoints import RefusalLog, of_node
from cablesense_sim.arm import Arm
from cablesense_sim.build import mechanism_of

DEADBAND_N = 2.0
PRESS_M, CLEAR_M = 0.003, -0.005
"""Where the wall stops to press, and where it stops clear of the arm, along its normal."""
STIFFNESS_N_M = 10_000.0
SPEED_M_S = 0.05
PRESS_AT_S = 1.0
_STEADY_S = 2.0
"""The end of the contact that the settled force is averaged over."""
_STATUS = "admittance: control"


def pressed_segment(segment_count: int) -> int:
    """The segment that the wall presses on."""
    return min(3, segment_count)


@dataclass(frozen=True)
class WallRecord:
    """K moments.

    Attributes:
        times_s: (K,) since the wall began to move.
        true_n: (K,) force of the wall on the arm.
        unyielding_n: (K,) what the wall would press with, had the arm not been commanded away.
        estimated_n: (K,) the estimator's.
        commands_rad: (K, 2N) commands in force.
        contact_states: (K,) what could be known of contacts.
        leaves_s: when the wall began to retreat.
    """

    times_s: Array
    true_n: Array
    unyielding_n: Array
    estimated_n: Array
    commands_rad: Array
    contact_states: tuple[ContactState, ...]
    leaves_s: float

    def metrics(self) -> dict[str, Any]:
        """Forces without and with controller, N, and when the force had settled, s."""
        pressed = self.times_s < self.leaves_s
        steady = pressed & (self.times_s >= self.leaves_s - _STEADY_S)
        settled_n = float(self.true_n[steady].mean())
        touched = np.flatnonzero(pressed & (self.unyielding_n > DEADBAND_N))
        above = np.flatnonzero(pressed & (self.true_n > settled_n + 1.0))
        settling_s = (
            float(self.times_s[above[-1]] - self.times_s[touched[0]])
            if len(above) and len(touched)
            else 0.0
        )
        changed = np.abs(np.diff(self.commands_rad, axis=0)).max(axis=1) > 0.0
        return {
            "without_controller_n": float(self.unyielding_n[steady].mean()),
            "peak_n": float(self.true_n[pressed].max()),
            "settled_n": settled_n,
            "settling_s": settling_s,
            "steps": int(np.count_nonzero(changed & pressed[1:])),
            "left_from_home_deg": float(np.rad2deg(np.abs(self.commands_rad[-1]).max())),
        }


class Moment(NamedTuple):
    """True and estimated force, command (2N,) and contact state at one time."""

    true_n: float
    estimated_n: float
    command_rad: Array
    contact_state: ContactState


class WallObserver:
    """Watches wall, estimator and controller by a node that another thread spins."""

    def __init__(self, node: Node, arm: Arm) -> None:
        self._frames = Frames(arm.segment_count)
        self._joints = NamedOrder(arm.joint_names, "joints")
        self._command = np.zeros(arm.joint_count)
        self._watch = EstimateWatch(AdmittanceSettings(resume_after_s=0.0), time.monotonic())
        self._true_n = self._estimated_n = 0.0
        self._control = ""
        self._lock = threading.Lock()
        refuse = RefusalLog(node)
        for kind, topic, handle in (
            (WrenchStamped, topics.APPLIED_WRENCH, self._on_load),
            (JointState, topics.JOINT_COMMANDS, self._on_command),
            (WrenchStamped, topics.WRENCH, self._on_wrench),
            (DiagnosticArray, topics.STATUS, self._on_state),
            (DiagnosticArray, topics.DIAGNOSTICS, self._on_diagnostics),
        ):
            refuse.subscribe(kind, of_node("estimator", topic), qos.COMMAND, handle)
        self._wall = node.create_client(SetParameters, "obstacle/set_parameters")

    @property
    def ready(self) -> bool:
        """Whether the wall can be moved and the controller trusts the estimator."""
        return self._wall.service_is_ready() and self._control in ("free", "contact", "unknown")

    def move_wall(self, depth_m: float) -> None:
        """Set where the wall stops."""
        wanted = [Parameter("depth_m", value=depth_m).to_parameter_msg()]
        self._wall.call_async(SetParameters.Request(parameters=wanted))

    def moment(self) -> Moment:
        """The present."""
        with self._lock:
            state = self._watch.update(time.monotonic())
            return Moment(self._true_n, self._estimated_n, self._command, state)

    def _on_load(self, message: WrenchStamped) -> None:
        self._true_n = float(np.linalg.norm(read_load(message, self._frames).force_base_n))

    def _on_command(self, message: JointState) -> None:
        with self._lock:
            self._command = joint_command_rad(message, self._joints, self._command)

    def _on_wrench(self, message: WrenchStamped) -> None:
        _, force_n, _ = read_wrench(message, self._frames)
        with self._lock:
            self._estimated_n = float(np.linalg.norm(force_n))

    def _on_state(self, message: DiagnosticArray) -> None:
        force, _ = read_force_state(message)
        with self._lock:
            self._watch.received(force, 0.0, time.monotonic())

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status:
            if status.name == _STATUS:
                self._control = status.message.partition(";")[0]


def unyielding_stiffness_n_m(arm: Arm) -> float:
    """Stiffness of the wall in series with the arm where it stands still."""
    mechanism = mechanism_of(arm)
    segment = pressed_segment(arm.segment_count)
    sideways = np.array([0.0, 1.0, 0.0])
    compliance = compliance_m_n(mechanism, np.zeros(arm.joint_count), segment, sideways)
    return 1.0 / (1.0 / STIFFNESS_N_M + compliance)


def play_wall(
    wall: WallObserver, stiffness_n_m: float, duration_s: float, check: Callable[[], object]
) -> WallRecord:
    """Press for half of the time, then leave; the record in real time.

    Args:
        wall: is moved and watched.
        stiffness_n_m: of wall and arm in series.
        duration_s: of the whole.
        check: called at every step; raises to end the play.
    """
    leaves_s = 0.5 * duration_s
    approach = Approach(CLEAR_M, SPEED_M_S)  # as the obstacle's, to know where the wall is
    target_m, before_s = CLEAR_M, 0.0

    def moment(now_s: float) -> tuple[float, Moment]:
        nonlocal target_m, before_s
        wanted_m = PRESS_M if PRESS_AT_S <= now_s < leaves_s else CLEAR_M
        if wanted_m != target_m:
            target_m = wanted_m
            wall.move_wall(target_m)
        advance_m = approach.towards(target_m, now_s - before_s)
        before_s = now_s
        return max(0.0, stiffness_n_m * advance_m), wall.moment()

    times, seen = record(moment, duration_s, check)
    unyielding, moments = zip(*seen, strict=True)
    true, estimated, commands, states = zip(*moments, strict=True)
    return WallRecord(
        times,
        np.array(true),
        np.array(unyielding),
        np.array(estimated),
        np.array(commands),
        states,
        leaves_s,
    )
