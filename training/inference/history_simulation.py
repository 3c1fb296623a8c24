"""An estimator with friction, creep and backlash, from a simulation that runs with the arm.

The arm is simulated from sample to sample under the load that explains the readings. The part of
history in the simulated readings is subtracted from the real ones, and the model file's network,
made for the same arm without history, answers the difference.

A reading may not follow a changed load while a cable sticks. The load is therefore kept while it
explains the readings, and none is assumed if none explains them.
"""

from __future__ import annotations

import copy
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from cablesense_base import Array
from cablesense_sim import kinematics
from cablesense_sim.arm import Arm
from cablesense_sim.build import entries_of, mechanism_of
from cablesense_sim.effects.registry import EffectEntry, actuations, amended, sensings
from cablesense_sim.effects.sensor import SensorDrift, SensorLag
from cablesense_sim.equilibrium import EquilibriumError, held_lengths_m, solve_equilibrium
from cablesense_sim.mechanism import Mechanism
from cablesense_sim.replay import difference_variance_n2
from cablesense_training.inference.estimator import (
    NORMAL_95,
    OUTPUTS,
    Estimate,
    Estimates,
    SequenceEstimator,
)
from cablesense_training.inference.session import COMMAND, TENSION

if TYPE_CHECKING:
    from cablesense_training.data.sequences import Sequences

_TICK_S = 0.05
"""Samples that come sooner than this after a simulated one are answered with its history."""
_OFF = 3.5
"""Another load is sought if the squared misfit exceeds that of noise, or that of the best earlier
load, by this many standard deviations: once in 500 samples by noise alone, with twelve cables."""
_RELEASED, _HIDDEN = 12.0, 4.0
"""A load is kept if it lowers the squared misfit by this much, times the unexplained part: chance
does so once in 400 samples. A change of the load shows with 95 % if it raises it by this much."""
_WIDENED, _LEAST_HIDDEN_N, _MOST_HIDDEN_N = 2, 0.01, 100.0
_PROBE_N = 0.3
"""Step of the numeric derivative by the force."""
_LIKELY_STEP_N = 20.0
"""Prior standard deviation of a force's change from sample to sample."""
_LONGEST_STEP_N, _ENOUGH_N, _MOST_STEPS = 60.0, 0.02, 8
_ABSORBED = 0.1
"""Share of a sample's residual that is expected in the next samples too."""
_SOFTENED = 0.01
"""Least give of sticking parts, as a share of a cable's stretch under pretension. No step towards
a load can be computed from readings that do not change at all before a part slips."""

_EVEN_FROM = 1.75
"""Times both time constants of a lag. Tensions count as changing evenly between samples that are
farther apart: their errors then fade from sample to sample, whatever the lag's second share."""


def remembered(arm: Arm) -> Arm:
    """The arm with those effects that a parallel simulation can follow, without initial states.

    Excluded are effects on loads, which are not the arm's, and drifting sensors, whose drift has
    no known beginning. Initial friction states are those of another run.
    """
    kept = []
    for listed, entry in zip(arm.effects, entries_of(arm), strict=True):
        effect = entry.effect
        if effect.acts_on == "load" or isinstance(effect, SensorDrift):
            continue
        every = (*effect.parameters, *effect.history(arm.segment_count, arm.cable_count))
        past = {parameter.name for parameter in every if parameter.past}
        numbers = {k: value for k, value in listed.parameters.items() if k not in past}
        kept.append(listed.model_copy(update={"parameters": numbers}))
    return arm.model_copy(update={"effects": kept})


def without_history(arm: Arm) -> Arm:
    """The arm with those effects on its rest and readings that do not depend on history."""
    listed = zip(arm.effects, entries_of(arm), strict=True)
    kept = [each for each, entry in listed if not _by_history(entry)]
    return arm.model_copy(update={"effects": kept})


def depends_on_history(arm: Arm) -> bool:
    """Whether an arm lists friction, creep, backlash or a lag of its sensors."""
    return any(_by_history(entry) for entry in entries_of(remembered(arm)))


def _by_history(entry: EffectEntry) -> bool:
    effect = entry.effect
    return effect.acts_on not in ("arm", "sensor") or (
        effect.acts_on == "sensor" and effect.needs_time
    )


