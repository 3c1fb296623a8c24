"""The `commissioner` node: moves an unloaded arm or machine from pose to pose, to know it."""

from __future__ import annotations

import array
import sys
import time
from collections import deque
from collections.abc import Sequence
from functools import partial

import numpy as np
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.time import Time
from sensor_msgs.msg import JointState
from std_msgs.msg import UInt8MultiArray
from trajectory_msgs.msg import JointTrajectory

from cablesense_base import Array, CableSenseError
from cablesense_base.files import output_file
from cablesense_contact.calibration import CalibrationError
from cablesense_contact.calibration_file import calibration_bytes, write_calibration
from cablesense_msgs_py import topics
from cablesense_msgs_py.messages import (
    Level,
    NamedOrder,
    Status,
    breath_turn,
    joint_command_rad,
    put_joint_angles,
)
from cablesense_msgs_py.qos import COMMAND_QOS, LATCHED_QOS, SENSOR_QOS
from cablesense_msgs_py.serialized import EffortReader
from cablesense_online.chosen_poses import chosen_poses
from cablesense_online.commissioning import (
    Commissioning,
    CommissioningRefusedError,
    CommissioningSettings,
    Stage,
)
from cablesense_online.followed_publisher import FollowedPublisher
from cablesense_online.loading import load
from cablesense_online.samples import ProblemKind, ReadingLimits, SampleError, Stamps
from cablesense_ros.endpoints import RefusalLog, qos_profile, serve, subscribe_to_one
from cablesense_ros.node_process import (
    declare_parameters,
    parameter_table,
    publish_diagnostics,
    run_node,
)
from cablesense_sim.compiled import leave_interpreted

_TICK_S = 0.02
"""From one command to the next."""
_DELIVERED_WITHIN = Duration(seconds=1)
"""How long the end waits until subscribers have the last command; then they are gone, too."""
_OWN_COMMANDS = 500
"""Commands come back after having been sent, on a busy machine seconds later: the stamps of these
many tell them from those of others."""
_RATED_BY = 100
"""Of so many latest readings the rate is taken."""
_FEWEST_HEARD = 5
"""Readings before a rate is known."""
_SIDES = {"auto": None, "one": False, "both": True}


