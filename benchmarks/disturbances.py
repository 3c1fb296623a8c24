"""Sensors that drift, a table that is bumped, a tap: what is stated of the arm meanwhile.

    python benchmarks/disturbances.py [--arms 20] [--seed 7501] [--write]

Every arm is built within tolerances, tared straight and taken to a pose within 10 degrees. Four
cases:

- zeros drift by 1 N an hour, each channel up or down, for three hours without another tare: every
  half hour the arm is touched and left alone in turn;
- gains change by 2 %, each up or down, after the tare;
- the table is bumped: one period of a sinusoidal acceleration of 0.5 to 5 m/s², across gravity,
  lasts 20 to 200 ms;
- the arm is tapped: half a sine of 5 to 40 N on segments 2 to 4, for 10 to 100 ms.

The first two are of the independent plant at rest, the others of MuJoCo's dynamics: a table that
accelerates is a gravity that does. There each sample counts, from the disturbance until a second
after it, and is compared with what acts at that moment. A contact is false if nothing touches the
arm and it has more than 2 N; `judging.py` says what is wrong.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from typing import Any

import harness
import numpy as np
from estimated_arm import EstimatedArm
from judging import Acting
from rich.progress import track
from trust import ARMS, BEND_RAD, Answered, ArmGivenUpError, TestedArm

from cablesense_base import Array
from cablesense_msgs_py.messages import ForceState, Load
from cablesense_online.answer import Answer
from cablesense_online.simulated_arm import SimulatedArm
from cablesense_plants.arm.built import Push
from cablesense_sim.arm import open_arm
from cablesense_sim.built_arm import built_arm
from cablesense_sim.dynamics import ArmDynamics
from cablesense_sim.kinematics import segment_rotations
from cablesense_sim.loads import normal_force_n
from cablesense_sim.touch import touched_places

DRIFT_N_PER_HOUR = 1.0
HOURS = (0.5, 1.0, 1.5, 2.0, 2.5, 3.0)
GAIN_SHARE = 0.02
CONTACTS_AT_ONCE = 2
"""Touched and untouched states of each arm and hour, or of each arm with other gains."""
ACCELERATIONS_M_S2 = (0.5, 5.0)
BUMPS_S = (0.02, 0.2)
TAPS_N = (5.0, 40.0)
TAPS_S = (0.01, 0.1)
EVENTS_OF_AN_ARM = 10
AFTER_S = 1.0
REST_S = 1.5
RATE_HZ = 200
TIMESTEP_S = 1e-3
JOINT_SPEED_RAD_S = float(np.deg2rad(20.0))
FALSE_N = 2.0
VOUCHED = (ForceState.CONTACT, ForceState.MOMENT)
QUIET = (ForceState.FREE, ForceState.HIDDEN, ForceState.UNCONFIRMED)
"""No contact is vouched for."""


class ChangingArm(TestedArm):
    """An arm of the plant whose sensors change after its tare.

    Attributes:
        gain: (M,) of each channel, beside that which the tare has met.
        zero_n: (M,) added to each channel since the tare.
    """

    gain: Array | float = 1.0
    zero_n: Array | float = 0.0

    def read(self, tensions_n: Array) -> Array:
        """Readings of tensions (M,) by sensors as they are now."""
        return np.maximum(self.gain * super().read(tensions_n) + self.zero_n, 0.0)

    def wait(self, duration_s: float) -> None:
        """Time passes without readings."""
        self._now_s += duration_s

    def states(self, strongest_n: float) -> Iterator[Answered]:
        """The arm touched and left alone in turn."""
        for _ in range(CONTACTS_AT_ONCE):
            for touches in (self.drawn(strongest_n)[:1], []):
                acting = self.under(touches)
                tensions_n = self.tensions_n(acting)
                if tensions_n is not None:
                    answer = self.answer(tensions_n, "", [])
                    yield Answered(touches, acting, answer, "")


def drifting(name: str, rng: np.random.Generator) -> Iterator[Answered]:
    """One arm whose zeros drift for three hours."""
    arm = changing_arm(name, rng)
    rates_n = DRIFT_N_PER_HOUR * rng.choice([-1.0, 1.0], arm.arm.cable_count)
    before_h = 0.0
    for hours in HOURS:
        arm.wait(3600.0 * (hours - before_h))
        arm.zero_n = hours * rates_n
        arm.release()
        yield from arm.states(ARMS[name])
        before_h = hours


def other_gains(name: str, rng: np.random.Generator) -> Iterator[Answered]:
    """One arm whose gains have changed."""
    arm = changing_arm(name, rng)
    arm.gain = 1.0 + GAIN_SHARE * rng.choice([-1.0, 1.0], arm.arm.cable_count)
    arm.release()
    yield from arm.states(ARMS[name])


def changing_arm(name: str, rng: np.random.Generator) -> ChangingArm:
    """A built arm, tared straight, in a pose within 10 degrees."""
    command_rad = rng.uniform(-BEND_RAD, BEND_RAD, open_arm(name).joint_count)
    return ChangingArm(name, command_rad, rng, built=True)


class MovingArm(EstimatedArm):
    """A simulated arm with its dynamics, on a table, in simulated time."""

    def __init__(self, name: str, rng: np.random.Generator) -> None:
        super().__init__(name, rng, joint_speed_rad_s=JOINT_SPEED_RAD_S)
        built = built_arm(self.arm, int(rng.integers(2**31)))
        self._dynamics = ArmDynamics(self.arm, TIMESTEP_S, built)
        self._gravity_m_s2 = self._dynamics.model.opt.gravity.copy()
        self._simulated = SimulatedArm(
            self._dynamics, TIMESTEP_S, JOINT_SPEED_RAD_S, load_timeout_s=0.0, now_s=0.0
        )
        self._tick = 0
        self.rest()
        self.command_rad = rng.uniform(-BEND_RAD, BEND_RAD, self.arm.joint_count)
        self._simulated.go_to(self.command_rad)
        self.command(self.command_rad)
        self.rest()
        self.rest()
        self.axes = segment_rotations(self.mechanism, self.command_rad)

    @property
    def now_s(self) -> float:
        """Simulated time."""
        return self._tick / RATE_HZ

    def next(self) -> Answer:
        """The answer to the next sample."""
        self._tick += 1
        self._simulated.advance_to(self.now_s)
        reading_n = self._simulated.reading_n(self.arm.sensors, self.rng)
        return self.sample(np.maximum(reading_n, 0.0), self.now_s)

    def rest(self) -> None:
        """Let the arm settle."""
        for _ in range(round(REST_S * RATE_HZ)):
            self.next()

    def accelerated(self, acceleration_m_s2: Array) -> None:
        """Accelerate the table (3,), base axes, from now on."""
        self._dynamics.model.opt.gravity[:] = self._gravity_m_s2 - acceleration_m_s2

    def push(self, segment: int, place_m: float, force_n: Array) -> None:
        """Push on a segment from now on; a force (3,) of zero ends it."""
        self._simulated.push(Load(segment, force_n, place_m), self.now_s)

    def under(self, pushes: Sequence[Push]) -> Acting:
        """The arm under pushes."""
        return Acting(tuple(pushes), self.axes, self.mechanism.segment_length_m)


def bumped(name: str, rng: np.random.Generator) -> Iterator[Answered]:
    """One arm on a table that is bumped again and again."""
    arm = MovingArm(name, rng)
    acting = arm.under([])
    up = arm.mechanism.gravity_m_s2 / np.linalg.norm(arm.mechanism.gravity_m_s2)
    for _ in range(EVENTS_OF_AN_ARM):
        duration_s = rng.uniform(*BUMPS_S)
        across = np.cross(up, rng.standard_normal(3))
        largest_m_s2 = rng.uniform(*ACCELERATIONS_M_S2) * across / np.linalg.norm(across)
        began_s = arm.now_s
        while arm.now_s < began_s + duration_s + AFTER_S:
            since_s = arm.now_s - began_s
            phase = 2.0 * np.pi * min(since_s / duration_s, 1.0)
            arm.accelerated(largest_m_s2 * np.sin(phase))
            yield Answered([], acting, arm.next(), "")
        arm.rest()


def tapped(name: str, rng: np.random.Generator) -> Iterator[Answered]:
    """One arm that is tapped again and again."""
    arm = MovingArm(name, rng)
    touched_m = touched_places(arm.arm).touched_m
    for _ in range(EVENTS_OF_AN_ARM):
        duration_s = rng.uniform(*TAPS_S)
        segment = int(rng.integers(2, arm.arm.segment_count + 1))
        place_m = rng.uniform(*touched_m[segment - 1])
        angle_deg = rng.uniform(0.0, 360.0)
        size_n = rng.uniform(*TAPS_N)
        largest_n = normal_force_n(arm.mechanism, arm.command_rad, segment, angle_deg, size_n)
        began_s = arm.now_s
        while arm.now_s < began_s + duration_s + AFTER_S:
            since_s = arm.now_s - began_s
            share = np.sin(np.pi * since_s / duration_s) if since_s < duration_s else 0.0
            force_n = share * largest_n[segment - 1]
            arm.push(segment, place_m, force_n)
            acting = arm.under([Push(segment, place_m, force_n)] if share else [])
            yield Answered([], acting, arm.next(), "")
        arm.rest()


CASES = {
    "zeros drift by 1 N an hour": drifting,
    "gains change by 2 %": other_gains,
    "a table is bumped": bumped,
    "a tap": tapped,
}


def figures(answered: Sequence[Answered]) -> dict[str, Any]:
    """What the answers of a case come to."""
    untouched = [one for one in answered if not one.acting.pushes]
    touched = [one for one in answered if one.acting.pushes]
    quiet = sum(one.answer.force in QUIET for one in untouched)
    false_contacts = sum(_is_vouched(one) and _stated_n(one) > FALSE_N for one in untouched)
    wrong = [one for one in answered if one.answer.force.known and one.is_wrong]
    return {
        "untouched": len(untouched),
        "free_or_unconfirmed": round(quiet / max(len(untouched), 1), 4),
        "false_contacts_above_2_n": false_contacts,
        "touched": len(touched),
        "vouched": sum(map(_is_vouched, touched)),
        "wrong_and_vouched": len(wrong),
        "largest_wrong_n": round(max((one.error_n for one in wrong), default=0.0), 1),
        "states_untouched": _states(untouched),
        "states_touched": _states(touched),
    }


def _is_vouched(one: Answered) -> bool:
    return one.answer.force in VOUCHED


def _stated_n(one: Answered) -> float:
    stated = one.stated
    return 0.0 if stated is None else stated.size_n


def _states(answered: Sequence[Answered]) -> dict[str, int]:
    return dict(Counter(one.answer.force.value for one in answered).most_common())


def tried(name: str, title: str, arms: int, seed: int) -> dict[str, Any]:
    """The figures of one case on so many arms of one file."""
    answered: list[Answered] = []
    given_up = 0
    for number in track(range(arms), f"{name}, {title}"):
        rng = np.random.default_rng([seed, *name.encode(), *title.encode(), number])
        try:
            answered += CASES[title](name, rng)
        except ArmGivenUpError:
            given_up += 1
    return {**figures(answered), "arms_given_up": given_up}


def main() -> int:
    """Disturbs arms of both files, prints, and keeps the figures with `--write`."""
    options = harness.parser(__doc__, "disturbances.json")
    options.add_argument("--arms", type=int, default=20, help="of each case and arm file")
    options.add_argument("--seed", type=int, default=7501, help="of arms, poses and disturbances")
    given = options.parse_args()
    result = {
        name: {title: tried(name, title, given.arms, given.seed) for title in CASES}
        for name in ARMS
    }
    return harness.publish("disturbances.json", result, given, "mujoco", "numpy")


if __name__ == "__main__":
    raise SystemExit(main())