class _Copies:
    """Copies of an arm that are simulated from sample to sample, each under its own load."""

    def __init__(self, arm: Arm, count: int) -> None:
        from cablesense_sim.quasi_static import QuasiStaticArm  # compiled: others need not wait

        self._nominal = mechanism_of(arm)
        entries = [_softened(entry, self._nominal) for entry in entries_of(arm)]
        variants = [entries] * count
        mechanisms = [amended(self._nominal, entries)] * count
        self._rest = QuasiStaticArm(mechanisms, variants, some_may_fail=True)
        self._actuations, self._sensings = actuations(variants), sensings(variants)
        lags = [e.values for e in entries if isinstance(e.effect, SensorLag)]
        each_s = (v["time_constant_s"] * (1.0 + v["second_share"]) for v in lags)
        self._even_from_s = _EVEN_FROM * max(each_s, default=0.0)
        self._count, self._last_s = count, 0.0

    def readings_n(self, time_s: float, command_rad: Array, forces_n: Array) -> Array:
        """(P, M) at a command (2N,) under forces (P, N, 3); NaN where an arm cannot bear them.

        Tensions change evenly between samples that are far apart for every lag. Otherwise they
        count as changed right after the last sample. Readings then show more of earlier tensions,
        and errors of the loads would grow from sample to sample.
        """
        held = np.repeat(held_lengths_m(self._nominal, command_rad[None]), self._count, axis=0)
        for actuation in self._actuations:
            held = actuation.step(time_s, held)
        tensions = self._rest.step(time_s, held, forces_n)
        at_once = time_s - self._last_s < self._even_from_s
        for sensing in self._sensings:
            if at_once:
                sensing.step(self._last_s, tensions)
            tensions = sensing.step(time_s, tensions)
        self._last_s = time_s
        return tensions

    def branched(self) -> _Copies:
        """Copies that continue from the same state."""
        other = copy.copy(self)
        other._rest = self._rest.branched()
        other._actuations, other._sensings = copy.deepcopy((self._actuations, self._sensings))
        return other


class _Load(NamedTuple):
    """A force on a segment, 0 for none: components (2,) along y and z, and its squared misfit."""

    segment: int
    force_n: Array
    misfit: float = np.inf


_NOTHING = _Load(0, np.zeros(2))


