"""The jaw's torque by the amended physics: its transmission diagnosed, and inverted by a filter.

The diagnosis of `cablesense_gap` finds what makes the recorded transmission differ from one that
has no friction. The load is then the state of a Kalman filter: it changes little from sample to
sample, and the drive's torque shows it as far as the transmission lets it through. While the run
at the spindle sticks, the derivative by the load is zero and the filter waits.
"""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from real_jaw_baselines import RADII_RAD, stops
from real_jaw_diagnosis import amended, best_of, diagnose
from real_jaw_mechanism import JawSimulator, Signs, Transmission, beside_cables, problem_of
from real_jaw_recordings import SAMPLE_S, JawRecording, reference

from cablesense_base import Array
from cablesense_gap.diagnosis.gauss_newton import final_refinement, refit
from cablesense_gap.diagnosis.problem import Explanation, Problem
from cablesense_gap.simulator import Term

STRIDE = 5
"""Samples from one answer to the next; it holds in between."""

_LOAD_STEPS_NM = (0.001, 0.003, 0.01)
_STEPS = 8
_BEYOND, _UNLIKE, _NOISE_NM = 1.33, 0.2, 0.001
"""Of simulated recordings: largest load, spread of each number's logarithm, sensor noise."""


class PhysicsEstimator:
    """A transmission that a diagnosis has amended, and a filter for its load.

    Attributes:
        tool: that was diagnosed.
        problem: its recordings beside the simulator, and `ranked` the explanations.
        signs: which way its tool counts.
        values: numbers of the effects and tolerances.
    """

    def __init__(self, recordings: Sequence[JawRecording]) -> None:
        """Diagnose the reference tool; the filter's pace is the best of three on it."""
        own = reference(recordings)
        self.tool = own[0].tool
        self.problem = problem_of(own)
        self.ranked = diagnose(self.problem)
        self._take(self.problem, best_of(self.ranked), own)
        self._load_step_nm = _LOAD_STEPS_NM[0]
        self._load_step_nm = min(_LOAD_STEPS_NM, key=lambda step: self._left(own, step))

    def adapted(self, recordings: Sequence[JawRecording]) -> PhysicsEstimator:
        """The same effects, their numbers fitted to recordings of another tool."""
        other = copy.copy(self)
        problem = problem_of(recordings)
        fitted = refit(problem, self._effects, _STEPS)
        if fitted is not None:
            other._take(problem, final_refinement(problem, fitted)[0], recordings)
        return other

    def torques_nm(self, recordings: Sequence[JawRecording]) -> list[Array]:
        """The jaw's torque (T,) in each recording, from the samples up to then."""
        longest = max(len(r.drive_angle_rad) for r in recordings)
        turned, torque = (
            np.array([np.pad(s, (0, longest - len(s)), "edge")[::STRIDE] for s in signals])
            for signals in (
                [self.signs.drive * r.drive_angle_rad for r in recordings],
                [r.drive_torque_nm for r in recordings],
            )
        )
        load = np.repeat(self.signs.jaw * self._load_nm(turned, torque), STRIDE, axis=1)
        return [told[: len(r.drive_angle_rad)] for told, r in zip(load, recordings, strict=True)]

    def simulated(
        self, recordings: Sequence[JawRecording], count: int, seed: int
    ) -> list[JawRecording]:
        """Recordings of transmissions like this one: other loads, and each number another.

        The drive takes the courses of given recordings. Loads are theirs, scaled to between
        nothing and a third above the largest, and modulated slowly.
        """
        rng = np.random.default_rng(seed)
        length = min(len(r.drive_angle_rad) for r in recordings) // STRIDE
        chosen = [recordings[k] for k in rng.integers(0, len(recordings), count)]
        turned, load = (
            np.array([signal[: length * STRIDE : STRIDE] for signal in signals])
            for signals in (
                [self.signs.drive * r.drive_angle_rad for r in chosen],
                [self.signs.jaw * r.jaw_torque_nm for r in chosen],
            )
        )
        level = rng.uniform(0.0, _BEYOND * np.abs(load).mean(1).max(), (count, 1))
        load *= level / np.abs(load).mean(1, keepdims=True)
        time_s = np.arange(length) * STRIDE * SAMPLE_S
        pace, phase = rng.uniform(0.05, 1.0, (count, 1)), rng.uniform(0.0, 2.0 * np.pi, (count, 1))
        swing = rng.uniform(0.0, 0.3, (count, 1))
        load *= 1.0 + swing * np.sin(2.0 * np.pi * pace * time_s + phase)
        variants = [
            {term: value * rng.lognormal(0.0, _UNLIKE) for term, value in self.values.items()}
            for _ in range(count)
        ]
        transmission = Transmission(variants, turned[:, 0])
        torque = beside_cables(variants, turned)
        for t in range(length):
            torque[:, t] += transmission.rest(turned[:, t], load[:, t])[0]
            transmission.settle()
        weights, ripple = _current(recordings)
        made = []
        for recording, *signals in zip(chosen, torque, load, strict=True):
            now_s = np.arange(length * STRIDE) * SAMPLE_S
            drive_nm, jaw_nm = (np.interp(now_s, time_s, signal) for signal in signals)
            drive_nm += rng.normal(0.0, _NOISE_NM, len(now_s))
            angle = recording.drive_angle_rad[: len(now_s)]
            current = _current_terms(angle, drive_nm) @ weights
            made.append(
                replace(
                    recording,
                    drive_angle_rad=angle,
                    drive_torque_nm=drive_nm,
                    motor_current_a=current + rng.normal(0.0, ripple, len(now_s)),
                    jaw_angle_rad=np.zeros_like(now_s),
                    jaw_torque_nm=self.signs.jaw * jaw_nm,
                )
            )
        return made

    def _load_nm(self, turned_rad: Array, torque_nm: Array) -> Array:
        variants = [self.values] * len(turned_rad)
        torque_nm = torque_nm - beside_cables(variants, turned_rad)
        transmission = Transmission(variants, turned_rad[:, 0])
        load = np.full(len(turned_rad), self._usual_nm)
        variance = np.full(len(turned_rad), self._spread_nm**2)
        loads = np.empty_like(turned_rad)
        for t in range(turned_rad.shape[1]):
            expected, slope = transmission.rest(turned_rad[:, t], load)
            variance = variance + self._load_step_nm**2
            gain = variance * slope / (slope**2 * variance + self._noise_nm**2)
            load = load + gain * (torque_nm[:, t] - expected)
            variance = (1.0 - gain * slope) * variance
            transmission.settle()
            loads[:, t] = load
        return loads

    def _left(self, recordings: Sequence[JawRecording], load_step_nm: float) -> float:
        self._load_step_nm = load_step_nm
        told = self.torques_nm(recordings)
        errors = [t - r.jaw_torque_nm for t, r in zip(told, recordings, strict=True)]
        return float((np.concatenate(errors) ** 2).mean())

    def _take(
        self, problem: Problem, fitted: Explanation, recordings: Sequence[JawRecording]
    ) -> None:
        assert isinstance(problem.simulator, JawSimulator)
        self.signs: Signs = problem.simulator.signs
        self._effects = fitted.values
        self.values: dict[Term, float] = amended(fitted)
        load = self.signs.jaw * np.concatenate([r.jaw_torque_nm for r in recordings])
        self._usual_nm, self._spread_nm = float(load.mean()), float(load.std())
        left = (problem.readings - fitted.prediction)[problem.used]
        self._noise_nm = float(np.sqrt((left**2).mean()))


def _current(recordings: Sequence[JawRecording]) -> tuple[Array, float]:
    """Weights of the motor's current in `_current_terms`, and its ripple beside them."""
    terms = np.vstack([_current_terms(r.drive_angle_rad, r.drive_torque_nm) for r in recordings])
    current = np.concatenate([r.motor_current_a for r in recordings])
    weights = np.linalg.lstsq(terms, current)[0]
    return weights, float((current - terms @ weights).std())


def _current_terms(angle_rad: Array, torque_nm: Array) -> Array:
    direction = stops(angle_rad, RADII_RAD[:1])[:, 0]
    return np.stack([np.ones_like(torque_nm), torque_nm, direction, torque_nm * direction], 1)
