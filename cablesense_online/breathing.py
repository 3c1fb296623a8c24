"""Breathing: the arm moves a little on purpose, so that readings follow the load despite friction.

If cables stick at their guides, readings do not follow the load. A breath turns every joint in a
small circle, pitch a quarter turn ahead of yaw. Each cable then slides at each of its guides, half
of the turn inwards and half outwards. The effect of friction on the logarithm of a tension changes
its sign after half a turn, so the mean over a whole turn is that of the arm without friction. This
holds by symmetry for rigid sticking and for bristles, whatever the coefficients. Motion with the
circle's frequency, swinging included, drops out of the same mean.

The joints turn by different amounts, and the arm's centre line bends like a wave: every cable
moves at every guide, and the tip nearly stays. The least circle turns every guide: there a cable
moves farther than its stretch over the friction loop, T sinh(μ θ) / k, and its give before it
slips.

The breather commands a `Breath` along its `Circle`; the estimator averages by `BreathReadings`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np

from cablesense_base import Array, CableSenseError
from cablesense_msgs_py.messages import BREATH_END, Level, Status
from cablesense_sim import kinematics
from cablesense_sim.arm import Arm
from cablesense_sim.build import entries_of, mechanism_of
from cablesense_sim.effects.registry import amended
from cablesense_sim.equilibrium import held_lengths_m, solve_equilibrium
from cablesense_sim.mechanism import Mechanism

SET_POINTS_A_TURN: Final = 20
_RISE = 10
_LEAD = 10
_FALL = 10
"""Set-points up to the full circle, until the arm has followed, and back."""
_LOADED = 2.0
"""The circle still turns a cable at this multiple of its unloaded tension."""
_LOADED_BEND_RAD = 0.1
"""Total bend of the joints by a load, beyond their command."""
_LEAST_RAD: Final = np.radians(0.03)
MOST_RAD: Final = np.radians(2.0)
_ROUNDED = 2.0
"""Rounded bristles carry 95 % of their limit after three times the `give_m` of sharp ones."""
_SLACK_N = 1.0
_PHASES = 8

SILENT_AFTER_S = 1.0
"""A breather that has sent nothing for this long in mid-breath is assumed to have gone."""
_REST_S = 0.1
"""Readings at rest are averaged over this time to find the friction, and over one at least."""
_FEWEST = 8
_LARGEST_GAP = 0.2
"""Readings of a turn, and the longest time between two of them, in turns."""
_SHIFT_N = 1.0
"""Added before the logarithm: that of a slack cable's noise would weigh as much as a load's."""
_BEYOND_N = 1.0
"""By how much a reading at rest may exceed the range of the turn before."""
_NONE: Final = np.zeros(0)


class BreathError(CableSenseError):
    """An arm for which there is no breath; the message states why, and what would be right."""


@dataclass(frozen=True)
class Circle:
    """The full circle of a breath about a command.

    Attributes:
        axes_rad: (2, 2N) deviation from the command, at the start and a quarter turn later.
        tip_m: largest commanded displacement of the arm's tip.
    """

    axes_rad: Array
    tip_m: float = 0.0

    @property
    def largest_rad(self) -> float:
        """Largest angle by which a joint turns."""
        return float(np.hypot(*self.axes_rad).max())

    def at(self, turns: float) -> Array:
        """(2N,) deviation from the command after a number of turns."""
        phase = 2.0 * np.pi * turns
        return np.asarray(np.array([np.cos(phase), np.sin(phase)]) @ self.axes_rad)


class Breath:
    """Set-points of one breath: up to the full circle, whole turns, and back to the command."""

    def __init__(self, circle: Circle, turns: int) -> None:
        """With this number of whole turns; 0 continues for ever."""
        self._circle = circle
        self._first = _RISE + _LEAD
        self._last = self._first + turns * SET_POINTS_A_TURN if turns else math.inf
        self._number = 0

    @property
    def over(self) -> bool:
        """Whether the last set-point has been given."""
        return self._number > self._last + _FALL

    def next(self) -> tuple[Array, int]:
        """The next deviation from the command (2N,), and its turn (`messages.breath_turn`)."""
        number = self._number
        self._number += 1
        size = min(1.0, number / _RISE)
        turn = 0
        if number >= self._last:
            size = 1.0 - (number - self._last) / _FALL
        elif number >= self._first:
            turn = 1 + (number - self._first) // SET_POINTS_A_TURN
        if self.over:
            return np.zeros_like(self._circle.axes_rad[0]), BREATH_END
        return size * self._circle.at(number / SET_POINTS_A_TURN), turn


def breath_circle(
    arm: Arm, command_rad: Array, amplitude_rad: float = 0.0, largest_tip_m: float = 0.0
) -> Circle:
    """The circle of a breath of an arm about a command (2N,).

    Args:
        arm: with `capstan_friction` among its effects, unless the amplitude is given.
        command_rad: centre of the circle.
        amplitude_rad: of the joint that turns most; 0 takes the least that turns every guide.
        largest_tip_m: largest displacement of the tip; 0 for any.

    Raises:
        BreathError: no friction in the arm file and no amplitude, or one that is too large or
            leaves a cable slack, or moves the tip too far.
        EquilibriumError: the arm has no rest there.
    """
    mechanism = amended(mechanism_of(arm), entries_of(arm))
    axes = (_wave(mechanism)[:, None] * np.eye(2)[:, None]).reshape(2, -1)
    grip, give_m = _grip(arm, mechanism, command_rad)
    unloaded_n = solve_equilibrium(mechanism, command_rad).tensions_n
    wanted_m = _LOADED * unloaded_n * np.sinh(grip) / mechanism.stiffness_n_m + give_m
    per_wave = float(np.max(wanted_m[:, None] / _motion_m(mechanism, command_rad, axes)))
    largest_wave = float(np.abs(axes).max())
    least_rad = max(per_wave * largest_wave, _LEAST_RAD) if grip.any() else 0.0
    amplitude = amplitude_rad or least_rad
    if not amplitude:
        raise BreathError(
            f"arm {arm.name} lists no capstan_friction, so the least amplitude that turns its "
            "guides is unknown; add the effect to the arm file, or give an amplitude"
        )
    if amplitude > MOST_RAD:
        raise BreathError(
            f"no breath of arm {arm.name}: to turn every guide a joint would swing by "
            f"{np.degrees(amplitude):.2f} degrees, more than {np.degrees(MOST_RAD):g}; less "
            "friction or stiffer cables need less"
        )
    circle = Circle(axes * (amplitude / largest_wave))
    poses = command_rad + np.array([circle.at(k / _PHASES) for k in range(_PHASES)])
    lowest_n = solve_equilibrium(mechanism, poses).tensions_n.min(0) * np.exp(-2.0 * grip)
    worst = int(np.argmin(lowest_n))
    if lowest_n[worst] < _SLACK_N:
        raise BreathError(
            f"no breath here: it would leave cable_{worst + 1} with {lowest_n[worst]:.1f} N, as "
            f"good as slack (below {_SLACK_N:g} N); more pretension, or another pose, allows it"
        )
    moved_m = np.linalg.norm(tip_m(mechanism, poses) - tip_m(mechanism, command_rad), axis=-1)
    farthest_m = float(moved_m.max())
    if 0.0 < largest_tip_m < farthest_m:
        raise BreathError(
            f"a breath of {np.degrees(amplitude):.2f} degrees moves the tip by "
            f"{1e3 * farthest_m:.2f} mm, more than {1e3 * largest_tip_m:g}; allow that, or give a "
            "smaller amplitude"
        )
    return replace(circle, tip_m=farthest_m)


def offsets_m(arm: Arm, command_rad: Array, deviation_rad: Array) -> Array:
    """(M,) change of the cable lengths by a deviation (2N,) from a command."""
    mechanism = mechanism_of(arm)
    displaced_rad = command_rad + deviation_rad
    return held_lengths_m(mechanism, displaced_rad) - held_lengths_m(mechanism, command_rad)


def tip_m(mechanism: Mechanism, angles_rad: Array) -> Array:
    """(..., 3) position of the last segment's end at joint angles (..., 2N)."""
    last = kinematics.joint_positions_m(mechanism, angles_rad)[..., -1, :]
    along = kinematics.segment_rotations(mechanism, angles_rad)[..., -1, :, 0]
    return np.asarray(last + mechanism.segment_length_m[-1] * along)