class HistorySimulation:
    """An arm that is simulated along with the real one, and the effect of history on readings."""

    def __init__(self, arm: Arm, tare_samples: int) -> None:
        self._arm = remembered(arm)
        self._mechanism = amended(mechanism_of(arm), entries_of(arm))
        self._predicted_at_rad, self._latest_n = np.zeros(0), np.zeros(0)
        self._noise_n = difference_variance_n2(arm.sensors, tare_samples) ** 0.5
        self.forget()

    def forget(self) -> None:
        """Begin with the next sample, which is one of the unloaded arm."""
        self._arms, self._plain = _Copies(self._arm, 4), _Copies(without_history(self._arm), 1)
        self._hidden_n = np.full((self._arm.segment_count, 4), _PROBE_N)  # ahead, back, aside
        self._asked, self._last_s = 0, -np.inf
        self.tare()

    def tare(self) -> None:
        """The next sample is one of the unloaded arm, with its history."""
        self._bias_n: Array | None = None
        self._load, self._usual = _NOTHING, 0.0
        self._unexplained_n = self._history_n = np.zeros(self._arm.cable_count)

    def unloaded(self, time_s: float, command_rad: Array) -> None:
        """The arm is untouched at a command (2N,); differences are relative to its readings."""
        self.tare()
        none = np.zeros((4, self._arm.segment_count, 3))
        bias = self._arms.readings_n(time_s, command_rad, none)[0]
        plain = self._plain.readings_n(time_s, command_rad, none[:1])[0]
        if not np.isfinite([bias, plain]).all():
            self.forget()
            raise EquilibriumError("the arm with its history has no rest at this command")
        self._bias_n, self._none_n = bias - self._predicted_n(command_rad), bias - plain
        self._last_s = -np.inf

    def without_n(self, difference_n: Array, time_s: float, command_rad: Array) -> Array:
        """The difference (M,) of readings without the effect of history, at a command (2N,).

        Differences are relative to the tare, and follow commands as unloaded tensions do. Where
        time runs back by over a tick, the arm counts as unloaded and without a past.

        Raises:
            EquilibriumError: the arm has no rest there.
        """
        if time_s < self._last_s - _TICK_S:
            self.forget()
        if self._bias_n is None:
            self.unloaded(time_s, command_rad)
        if time_s - self._last_s >= _TICK_S:
            self._follow(difference_n, time_s, command_rad)
        return difference_n - self._history_n

    def _follow(self, difference_n: Array, time_s: float, command_rad: Array) -> None:
        """Simulate up to a sample, under the load that explains it."""
        self._axes = kinematics.segment_rotations(self._mechanism, command_rad)[:, :, 1:]
        assert self._bias_n is not None
        unloaded_n = self._bias_n + self._predicted_n(command_rad)
        self._now = time_s, command_rad, unloaded_n + self._unexplained_n + difference_n
        load = self._explanation()
        self._look_for_hidden(load)
        forces = self._forces_n(load.segment, np.tile(load.force_n, (4, 1)))
        arms, plain = self._arms.branched(), self._plain.branched()
        read = arms.readings_n(time_s, command_rad, forces)[0]
        read_plain = plain.readings_n(time_s, command_rad, forces[:1])[0]
        if np.isfinite([read, read_plain]).all():
            self._arms, self._plain, self._load = arms, plain, load
            self._history_n = read - read_plain - self._none_n
            self._unexplained_n = self._unexplained_n - _ABSORBED * (self._now[2] - read)
        self._last_s = time_s

    def along_n(self, sequences: Sequences) -> tuple[Array, Array]:
        """Differences (S, T, M) without the effect of history, and hidden forces (S, T), N."""
        freed_n = np.empty_like(sequences.tension_difference_n)
        hidden_n = np.empty(freed_n.shape[:2])
        tick_s = sequences.protocol.tick_s
        for number, differences_n in enumerate(sequences.tension_difference_n):
            self.forget()
            before = sequences.before_rad[number]
            for tick, command_rad in enumerate(before, start=-len(before)):
                self.unloaded(tick * tick_s, command_rad)
            self.tare()
            for tick, command_rad in enumerate(sequences.joint_command_rad[number]):
                freed_n[number, tick] = self.without_n(
                    differences_n[tick], tick * tick_s, command_rad
                )
                hidden_n[number, tick] = self.hidden_n[0]
        return freed_n, hidden_n

    @property
    def touched(self) -> bool:
        """Whether the readings of the last sample call for a load."""
        return self._load.segment > 0

    @property
    def hidden_n(self) -> tuple[float, float]:
        """Possible error of the load along it and across it, with 95 %, unseen in readings.

        Without a load: the force that may act unseen on the least sensitive segment, and zero.
        """
        if not self._load.segment:
            return float(self._hidden_n.max()), 0.0
        along, across = self._hidden_n[self._load.segment - 1].reshape(2, 2).max(axis=1)
        return float(along), float(across)

    def _predicted_n(self, command_rad: Array) -> Array:
        """(M,) unloaded tensions at rest at a command, which differences are relative to."""
        if not np.array_equal(command_rad, self._predicted_at_rad):
            held_m = held_lengths_m(mechanism_of(self._arm), command_rad)
            found = solve_equilibrium(self._mechanism, command_rad, held_m=held_m)
            self._predicted_at_rad, self._latest_n = command_rad.copy(), found.tensions_n
        return self._latest_n

    def _explanation(self) -> _Load:
        """No load if that explains the readings, else the previous one, else the likeliest."""
        before = self._load
        tried = self._tried(before)
        none = _NOTHING._replace(misfit=self._misfit(tried[3]))
        count = self._arm.cable_count
        by_noise = count + _OFF * np.sqrt(2.0 * count)
        if none.misfit <= by_noise:
            self._usual = 0.0
            return none
        enough = max(by_noise, self._usual + _OFF * np.sqrt(2.0 * count + 4.0 * self._usual))
        found = before._replace(misfit=self._misfit(tried[0])) if before.segment else none
        if found.misfit > enough and before.segment:
            found = self._fitted(before)
            self._usual = min(self._usual, found.misfit)
        if before.segment and none.misfit - found.misfit <= _RELEASED * max(
            1.0, found.misfit / count
        ):
            return none
        if found.misfit <= enough:
            return found
        segments = set(range(1, self._arm.segment_count + 1)) - {before.segment}
        others = (self._fitted(_Load(segment, np.zeros(2))) for segment in sorted(segments))
        found = min(found, *others, key=lambda load: load.misfit)
        self._usual = found.misfit
        return found

    def _fitted(self, start: _Load) -> _Load:
        """The likeliest force on a segment, by damped Gauss-Newton steps from a start."""
        best, force, damping = start._replace(misfit=np.inf), start.force_n, 0.0
        normal, slope = np.zeros((2, 2)), np.zeros(2)
        for _ in range(_MOST_STEPS):
            tried = self._tried(best._replace(force_n=force))
            moved = (force - start.force_n) / _LIKELY_STEP_N
            misfit = self._misfit(tried[0]) + float(moved @ moved)
            gain = best.misfit - misfit
            if gain > 0.0:
                best, damping = best._replace(force_n=force, misfit=misfit), 0.3 * damping
                jacobian = (tried[1:3] - tried[0]).T / (_PROBE_N * self._noise_n)
                if gain < 0.5 or not np.isfinite(jacobian).all():
                    break
                residual = (self._now[2] - tried[0]) / self._noise_n
                normal = jacobian.T @ jacobian
                slope = jacobian.T @ residual - moved / _LIKELY_STEP_N
            elif not np.isfinite(best.misfit):
                break
            else:
                damping = max(4.0 * damping, 0.1)
            held = _LIKELY_STEP_N**-2.0 + 0.5 * damping * np.trace(normal)
            step = np.linalg.solve(normal + held * np.eye(2), slope)
            length = np.linalg.norm(step)
            if length < _ENOUGH_N:
                break
            force = best.force_n + step * min(1.0, _LONGEST_STEP_N / length)
        return best

    def _tried(self, load: _Load) -> Array:
        """Readings (4, M) of a load, of a little more along y and along z, and of no load."""
        each_n = load.force_n + _PROBE_N * np.array([[0, 0], [1, 0], [0, 1], [0, 0]])
        each_n[3] = 0.0
        return self._read_n(load.segment, each_n)

    def _read_n(self, segment: int, each_n: Array) -> Array:
        """(4, M) readings of the present sample under each of four forces (4, 2) on a segment."""
        time_s, command_rad, _ = self._now
        forces = self._forces_n(segment, each_n)
        return self._arms.branched().readings_n(time_s, command_rad, forces)

    def _look_for_hidden(self, load: _Load) -> None:
        """Adapt the largest changes of a load at which readings are still explained.

        Without a load, one segment after another is examined, sample by sample.
        """
        limit = load.misfit + _HIDDEN * max(1.0, load.misfit / self._arm.cable_count)
        self._asked = load.segment or self._asked % self._arm.segment_count + 1
        along = np.array([1.0, 0.0])
        if load.segment:
            along = load.force_n / max(float(np.linalg.norm(load.force_n)), 1e-9)
        across = np.array([-along[1], along[0]])
        ways = np.array([along, -along, across, -across])
        for _ in range(_WIDENED):
            width_n = self._hidden_n[self._asked - 1]
            read = self._read_n(self._asked, load.force_n + width_n[:, None] * ways)
            unseen = np.array([self._misfit(each) <= limit for each in read])
            self._hidden_n[self._asked - 1] = np.clip(
                np.where(unseen, 2.0, 0.5) * width_n, _LEAST_HIDDEN_N, _MOST_HIDDEN_N
            )

    def _misfit(self, reading_n: Array) -> float:
        off = (self._now[2] - reading_n) / self._noise_n
        return float(off @ off) if np.isfinite(off).all() else np.inf

    def _forces_n(self, segment: int, each_n: Array) -> Array:
        """(4, N, 3) in base axes, of forces (4, 2) along y and z of a segment; 0 is none."""
        forces = np.zeros((4, self._arm.segment_count, 3))
        if segment:
            forces[:, segment - 1] = each_n @ self._axes[segment - 1].T
        return forces


