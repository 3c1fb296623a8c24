"""One kill: push, wait until the answer is right, kill at a random moment, watch, start again.

Someone outside who pushes the arm and watches what comes of it.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from geometry_msgs.msg import WrenchStamped
from numpy.typing import NDArray
from rclpy.event_handler import QoSLivelinessChangedInfo, SubscriptionEventCallbacks
from rclpy.executors import Executor
from rclpy.node import Node
from rclpy.task import Future
from sensor_msgs.msg import JointState

from cablesense_msgs_py.qos import Qos
from cablesense_ros.node_process import qos_profile
from cablesense_sim.arm import Arm
from cablesense_sim.build import mechanism_of
from cablesense_sim.loads import normal_force_n
from kill.chain import Chain

LEASE_S = 0.08
"""Without a sign of life of the estimator for so long, this subscriber's middleware says so."""

LOAD_EVERY_S = 0.05
COMMAND_EVERY_S = 0.5
TOLERANCE_N, TOLERANCE = 2.0, 0.03
"""A wrench is right when its force is no further from the load than the larger of these."""

DEEP = Qos(depth=2000, reliable=True)
WATCHED = Qos(depth=2000, reliable=True, lease_s=LEASE_S)


class Heard(NamedTuple):
    """One wrench: when it came, what its stamp says (s since the epoch), segment and force."""

    arrived_s: float
    arrived_epoch_s: float
    stamp_s: float
    segment: int
    force_n: tuple[float, float, float]

    @property
    def zero(self) -> bool:
        """Whether it says that nothing touches."""
        return self.segment == 0 and not any(self.force_n)


class Watcher(Node):
    """Publishes the present load and command again and again, notes every wrench and sample.

    Times are monotonic.

    Attributes:
        wrenches: since `forget`.
        samples: stamps of all samples heard, ns.
        last_sample_s: when the last one came.
        liveliness: (when, how many estimators are alive) since `forget`.
        load_since_s: when the present load was first published.
    """

    def __init__(self, arm: Arm) -> None:
        super().__init__("watcher")
        self.wrenches: list[Heard] = []
        self.samples: list[int] = []
        self.sample_s: list[float] = []
        self.liveliness: list[tuple[float, int]] = []
        self._load = WrenchStamped()
        self._load.header.frame_id = "segment_1"
        self._force_n: NDArray[np.float64] = np.zeros(3)
        self._segment, self._segment_count = 1, arm.segment_count
        self.load_since_s = time.monotonic()
        self._command = JointState(
            name=list(arm.joint_names), position=[0.0] * len(arm.joint_names)
        )
        self._load_out = self.create_publisher(WrenchStamped, "applied_wrench", 10)
        self._command_out = self.create_publisher(JointState, "joint_commands", 10)
        self.create_timer(LOAD_EVERY_S, self._say_load)
        self.create_timer(COMMAND_EVERY_S, self._say_command)
        self.create_subscription(
            WrenchStamped,
            "estimator/wrench",
            self._on_wrench,
            qos_profile(WATCHED),
            event_callbacks=SubscriptionEventCallbacks(liveliness=self._on_liveliness),
        )
        self.create_subscription(JointState, "cable_tensions", self._on_sample, qos_profile(DEEP))

    def push(self, segment: int, force_base_n: NDArray[np.float64]) -> None:
        """Push there instead of where it was pushed before."""
        before = self._segment
        self._segment, self._force_n = segment, force_base_n
        if before != segment:
            self._publish(before, np.zeros(3))
        self._say_load()
        self.load_since_s = time.monotonic()

    def right(self, heard: Heard) -> bool:
        """Whether a wrench tells the present load. The arm is straight: base axes are its own."""
        off_n = float(np.linalg.norm(np.array(heard.force_n) - self._force_n))
        limit_n = max(TOLERANCE_N, TOLERANCE * float(np.linalg.norm(self._force_n)))
        return heard.segment == self._segment and off_n <= limit_n

    def forget(self) -> None:
        """Begin to note anew."""
        self.wrenches.clear()
        self.liveliness.clear()
        del self.sample_s[:-1]

    def spin(self, executor: Executor, seconds: float) -> None:
        """Let callbacks run for a while."""
        executor.spin_until_future_complete(Future(), timeout_sec=seconds)

    def _say_load(self) -> None:
        for segment in range(1, self._segment_count + 1):
            self._publish(segment, self._force_n if segment == self._segment else np.zeros(3))

    def _publish(self, segment: int, force_n: NDArray[np.float64]) -> None:
        self._load.header.frame_id = f"segment_{segment}"
        force = self._load.wrench.force
        force.x, force.y, force.z = force_n.tolist()
        self._load_out.publish(self._load)

    def _say_command(self) -> None:
        self._command.header.stamp = self.get_clock().now().to_msg()
        self._command_out.publish(self._command)

    def _on_wrench(self, message: WrenchStamped) -> None:
        force, stamp = message.wrench.force, message.header.stamp
        frame = message.header.frame_id
        self.wrenches.append(
            Heard(
                time.monotonic(),
                time.time(),
                stamp.sec + stamp.nanosec * 1e-9,
                int(frame.rpartition("_")[2]) if frame.startswith("segment_") else 0,
                (force.x, force.y, force.z),
            )
        )

    def _on_sample(self, message: JointState) -> None:
        stamp = message.header.stamp
        self.samples.append(stamp.sec * 1_000_000_000 + stamp.nanosec)
        self.sample_s.append(time.monotonic())

    def _on_liveliness(self, event: QoSLivelinessChangedInfo) -> None:
        self.liveliness.append((time.monotonic(), event.alive_count))


