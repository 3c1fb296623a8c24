"""Processes that are killed and started again by a node that pushes the arm and notes all.

One trial: push, wait until the wrench is right, kill at a random moment, watch, start again.
"""

from __future__ import annotations

import itertools
import re
import time
from collections.abc import Mapping
from math import nan
from typing import NamedTuple

import numpy as np
from geometry_msgs.msg import WrenchStamped
from live_run import LiveRun, SpunNode, load_message
from rclpy.event_handler import QoSLivelinessChangedInfo, SubscriptionEventCallbacks
from sensor_msgs.msg import JointState

from cablesense_base import Array
from cablesense_msgs_py.qos import Qos
from cablesense_ros.endpoints import qos_profile
from cablesense_ros.processes import Process, node_command
from cablesense_sim.arm import Arm
from cablesense_sim.build import mechanism_of
from cablesense_sim.loads import normal_force_n

STALE_AFTER_S = 0.05
LEASE_S = 0.08
"""After so long without a sign of life of the estimator, the middleware reports it as gone."""

LOAD_EVERY_S, COMMAND_EVERY_S = 0.05, 0.5
TOLERANCE_N, TOLERANCE = 2.0, 0.03
"""A wrench is right when its force is no further from the load than the larger of these."""

STEADY = 10
"""The number of right wrenches in a row that counts as right."""

SETTLED_S = 1.0
"""A change of load has swung out by then; a wrench that differs from the load later is wrong."""

SWING_S = 0.2
DEAD_S = (0.15, 0.6)
AT_ANY_MOMENT_S = 0.5

_SET_UP = {
    "driver": r"\[INFO\] \[([\d.]+)\] \[can_driver\]: arm ",
    "sim": r"\[INFO\] \[([\d.]+)\] \[sim\]: arm ",
    "estimator": r"\[INFO\] \[([\d.]+)\] \[estimator\]: arm .*: configured",
}
VICTIMS = tuple(_SET_UP)


def start_chain(run: LiveRun, arm: str, rate_hz: float) -> None:
    """Start recorder, sim, amplifiers, driver and estimator."""
    link = run.folder / "adapter"
    adapter = {"interface": "slcan", "channel": link, "bitrate_bit_s": 1_000_000}
    stale = {"arm": arm, "stale_after_s": STALE_AFTER_S}
    simulated = {"cable_tensions": "simulated_tensions"}
    state = {"state_file": run.folder / "estimator_state.json"}
    run.record("recorder")
    run.start("sim", node_command("sim", {"arm": arm, "rate_hz": float(rate_hz)}, simulated))
    run.start("amplifiers", node_command("can_emulator", {"arm": arm, "channel": link}))
    run.start("driver", node_command("can_driver", stale | adapter))
    run.start("estimator", node_command("estimator", stale | state))


class Received(NamedTuple):
    """One wrench: its arrival (monotonic), its age then, segment and force (3,), N."""

    arrived_s: float
    age_s: float
    segment: int
    force_n: Array

    @property
    def zero(self) -> bool:
        """Whether it reports no contact."""
        return self.segment == 0 and not self.force_n.any()