class HistoryEstimator(SequenceEstimator):
    """A memoryless single-contact model that follows a simulation of its arm's history."""

    outputs = OUTPUTS

    def __init__(self, path: str | Path, arm: Arm | None = None) -> None:
        super().__init__(path, arm)
        self._simulation = HistorySimulation(self.metadata.arm, self.metadata.tare_samples)

    def forget(self) -> None:
        """See the base class; the next sample counts as one of the unloaded arm."""
        self._simulation.forget()

    def tare(self) -> None:
        """See the base class; so does this."""
        self._simulation.tare()

    def _answer(self, inputs: dict[str, Array], time_s: float) -> Estimate:
        """See the base class; speeds and accelerations are ignored, as the arm goes by rests.

        A contact is answered if the readings require a load, though its interval may begin at
        zero. Otherwise the interval ends at the force that may act unseen.
        """
        difference_n, command_rad = inputs[TENSION][0], inputs[COMMAND][0]
        freed_n = self._simulation.without_n(difference_n, time_s, command_rad)
        answers = [each[0] for each in self._batch(freed_n, command_rad)]
        left = Estimates.one(answers)
        touched, (along_n, across_n) = self._simulation.touched, self._simulation.hidden_n
        half_n = float(np.hypot(NORMAL_95 * left.magnitude_std_n, along_n))
        middle_n = left.magnitude_n if touched else 0.0
        turned_deg = np.rad2deg(across_n / max(left.magnitude_n, 1e-9)) / NORMAL_95
        return left._replace(
            segment=1 + int(left.probabilities[1:].argmax()) if touched else 0,
            magnitude_std_n=half_n / NORMAL_95,
            angle_std_deg=float(np.hypot(left.angle_std_deg, turned_deg)),
            low_n=max(0.0, middle_n - half_n),
            high_n=middle_n + half_n,
        )


def _softened(entry: EffectEntry, mechanism: Mechanism) -> EffectEntry:
    if "give_m" not in entry.values:
        return entry
    least_m = _SOFTENED * float(np.median(mechanism.pretension_n / mechanism.stiffness_n_m))
    return replace(entry, values={**entry.values, "give_m": max(entry.values["give_m"], least_m)})