PATIENCE_S = 20.0
STEADY = 10
"""So many right wrenches in a row are right."""

SETTLED_S = 1.0
"""A change of load has swung out by then; a wrench that differs from the load later is wrong."""

SWING_S = 0.2
DEAD_S = (0.15, 0.6)
AT_ANY_MOMENT_S = 0.5


@dataclass(frozen=True)
class Kill:
    """What was seen of one; times in s, NaN where it does not apply.

    Attributes:
        others_lived: whether every other process kept its id.
        stale_s: from the kill to the first zero wrench, or for the estimator to the word of the
            subscriber's own middleware that it is gone.
        last_force_s: from the kill to the last wrench with a force.
        zero_age_s: largest age of the zero wrenches' stamps when they came.
        set_up_s: from the start to the process's own word that it is set up.
        first_sample_s: from the start to the first sample from the driver.
        right_s: from the start to the first wrench of those that are right and stay so.
        wrong: wrenches with another force than the load's, a second after the load last changed.
        false_deaths: how often the middleware took a living estimator for dead.
    """

    victim: str
    others_lived: bool
    stale_s: float
    last_force_s: float
    zero_age_s: float
    set_up_s: float
    first_sample_s: float
    right_s: float
    wrong: int
    false_deaths: int

    @property
    def right_after_set_up_s(self) -> float:
        """From the process's word that it is set up to the first right wrench."""
        return self.right_s - self.set_up_s