class CommissionerNode(Node):
    """Commissions on request; stops on contact, on silence, and when others command the arm."""

    def __init__(self) -> None:
        super().__init__("commissioner")
        self._given = declare_parameters(self, parameter_table("commissioner"))
        settings = self._given
        loaded = load(settings["arm"], settings["model"])
        self._movable = loaded.movable()
        law = loaded.law
        assert law is not None  # what can be moved has one
        self._law = law
        felt = loaded.machine
        self._felt = felt
        self._settings = CommissioningSettings(
            joint_speed_rad_s=settings["joint_speed_rad_s"],
            settle_s=settings["settle_s"],
            readings=settings["readings"],
            approach_rad=settings["approach_rad"],
            both_sides=_SIDES[settings["sides"]],
            silent_after_s=settings["stale_after_s"],
        )
        self._poses_rad = chosen_poses(
            self._movable, law, settings["poses"], settings["bend_rad"], settings["readings"]
        )
        self._joints = NamedOrder(felt.command_names, "joints")
        self._cables = NamedOrder(felt.channels.names, "cables")
        self._reader = EffortReader()
        self._limits = ReadingLimits(felt.channels)
        self._stamps = Stamps()
        self._base_rad: Array | None = None
        if not settings["await_command"]:
            self._base_rad = felt.first_command
        self._commanded_ns = 0
        self._heard_s: deque[float] = deque(maxlen=_RATED_BY)
        self._sent_ns: deque[int] = deque(maxlen=_OWN_COMMANDS)
        self._running: Commissioning | None = None
        self._status = Status("commissioning", Level.OK, "none yet")
        self._message = JointState(name=list(felt.command_names))
        self._commands = self.create_publisher(
            JointState, topics.JOINT_COMMANDS, qos_profile(COMMAND_QOS)
        )
        self._calibrations = self.create_publisher(
            UInt8MultiArray, topics.CALIBRATION, qos_profile(LATCHED_QOS)
        )
        self._refuse = RefusalLog(self)
        self._refuse.subscribe(JointState, topics.JOINT_COMMANDS, COMMAND_QOS, self._on_command)
        self._refuse.subscribe(
            JointTrajectory, topics.JOINT_TRAJECTORY, COMMAND_QOS, self._on_trajectory
        )
        subscribe_to_one(
            self,
            JointState,
            topics.CABLE_TENSIONS,
            SENSOR_QOS,
            FollowedPublisher(settings["stale_after_s"]),
            self._on_tensions,
            partial(self._refuse, topics.CABLE_TENSIONS),
        )
        serve(self, topics.COMMISSION, self._begin)
        self.create_timer(_TICK_S, self._tick)
        publish_diagnostics(self, self._statuses, lambda: felt.identity)
        self.get_logger().info(
            f"arm {felt.identity}, model {loaded.path}: {len(self._poses_rad)} poses chosen"
        )

    def destroy_node(self) -> None:
        """Leaves the arm where it is now."""
        if self._running is not None:
            self._running.stop("the node ends", self._now_ns())
            self._tick()
            self._commands.wait_for_all_acked(_DELIVERED_WITHIN)
        super().destroy_node()

    def _begin(self) -> str:
        """Begin; gives how long it will take and how far the arm will go.

        Raises:
            CableSenseError: not now, or not here.
        """
        settings = self._given
        if self._running is not None:
            raise CommissioningRefusedError(
                "a commissioning is under way; wait until it has ended"
            )
        if self._base_rad is None:
            raise CommissioningRefusedError(
                f"no command on {topics.JOINT_COMMANDS} yet, so the pose to begin from is "
                "unknown; send the one that the arm is at"
            )
        now_ns = self._now_ns()
        waited_s = 1e-9 * (now_ns - self._commanded_ns)
        if waited_s < settings["rest_s"]:
            raise CommissioningRefusedError(
                f"commanded {waited_s:.1f} s ago; a commissioning begins {settings['rest_s']:g} s "
                "after a command (rest_s) at the earliest"
            )
        rate_hz = self._rate_hz()
        if settings["calibration_file"]:
            output_file(settings["calibration_file"], force=True)
        start_rad = self._base_rad
        farthest_m = self._movable.farthest_m(start_rad, self._poses_rad)
        running = Commissioning(
            self._movable, self._law, self._poses_rad, start_rad, now_ns, rate_hz, self._settings
        )
        self._running = running
        progress = running.progress
        return (
            f"{progress.holds} holds in {len(self._poses_rad)} poses, about "
            f"{progress.remaining_s:.0f} s; its end moves by up to {farthest_m:.2f} m: leave it "
            "alone"
        )

    def _rate_hz(self) -> float:
        """At which readings come now.

        Raises:
            CommissioningRefusedError: none do, or there are too few yet.
        """
        heard_s = self._heard_s
        if not heard_s or time.monotonic() - heard_s[-1] > self._given["stale_after_s"]:
            raise CommissioningRefusedError(
                f"no readings on {topics.CABLE_TENSIONS}; are the sensors' driver and the network "
                "running?"
            )
        if len(heard_s) < _FEWEST_HEARD:
            raise CommissioningRefusedError(
                f"only {len(heard_s)} readings on {topics.CABLE_TENSIONS} yet; call again in a "
                "moment"
            )
        return (len(heard_s) - 1) / (heard_s[-1] - heard_s[0])

    def _on_tensions(self, raw: bytes) -> None:
        now_s = time.monotonic()
        if self._heard_s and now_s - self._heard_s[-1] > self._given["stale_after_s"]:
            self._heard_s.clear()  # a pause is no part of the rate
        self._heard_s.append(now_s)
        running = self._running
        if running is None:
            return
        try:
            message = self._reader.read(raw)
            reading_n = self._cables.arrange(message.names, message.values, "effort")
            now_ns = self._now_ns()
            self._stamps = self._stamps.accepted(
                message.stamp_ns, now_ns, self._given["stale_after_s"]
            )
            self._limits.check(reading_n.tolist())
            running.take(reading_n, message.stamp_ns or now_ns)
        except CableSenseError as error:
            if not _is_of_the_clock(error):
                running.stop(str(error), self._now_ns())
            self._refuse(topics.CABLE_TENSIONS, error)
        self._tick()

    def _on_command(self, message: JointState) -> None:
        if breath_turn(message) is not None:
            self._give_way("a breather moves the arm")
            return
        command_rad = joint_command_rad(
            message, self._joints, self._base_rad, self._felt.largest_command
        )
        if Time.from_msg(message.header.stamp).nanoseconds in self._sent_ns:
            return
        if self._base_rad is None or not np.array_equal(command_rad, self._base_rad):
            self._commanded_ns = self._now_ns()
        self._base_rad = command_rad
        self._give_way("another node commands the arm")

    def _on_trajectory(self, message: JointTrajectory) -> None:
        if not message.points:
            return
        self._commanded_ns = self._now_ns()
        self._give_way("another node commands the arm along a trajectory")

    def _give_way(self, why: str) -> None:
        if self._running is not None:
            self._running.give_way(why)
            self._tick()

    def _tick(self) -> None:
        running = self._running
        if running is None:
            return
        command_rad = running.advance(self._now_ns())
        if command_rad is not None:
            self._base_rad = command_rad
            put_joint_angles(self._message, command_rad)
            now = self.get_clock().now()
            self._sent_ns.append(now.nanoseconds)
            self._message.header.stamp = now.to_msg()
            self._commands.publish(self._message)
        if running.over:
            self._running = None
            self._commanded_ns = self._now_ns()
            self._end(running)

    def _end(self, ended: Commissioning) -> None:
        """State how it ended; a calibration is published and saved."""
        values = {"holds": f"{ended.progress.holds_done} of {ended.progress.holds}"}
        if ended.stage is Stage.STOPPED:
            text = f"stopped: {ended.problem}"
            self._status = Status("commissioning", Level.ERROR, text, values)
            self.get_logger().error(f"{text}; nothing was saved")
            return
        calibration = ended.calibration
        content = calibration_bytes(calibration, self._felt)
        self._calibrations.publish(UInt8MultiArray(data=array.array("B", content)))
        known_force = ended.progress.known_force
        values["force of a contact known to (N)"] = f"{known_force.half_interval_n:.3g}"
        values["probability of such residuals"] = f"{calibration.misfit_probability:.3g}"
        level = Level.OK
        text = f"done: {calibration.made_from}"
        if ended.skipped:
            text += f", {ended.skipped} holds left out where a cable would be nearly slack"
        if not calibration.as_described:
            level = Level.WARN
            text += "; it is not as its file's tolerances describe it"
        path = self._given["calibration_file"]
        if path:
            values["file"] = path
            try:
                write_calibration(path, calibration, self._felt)
            except CalibrationError as error:
                level = Level.ERROR
                text += f"; not saved: {error}"
        self._status = Status("commissioning", level, text, values)
        log = self.get_logger()
        (log.info if level is Level.OK else log.warning)(f"{text}; {known_force.text}")

    def _now_ns(self) -> int:
        return int(self.get_clock().now().nanoseconds)

    def _statuses(self) -> list[Status]:
        running = self._running
        if running is None:
            return [self._status]
        progress = running.progress
        values = {
            "holds": f"{progress.holds_done} of {progress.holds}",
            "left (s)": f"{progress.remaining_s:.0f}",
            "force of a contact known to (N)": f"{progress.known_force.half_interval_n:.3g}",
        }
        text = f"{running.stage.value}: {progress.text}"
        return [Status("commissioning", Level.OK, text, values)]


def _is_of_the_clock(error: CableSenseError) -> bool:
    """Whether a sample was refused only because it came late; the next may be in time."""
    return isinstance(error, SampleError) and error.kind is ProblemKind.CLOCK


def main(args: Sequence[str] | None = None) -> int:
    """Run the node."""
    leave_interpreted()
    return run_node(CommissionerNode, args)


if __name__ == "__main__":
    sys.exit(main())