def _wave(mechanism: Mechanism) -> Array:
    """(N,) relative amplitude of each joint.

    The rotation of each segment, the sum over the joints before it, differs from segment to
    segment and is nowhere zero, so that every cable moves at every guide. Weighted with the
    lengths it adds up to zero, so that the tip of the straight arm stays.
    """
    count = mechanism.segment_count
    if count == 1:
        return np.ones(1)
    pairs: Sequence[float] = [1.0, 2.0, -3.0] if count % 2 else []
    sizes = np.arange(1.0, (count - len(pairs)) // 2 + 1) + (3.0 if pairs else 0.0)
    turned = np.array([*sizes[::-1], *pairs, *-sizes])
    turned *= mechanism.segment_length_m.mean() / mechanism.segment_length_m
    return np.diff(turned, prepend=0.0)


def _grip(arm: Arm, mechanism: Mechanism, command_rad: Array) -> tuple[Array, float]:
    """(M,) μ θ of each cable, summed over its guides, and the give before it slips, m."""
    passed = mechanism.cable_segment[:, None] > np.arange(mechanism.segment_count)
    bends_rad = passed @ kinematics.bend_rad(command_rad) + _LOADED_BEND_RAD
    grip = np.zeros(mechanism.cable_count)
    give_m = 0.0
    for entry in entries_of(arm):
        if entry.effect.name == "capstan_friction":
            values = entry.values
            grip += values["coefficient"] * (bends_rad + values["pulley_wrap_rad"])
            give_m = max(give_m, values["give_m"] * (1.0 + _ROUNDED * values["rounding"]))
    return grip, give_m


def _motion_m(mechanism: Mechanism, command_rad: Array, axes_rad: Array) -> Array:
    """(M, N) amplitude of each cable at the guides of each joint; infinite where it has none."""
    jacobian = kinematics.cable_jacobian_m(mechanism, command_rad)
    by_joint = (jacobian * axes_rad[:, None]).reshape(2, len(jacobian), -1, 2).sum(-1)
    beyond = np.hypot(*by_joint[..., ::-1].cumsum(-1)[..., ::-1])
    passed = mechanism.cable_segment[:, None] > np.arange(beyond.shape[-1])
    return np.where(passed, beyond, np.inf)


@dataclass
class BreathState:
    """Progress and results of a breath (`BreathReadings`).

    Attributes:
        turn: turn of the last reading, as `messages.breath_turn` numbers them.
        from_ns, last_ns: stamps of the turn's beginning, 0 where the turn does not count, and of
            the last reading.
        count, gap_ns: number of readings in the turn, and the longest time between two.
        sum_log_n: (M,) sum of their logarithms, weighted by time in s.
        lowest_n, highest_n: (M,) range of the readings.
        mark_turn, mark_ns: turn and stamp of the mark that the next reading passes; 0 for none.
        reading_n: (M,) mean of the last whole turn; empty where none counts.
        ended_ns: stamp of the breath's end; 0 where no rest is awaited.
        rest_n, rest_count: (M,) sum of the readings at rest since, and their number.
        offset_n: (M,) correction of the readings for friction; empty where it is not known.
    """

    turn: int = BREATH_END
    from_ns: int = 0
    last_ns: int = 0
    count: int = 0
    gap_ns: int = 0
    sum_log_n: Array = field(default_factory=lambda: _NONE)
    lowest_n: Array = field(default_factory=lambda: _NONE)
    highest_n: Array = field(default_factory=lambda: _NONE)
    mark_turn: int = BREATH_END
    mark_ns: int = 0
    reading_n: Array = field(default_factory=lambda: _NONE)
    ended_ns: int = 0
    rest_n: Array = field(default_factory=lambda: _NONE)
    rest_count: int = 0
    offset_n: Array = field(default_factory=lambda: _NONE)


class BreathReadings:
    """Takes readings and the marks of a breath as they come; gives the tensions to answer from.

    The mean of the readings' logarithms over each whole turn of a breath is answered from until
    the end of the next. When the breath is over and the arm at rest again, each cable's reading
    differs from that mean by its friction. Readings are corrected by this difference until the arm
    is commanded elsewhere.

    Attributes:
        state: progress and results of the breath.
        learnt: whether the last reading ended a turn, or the wait for rest after a breath.
    """

    def __init__(self, settle_s: float) -> None:
        """`settle_s` is waited after the end of a breath."""
        self._settle_ns = round(settle_s * 1e9)
        self._heard = False
        self._heard_s = 0.0
        self._lasting = False
        self._problem = ""
        self.learnt = False
        self.state = BreathState()

    def mark(self, turn: int, stamp_ns: int, *, lasting: bool = False) -> bool:
        """A message of the breather with this turn and stamp; gives whether that is another turn.

        `lasting` marks an offset of the cables that is no breath's and need not be repeated.
        """
        state = self.state
        self._heard = True
        self._lasting = lasting
        if turn == self._latest_turn:
            return False
        if state.mark_ns:  # no reading came since the previous mark
            self._enter(state.mark_turn, 0)
            self._lose_turn()
        if not self.breathing:
            self._problem = ""
        state.mark_turn = turn
        state.mark_ns = stamp_ns
        return True

    def silent(self, now_s: float) -> bool:
        """Whether the breather seems to have gone in mid-breath.

        To be asked again and again, at monotonic times `now_s`.
        """
        if self._heard or not self.breathing or self._lasting:
            self._heard = False
            self._heard_s = now_s
        return now_s - self._heard_s > SILENT_AFTER_S

    def give_up(self, problem: str) -> None:
        """End the breath here, without any knowledge of friction, for a `problem`."""
        self._enter(BREATH_END, 0)
        self.moved()
        self.state.mark_ns = 0
        self._problem = problem

    def moved(self) -> None:
        """Forget the friction: it is unknown where the arm was commanded to."""
        self.state.reading_n = _NONE
        self.state.offset_n = self.state.reading_n
        self.state.from_ns = 0
        self.state.ended_ns = 0

    @property
    def _latest_turn(self) -> int:
        return self.state.mark_turn if self.state.mark_ns else self.state.turn

    @property
    def breathing(self) -> bool:
        """Whether the arm is away from its command on purpose."""
        return self._latest_turn != BREATH_END

    @property
    def known(self) -> bool:
        """Whether answers rest on a breath."""
        return self.state.reading_n.size > 0 or self.state.offset_n.size > 0

    def without_friction(
        self, tensions_n: Sequence[float], stamp_ns: int
    ) -> Sequence[float] | None:
        """The tensions to answer from at a reading (M,), N; None before a breath has a result."""
        self.learnt = False
        state = self.state
        if state.mark_ns:
            self._pass_mark(tensions_n, stamp_ns)
        elif state.turn > 0:
            self._add(tensions_n, stamp_ns)
        if state.turn == BREATH_END:
            if state.offset_n.size:
                return (state.offset_n + tensions_n).tolist()
            rested_ns = stamp_ns - state.ended_ns - self._settle_ns
            if state.ended_ns and rested_ns >= 0:
                if state.reading_n.size:
                    return self._at_rest(np.array(tensions_n), rested_ns).tolist()
                state.ended_ns = 0
            if not state.ended_ns:
                return tensions_n
        return state.reading_n.tolist() if state.reading_n.size else None

    def status(self) -> Status | None:
        """The results of breathing; None where there has been none."""
        state = self.state
        if self._problem:
            message = f"{self._problem}; friction is in the readings"
            return Status("breathing", Level.ERROR, message)
        loop_n = 0.5 * (state.highest_n - state.lowest_n)
        values = {"friction of each cable (N)": ", ".join(f"{half:.1f}" for half in loop_n)}
        level = Level.OK
        if self.breathing:
            message = "breathing" if self.known else "breathing: no estimate before a whole turn"
        elif state.offset_n.size:
            values["readings corrected by (N)"] = ", ".join(f"{n:+.1f}" for n in state.offset_n)
            message = "breathed at this command"
        elif state.ended_ns:
            message = "coming to rest after a breath"
        elif loop_n.size:
            level = Level.WARN
            message = "moved since the last breath: friction is in the readings"
        else:
            return None
        return Status("breathing", level, message, values)

    def _pass_mark(self, tensions_n: Sequence[float], stamp_ns: int) -> None:
        """End the turn, and begin the next, where the mark lies between two readings."""
        state = self.state
        at_ns = max(state.mark_ns, state.last_ns)
        if stamp_ns < at_ns and state.turn != BREATH_END:
            if state.turn > 0:
                self._add(tensions_n, stamp_ns)
            return
        self.learnt = state.turn > 0
        if state.turn > 0:
            self._add(tensions_n, at_ns)
            lasted_ns = at_ns - state.from_ns
            enough = state.count >= _FEWEST and state.gap_ns <= _LARGEST_GAP * lasted_ns
            if state.from_ns and enough:
                state.reading_n = np.exp(state.sum_log_n / (1e-9 * lasted_ns)) - _SHIFT_N
                self._problem = ""
            else:
                self._lose_turn()
        self._enter(state.mark_turn, at_ns)
        state.mark_ns = 0
        if state.turn > 0:
            self._add(tensions_n, stamp_ns)

    def _lose_turn(self) -> None:
        self.state.reading_n = _NONE
        self._problem = (
            f"a turn of the breath had {self.state.count} samples, up to "
            f"{1e-6 * self.state.gap_ns:.0f} ms apart; it needs {_FEWEST}, and no gap of "
            f"{_LARGEST_GAP:g} turns"
        )

    def _enter(self, turn: int, at_ns: int) -> None:
        state = self.state
        seen_from_its_beginning = state.turn != BREATH_END
        if not seen_from_its_beginning:
            state.reading_n = _NONE
            state.offset_n = state.reading_n
        state.turn = turn
        state.from_ns = 0
        state.last_ns = 0
        state.count = 0
        state.gap_ns = 0
        state.ended_ns = 0
        state.rest_count = 0
        if turn > 0 and seen_from_its_beginning:
            state.from_ns = at_ns
            state.last_ns = state.from_ns
            state.sum_log_n = _NONE
            state.lowest_n = state.sum_log_n
            state.highest_n = state.sum_log_n
        elif turn == BREATH_END:
            state.ended_ns = at_ns
            state.rest_n = _NONE

    def _add(self, tensions_n: Sequence[float], until_ns: int) -> None:
        """Weight a reading by the time since the previous one."""
        state = self.state
        if until_ns < state.last_ns:
            state.from_ns = 0  # a clock was set: this turn does not count
        if not state.from_ns:
            return
        reading = np.array(tensions_n)
        passed_ns = until_ns - state.last_ns
        weighted = np.log(np.maximum(reading, 0.0) + _SHIFT_N) * (1e-9 * passed_ns)
        if not state.count:
            state.sum_log_n = weighted
            state.lowest_n = reading
            state.highest_n = reading
        else:
            state.sum_log_n = state.sum_log_n + weighted
            state.lowest_n = np.minimum(state.lowest_n, reading)
            state.highest_n = np.maximum(state.highest_n, reading)
        state.count += 1
        state.gap_ns = max(state.gap_ns, passed_ns)
        state.last_ns = until_ns

    def _at_rest(self, reading: Array, rested_ns: int) -> Array:
        """The mean of the breath, until the friction left in the readings is known."""
        state = self.state
        state.rest_n = state.rest_n + reading if state.rest_count else reading
        state.rest_count += 1
        if rested_ns < _REST_S * 1e9:
            return state.reading_n
        mean = state.rest_n / state.rest_count
        self.learnt = True
        beyond = np.maximum(state.lowest_n - mean, mean - state.highest_n).max()
        if beyond > _BEYOND_N:
            self.give_up(f"the load changed by {beyond:.1f} N of a cable during the breath")
            return reading
        state.offset_n = state.reading_n - mean
        return np.asarray(reading + state.offset_n)