class KillTrials:
    """Kills in a running chain."""

    def __init__(
        self, arm: Arm, chain: Chain, watcher: Watcher, executor: Executor, seed: int
    ) -> None:
        self._arm, self._mechanism = arm, mechanism_of(arm)
        self._chain, self._watcher, self._executor = chain, watcher, executor
        self._rng = np.random.default_rng(seed)

    def bring_up(self) -> None:
        """Wait until the unloaded arm is tared and answers follow the load."""
        self._until(lambda: len(self._watcher.sample_s) > 100, "samples")
        self._watcher.spin(self._executor, 2.0)
        self._push()
        self._until_right("the first right answer")

    def kill(self, victim: str) -> Kill:
        """Kill one and see it come back.

        Raises:
            TimeoutError: what should come did not come within `PATIENCE_S`.
        """
        watcher, process = self._watcher, self._chain.processes[victim]
        self._push()
        self._until_right(f"a right answer before {victim} is killed")
        watcher.spin(self._executor, float(self._rng.uniform(0.0, AT_ANY_MOMENT_S)))
        before, ups = self._chain.pids(), self._chain.ups(victim)
        watcher.forget()
        killed_s = process.kill()
        if self._rng.random() < 0.5:
            self._push()  # who comes back must not come back to the old load
        watcher.spin(self._executor, float(self._rng.uniform(*DEAD_S)))
        until_start = list(watcher.wrenches)
        gone_s = [at for at, alive in watcher.liveliness if alive == 0 and at >= killed_s]
        silent_from_s = watcher.sample_s[-1] if watcher.sample_s else killed_s
        started_epoch_s = time.time()
        process.start()
        started_s = process.started_s
        self._until(lambda: self._chain.ups(victim) > ups, f"{victim} to be set up again")
        right_s = self._until_right(f"a right answer after {victim} came back", since_s=started_s)
        after = self._chain.pids()
        del before[victim], after[victim]
        forces = [one.arrived_s - killed_s for one in until_start if not one.zero]
        zeros = [one for one in until_start if one.zero and one.arrived_s >= killed_s]
        first_zero_s = zeros[0].arrived_s - killed_s if zeros else float("nan")
        if victim == "estimator":
            first_zero_s = gone_s[0] - killed_s if gone_s else float("nan")
        later = [at for at in watcher.sample_s if at > max(started_s, silent_from_s)]
        return Kill(
            victim=victim,
            others_lived=before == after,
            stale_s=first_zero_s,
            last_force_s=max(forces, default=float("nan")),
            zero_age_s=max((one.arrived_epoch_s - one.stamp_s for one in zeros), default=np.nan),
            set_up_s=self._chain.up_epoch_s(victim) - started_epoch_s,
            first_sample_s=later[0] - started_s if later else float("nan"),
            right_s=right_s - started_s,
            wrong=self._wrong(victim, started_s),
            false_deaths=sum(
                alive == 0 and (victim != "estimator" or at > right_s)
                for at, alive in watcher.liveliness
            ),
        )

    def _wrong(self, victim: str, started_s: float) -> int:
        """How many wrenches tell another force than there is.

        A sim that comes back is unloaded, and swings when it takes the load again.
        """
        forces = [one for one in self._watcher.wrenches if not one.zero]
        settled_s = self._watcher.load_since_s + SETTLED_S
        back = [one.arrived_s for one in forces if one.arrived_s > started_s]
        if victim == "sim" and back:
            settled_s = max(settled_s, back[0] + SWING_S)
        return sum(one.arrived_s > settled_s and not self._watcher.right(one) for one in forces)

    def _push(self) -> None:
        segment = int(self._rng.integers(1, self._arm.segment_count + 1))
        forces = normal_force_n(
            self._mechanism,
            np.zeros(self._arm.joint_count),
            segment=segment,
            angle_deg=float(self._rng.uniform(0.0, 360.0)),
            magnitude_n=float(self._rng.uniform(20.0, 100.0)),
        )
        self._watcher.push(segment, np.asarray(forces)[segment - 1])

    def _until_right(self, what: str, since_s: float = 0.0) -> float:
        """When the first of `STEADY` right wrenches in a row came, of those that stay right."""
        wrenches = self._watcher.wrenches

        def steady() -> bool:
            last = wrenches[-STEADY:]
            return len(last) == STEADY and all(
                one.arrived_s >= since_s and self._watcher.right(one) for one in last
            )

        self._until(steady, what)
        first_s = wrenches[-1].arrived_s
        for one in reversed(wrenches):
            if one.arrived_s < since_s or not self._watcher.right(one):
                break
            first_s = one.arrived_s
        return first_s

    def _until(self, true: Callable[[], bool], what: str) -> None:
        deadline_s = time.monotonic() + PATIENCE_S
        while not true():
            if time.monotonic() > deadline_s:
                last = self._watcher.wrenches[-1:]
                raise TimeoutError(f"waited {PATIENCE_S:g} s in vain for {what}; last: {last}")
            self._watcher.spin(self._executor, 0.02)