class KillTrials(SpunNode):
    """Pushes the arm and commands it periodically, notes every wrench and sample, and kills.

    Times are monotonic.

    Attributes:
        samples: stamps of all samples received, ns.
    """

    def __init__(self, arm: Arm, chain: Mapping[str, Process], seed: int) -> None:
        super().__init__("watcher")
        self._arm, self._mechanism, self._chain = arm, mechanism_of(arm), chain
        self._rng = np.random.default_rng(seed)
        self.samples: list[int] = []
        self._wrenches: list[Received] = []
        self._sample_s: list[float] = []
        self._living: list[tuple[float, int]] = []
        self._load_since_s = time.monotonic()
        self._force_n: Array = np.zeros(3)
        self._segment = 1
        names = list(arm.joint_names)
        self._command = JointState(name=names, position=[0.0] * len(names))
        self._load_out = self.create_publisher(WrenchStamped, "applied_wrench", 10)
        self._command_out = self.create_publisher(JointState, "joint_commands", 10)
        self.create_timer(LOAD_EVERY_S, self._publish_load)
        self.create_timer(COMMAND_EVERY_S, self._publish_command)
        self.create_subscription(
            WrenchStamped,
            "estimator/wrench",
            self._on_wrench,
            qos_profile(Qos(depth=2000, reliable=True, lease_s=LEASE_S)),
            event_callbacks=SubscriptionEventCallbacks(liveliness=self._on_liveliness),
        )
        sample_qos = qos_profile(Qos(depth=2000, reliable=True))
        self.create_subscription(JointState, "cable_tensions", self._on_sample, sample_qos)

    def bring_up(self) -> None:
        """Wait until the unloaded arm is tared and wrenches follow the load."""
        self.spin_until(lambda: len(self._sample_s) > 100, "samples")
        self.spin(2.0)
        self._push()
        self._until_right("the first right wrench")

    def kill(self, victim: str) -> dict[str, float]:
        """Kill one and see it come back; times in s, NaN where one does not apply.

        Gives `others_lived`: 1 where every other process kept its id; `stale_s`: from the kill to
        the first zero wrench, or for the estimator to the report of the subscriber's own
        middleware that it is gone; `last_force_s`: from the kill to the last wrench with a force;
        `zero_age_s`: largest age of the zero wrenches' stamps when they came; `set_up_s`,
        `first_sample_s`, `right_s`: from the start to the process's log line that it is set up,
        to the first sample, and to the first wrench of those that are right and stay so;
        `right_after_set_up_s`; `wrong`: wrenches with another force than the load's, a second
        after the load last changed; `false_deaths`: reports that a living estimator is gone.

        Raises:
            TimeoutError: what should come did not come in time.
        """
        process = self._chain[victim]
        self._push()
        self._until_right(f"a right wrench before {victim} is killed")
        self.spin(float(self._rng.uniform(0.0, AT_ANY_MOMENT_S)))
        before, set_ups = self._other_pids(victim), len(self._set_up_epoch_s(victim))
        self._wrenches.clear()
        self._living.clear()
        del self._sample_s[:-1]
        killed_s = process.kill()
        if self._rng.random() < 0.5:
            self._push()  # the process must not come back to the old load
        self.spin(float(self._rng.uniform(*DEAD_S)))
        zeros = [one for one in self._wrenches if one.zero and one.arrived_s >= killed_s]
        forces_s = [one.arrived_s for one in self._wrenches if not one.zero]
        silent_from_s = self._sample_s[-1] if self._sample_s else killed_s
        started_epoch_s = time.time()
        process.start()
        started_s = process.started_s
        self.spin_until(
            lambda: len(self._set_up_epoch_s(victim)) > set_ups, f"{victim} to be set up again"
        )
        right_s = self._until_right(f"a right wrench after {victim} came back", since_s=started_s)
        gone_s = [at for at, alive in self._living if alive == 0]
        stale_s = [one.arrived_s for one in zeros]
        if victim == "estimator":
            stale_s = [at for at in gone_s if killed_s <= at < started_s]
        samples_s = [at for at in self._sample_s if at > max(started_s, silent_from_s)]
        set_up_s = self._set_up_epoch_s(victim)[-1] - started_epoch_s
        return {
            "others_lived": before == self._other_pids(victim),
            "stale_s": min(stale_s, default=nan) - killed_s,
            "last_force_s": max(forces_s, default=nan) - killed_s,
            "zero_age_s": max((one.age_s for one in zeros), default=nan),
            "set_up_s": set_up_s,
            "first_sample_s": min(samples_s, default=nan) - started_s,
            "right_s": right_s - started_s,
            "right_after_set_up_s": right_s - started_s - set_up_s,
            "wrong": self._wrong(victim, started_s),
            "false_deaths": sum(victim != "estimator" or at > right_s for at in gone_s),
        }

    def _right(self, wrench: Received) -> bool:
        """Whether a wrench is the present load. The arm is straight: base axes are its own."""
        limit_n = max(TOLERANCE_N, TOLERANCE * float(np.linalg.norm(self._force_n)))
        off_n = np.linalg.norm(wrench.force_n - self._force_n)
        return wrench.segment == self._segment and bool(off_n <= limit_n)

    def _publish_load(self) -> None:
        segments = range(1, self._arm.segment_count + 1)
        for segment in sorted(segments, key=lambda one: one == self._segment):  # zeros first
            force_n = self._force_n if segment == self._segment else np.zeros(3)
            self._load_out.publish(load_message(segment, force_n))

    def _publish_command(self) -> None:
        self._command.header.stamp = self.get_clock().now().to_msg()
        self._command_out.publish(self._command)

    def _on_wrench(self, message: WrenchStamped) -> None:
        force, stamp = message.wrench.force, message.header.stamp
        age_s = time.time() - stamp.sec - stamp.nanosec * 1e-9
        frame = message.header.frame_id
        segment = int(frame.rpartition("_")[2]) if frame.startswith("segment_") else 0
        force_n = np.array([force.x, force.y, force.z])
        self._wrenches.append(Received(time.monotonic(), age_s, segment, force_n))

    def _on_sample(self, message: JointState) -> None:
        stamp = message.header.stamp
        self.samples.append(stamp.sec * 1_000_000_000 + stamp.nanosec)
        self._sample_s.append(time.monotonic())

    def _on_liveliness(self, event: QoSLivelinessChangedInfo) -> None:
        self._living.append((time.monotonic(), event.alive_count))

    def _other_pids(self, victim: str) -> dict[str, int]:
        return {k: one.pid for k, one in self._chain.items() if k != victim and one.alive}

    def _set_up_epoch_s(self, victim: str) -> list[float]:
        """The times at which a victim logged that it was set up, s since the epoch."""
        return [float(at) for at in re.findall(_SET_UP[victim], self._chain[victim].log)]

    def _wrong(self, victim: str, started_s: float) -> int:
        """Number of wrenches with a force that is not the load.

        A sim that comes back is unloaded, and swings when it takes the load again.
        """
        forces = [one for one in self._wrenches if not one.zero]
        settled_s = self._load_since_s + SETTLED_S
        back = [one.arrived_s for one in forces if one.arrived_s > started_s]
        if victim == "sim" and back:
            settled_s = max(settled_s, back[0] + SWING_S)
        return sum(one.arrived_s > settled_s and not self._right(one) for one in forces)

    def _push(self) -> None:
        self._segment = segment = int(self._rng.integers(1, self._arm.segment_count + 1))
        forces = normal_force_n(
            self._mechanism,
            np.zeros(self._arm.joint_count),
            segment=segment,
            angle_deg=float(self._rng.uniform(0.0, 360.0)),
            magnitude_n=float(self._rng.uniform(20.0, 100.0)),
        )
        self._force_n = forces[segment - 1]
        self._publish_load()
        self._load_since_s = time.monotonic()

    def _until_right(self, what: str, since_s: float = 0.0) -> float:
        """When the first of `STEADY` right wrenches in a row came, of those that stay right."""
        wrenches = self._wrenches

        def right(one: Received) -> bool:
            return one.arrived_s >= since_s and self._right(one)

        self.spin_until(
            lambda: len(wrenches) >= STEADY and all(map(right, wrenches[-STEADY:])), what
        )
        return list(itertools.takewhile(right, reversed(wrenches)))[-1].arrived_s
