"""A calibration: how well an arm is known, as mean and covariance of its uncertain parameters.

At first these are the tolerances of the arm file. Every unloaded reading is a Kalman update of
them: a tare is that update in one pose, a commissioning in many. Tensions are not linear in the
parameters, so all unloaded readings are kept and fitted together, by Gauss-Newton steps from the
prior (Bell and Cathey, The iterated Kalman filter update as a Gauss-Newton method, IEEE Trans.
Automatic Control 38, 1993). With prior mean m and covariance Σ, and readings y_k of variance R_k,

    θ = argmin (θ - m)' Σ⁻¹ (θ - m) + Σ_k (y_k - h_k(θ))' R_k⁻¹ (y_k - h_k(θ)),

and the least value follows a chi-square distribution, one degree of freedom for each channel of
each reading, if the arm is one that the file describes: a test of the tolerances themselves.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from cablesense_base import Array, CableSenseError
from cablesense_contact.chi_squared import limit_at, probability_above
from cablesense_contact.felt import FeltMachine, torque_covariance_at_rest
from cablesense_contact.law import Law
from cablesense_contact.slides import Belief, Slides
from cablesense_sim.parameter_groups import GroupedParameters

TOLERANCES_DOUBTED_BELOW = 1e-4
"""Probability, by the χ² of all innovations together, below which the tolerances are doubted."""
REFUSED_BELOW = 1e-6
"""Probability, by the χ² of one more reading's innovation, below which that reading is refused.

It is below `TOLERANCES_DOUBTED_BELOW`, as more is lost: a refused reading leaves an arm without a
tare, or ends its commissioning, while a doubted calibration is used and says so.
"""
_ITERATIONS = 15
"""Of the fit: one that needs more does not converge."""
_CONVERGED_N = 1e-4
"""The fit ends where a step changes no reading by more."""
DETERMINED_SHARE = 0.5
"""A parameter is determined if its deviation is below this share of its tolerance."""
MODEL_STD_N = 0.01
"""What a reading differs from the law by for other reasons than its noise: rounding of the last
digits, temperature, small vibrations."""
_SLACK_STD_N = 1e3
"""Deviation, N, that the fit gives to the reading of a cable that is nearly slack: it then counts
for nothing."""


class CalibrationError(CableSenseError):
    """A reading or a file that no calibration can be made from: says what and what would do."""


@dataclass(frozen=True)
class Unloaded:
    """The mean of some readings of the untouched arm at one command.

    Attributes:
        reading_n: (M,) their mean, in the channels' units: N, of joints' torques N·m.
        command_rad: (2N,); of a machine (C,), rad or m as of `FeltMachine.command_names`.
        count: how many readings.
        taken_ns: time of the last one, ns since the epoch; 0 where it is not known, as of a
            recording without a date: its sensors then count as not drifted since.
        came_from_rad: (2N,) another command from which the unloaded arm came straight to this one,
            so that it is known in which direction its cables slid; None where that is not known.
    """

    reading_n: Array
    command_rad: Array
    count: int
    taken_ns: int = 0
    came_from_rad: Array | None = None


@dataclass(frozen=True)
class Calibration:
    """What is known of an arm's P parameters.

    Attributes:
        arm_identity: of the arm whose parameters these are.
        mean: (P,) deviations from the arm file, in the order of `ArmParameters`, and
        covariance: (P, P) of them, as prior and unloaded readings say.
        prior_mean, prior_covariance: what was known before the unloaded readings.
        unloaded: the readings, in the order in which they were taken.
        chi2: the least sum of squares of the fit, and
        compared: how many numbers of the readings were compared.
        made_from: what it was made from, as words that may follow "from": the unloaded readings of
            whoever took them, `a commissioning in 25 poses`; without such readings where the prior
            comes from. A tare adds a reading and leaves these words.
    """

    arm_identity: str
    mean: Array
    covariance: Array
    prior_mean: Array
    prior_covariance: Array
    unloaded: tuple[Unloaded, ...] = ()
    chi2: float = 0.0
    compared: int = 0
    made_from: str = "the tolerances of its file"

    @property
    def misfit_probability(self) -> float:
        """Probability of residuals this large if the arm is as its tolerances say."""
        return probability_above(self.chi2, self.compared) if self.compared else 1.0

    @property
    def as_described(self) -> bool:
        """Whether the unloaded readings are those of an arm within the tolerances of its file."""
        return self.misfit_probability >= TOLERANCES_DOUBTED_BELOW

    def rests_on(self, parameters: GroupedParameters) -> bool:
        """Whether its prior is the tolerances of these parameters.

        So is that of a diagnosis, which no file states.
        """
        std = np.sqrt(np.diagonal(self.prior_covariance))
        is_of_a_diagnosis = np.count_nonzero(self.prior_covariance) > np.count_nonzero(std)
        same = np.allclose(std, parameters.prior_std) and np.allclose(
            self.prior_mean, parameters.prior_mean
        )
        return bool(is_of_a_diagnosis or same)

    @property
    def last_unloaded_ns(self) -> int:
        """Time of the last unloaded reading, ns since the epoch.

        It is 0 without readings, and where their times are not known.
        """
        return max((one.taken_ns for one in self.unloaded), default=0)

    @property
    def std(self) -> Array:
        """(P,) deviations."""
        return np.sqrt(np.diagonal(self.covariance))


class _Fit(NamedTuple):
    """One update of a calibration, linear about a mean.

    Attributes:
        about: (P,) where it is linear.
        mean, covariance: (P,) and (P, P) after the update.
        cost: the sum of squares at `about`.
        chi2: that of the normalised innovations.
        slopes: (K, D, P) of the readings by what lasts: without what friction carries, and by the
            coefficient of what it carries in each pose.
    """

    about: Array
    mean: Array
    covariance: Array
    cost: float
    chi2: float
    slopes: Array


class Calibrator:
    """Makes calibrations of one machine from unloaded readings.

    Attributes:
        parameters: what is uncertain about the machine.
    """

    def __init__(self, machine: FeltMachine, law: Law) -> None:
        self.parameters = machine.parameters
        self._machine = machine
        self._law = law
        self._slides = machine.slides
        self._carried = machine.carried_friction
        self._is_carried = np.zeros(len(self.parameters), dtype=bool)
        self._is_carried[self._carried] = True
        self._covariance_at_rest = torque_covariance_at_rest(machine)

    def by_tolerances(self) -> Calibration:
        """What the arm file alone says."""
        mean = self.parameters.prior_mean
        covariance = np.diag(self.parameters.prior_std**2)
        return Calibration(self._machine.identity, mean, covariance, mean, covariance)

    def moved(self, calibration: Calibration) -> Calibration:
        """The calibration after the arm has moved: the slides of its cables are unknown again."""
        known = Belief(calibration.mean, calibration.covariance)
        there = self._slides.carried(known, self._slides.unknown)
        return replace(calibration, mean=there.mean, covariance=there.covariance)

    def aged(self, calibration: Calibration, now_ns: int) -> Calibration:
        """The calibration at a time: zeros drift from the last unloaded reading on."""
        if not calibration.last_unloaded_ns or now_ns <= calibration.last_unloaded_ns:
            return calibration
        drift_n = self._drift_n(calibration.last_unloaded_ns, now_ns)
        covariance = calibration.covariance.copy()
        zeros = self._machine.zeros
        covariance[zeros, zeros] += drift_n**2
        return replace(calibration, covariance=covariance)

    def updated(
        self, calibration: Calibration, unloaded: Unloaded, *, force: bool = False
    ) -> Calibration:
        """The calibration with one more unloaded reading.

        Raises:
            CalibrationError: the reading is not one of this arm without a load, and not forced.
        """
        fitted = self._fitted(replace(calibration, unloaded=(*calibration.unloaded, unloaded)))
        # the innovation's χ² is by how much the least sum of squares grows
        misfit = fitted.chi2 - calibration.chi2
        compared = fitted.compared - calibration.compared
        if probability_above(misfit, compared) < REFUSED_BELOW and not force:
            raise CalibrationError(
                f"these readings are not those of the untouched arm: χ² {misfit:.0f} of "
                f"{compared} numbers, where {limit_at(REFUSED_BELOW, compared):.0f} would do"
                f"{self._farthest(calibration, unloaded)}; is it touched, somewhere else than "
                "commanded, or not the arm of the file? Larger tolerances in the arm file, or "
                "force, accept them"
            )
        return fitted

    def without_last(self, calibration: Calibration) -> Calibration:
        """The calibration before its last unloaded reading."""
        return self._fitted(replace(calibration, unloaded=calibration.unloaded[:-1]))

    def from_poses(self, unloaded: Sequence[Unloaded]) -> Calibration:
        """The calibration by the tolerances and unloaded readings in several poses."""
        at_once = self._fitted(replace(self.by_tolerances(), unloaded=tuple(unloaded)))
        if at_once.as_described:
            return at_once
        # tensions of stiff cables are far from linear: reading by reading each fit begins nearby
        grown = self.by_tolerances()
        for one in unloaded:
            grown = self._fitted(replace(grown, unloaded=(*grown.unloaded, one)))
        return min(at_once, grown, key=lambda calibration: calibration.chi2)

    def determined(self, calibration: Calibration) -> list[str]:
        """Names of the parameters that readings have determined."""
        prior = self.parameters.prior_std
        known = calibration.std < DETERMINED_SHARE * prior
        return [name for name, yes in zip(self.parameters.names, known, strict=True) if yes]

    def _fitted(self, calibration: Calibration) -> Calibration:
        """The mean and covariance by the prior and all unloaded readings.

        What friction carries is another thing in each pose: of it, readings tell the coefficient.
        What it carries in the last pose is still there.
        """
        prior = calibration.prior_mean
        covariance = calibration.prior_covariance
        unloaded = calibration.unloaded
        if not unloaded:
            return replace(calibration, mean=prior, covariance=covariance, chi2=0.0, compared=0)
        slides = [self._slides_of(one) for one in unloaded]
        now_ns = calibration.last_unloaded_ns
        # what was known before the last reading is near
        start = np.where(self._is_carried, prior, calibration.mean)
        step = np.zeros(len(prior))
        best: _Fit | None = None
        converged = False
        for _ in range(_ITERATIONS):
            fit = self._fit_about(start + step, calibration, slides, now_ns)
            if best is not None and fit.cost > best.cost:
                # across the kink of a slack cable a step may lead too far
                step = 0.5 * step
                continue
            best = fit
            start = fit.about
            step = np.where(self._is_carried, 0.0, fit.mean - fit.about)
            converged = np.abs(fit.slopes @ step).max() < _CONVERGED_N
            if converged:
                break
        assert best is not None
        mean = best.mean if converged else np.where(self._is_carried, best.mean, best.about)
        return replace(
            calibration,
            mean=mean,
            covariance=best.covariance,
            chi2=best.chi2,
            compared=best.slopes.shape[0] * best.slopes.shape[1],
        )

    def _fit_about(
        self, about: Array, calibration: Calibration, slides: Sequence[Slides], now_ns: int
    ) -> _Fit:
        """The update by all unloaded readings in turn, linear about one and the same mean.

        Of the parameters, λ lasts from pose to pose, the coefficient μ of friction among it. What
        friction carries, ε = u μ, is another in each pose, by its slides u. Reading k is linear
        about λ = `about` and ε = E[u_k] μ, with slopes H_λ and H_ε:

            y_k = h_k + H_λ δλ + H_ε δε + noise of covariance R_k

        So ε stands in four places:

        1. before reading k, mean and covariance have the ε of its slides (`slides.carried`);
        2. the prior's part of the cost is of λ alone (`_is_carried`), as ε has no prior;
        3. in the cost of reading k, ε is off by the slides alone: with the residual r_k at
           `about`, r_k' (H_ε var(u_k) E[μ²] H_ε' + R_k)⁻¹ r_k (`slides.alone`);
        4. slopes by what lasts have it in that of the coefficient,
           dy_k/dμ = H_μ + H_ε E[u_k] (`slides.by_lasting`).
        """
        prior = calibration.prior_mean
        covariance = calibration.prior_covariance
        unloaded = calibration.unloaded
        beliefs = [self._slides.carried(Belief(about, covariance), slide) for slide in slides]
        slopes, innovations = self._linear(beliefs, unloaded)
        off = np.where(self._is_carried, 0.0, about - prior)
        known = (np.diagonal(covariance) > 0.0) & ~self._is_carried
        cost = float(off[known] @ np.linalg.solve(covariance[np.ix_(known, known)], off[known]))
        mean = prior
        misfit = 0.0
        lasting = np.empty_like(slopes)
        for number, slope in enumerate(slopes):
            slide = slides[number]
            noise = self._noise_n2(unloaded[number], now_ns)
            lasting[number] = self._slides.by_lasting(slope, slide)
            # the sum of squares at `about`, where what is carried is off by the slides alone
            by_carried = slope[:, self._carried]
            carried_variance = self._slides.alone(beliefs[number], slide)
            spread_about = (by_carried * carried_variance) @ by_carried.T + noise
            residual_n = innovations[number]
            cost += float(residual_n @ np.linalg.solve(spread_about, residual_n))
            # the update by this reading, about the mean so far
            mean, covariance = self._slides.carried(Belief(mean, covariance), slide)
            innovation = residual_n + slope @ (beliefs[number].mean - mean)
            spread = slope @ covariance @ slope.T + noise
            gain = np.linalg.solve(spread, slope @ covariance).T
            misfit += float(innovation @ np.linalg.solve(spread, innovation))
            mean = mean + gain @ innovation
            remaining = np.eye(len(prior)) - gain @ slope
            covariance = remaining @ covariance @ remaining.T + (gain @ noise) @ gain.T
        covariance = 0.5 * (covariance + covariance.T)
        return _Fit(about, mean, covariance, cost, misfit, lasting)

    def _slides_of(self, unloaded: Unloaded) -> Slides:
        """What is known of the cables' slides at an unloaded reading."""
        if unloaded.came_from_rad is None:
            return self._slides.unknown
        return self._slides.after_motion(unloaded.came_from_rad, unloaded.command_rad)

    def _linear(
        self, beliefs: Sequence[Belief], unloaded: Sequence[Unloaded]
    ) -> tuple[Array, Array]:
        """Slopes (K, D, P) of unloaded readings by the parameters, and innovations (K, D).

        Each reading has a belief of its own; those with the same mean are asked together.
        """
        slopes: list[Array] = [np.zeros(0)] * len(unloaded)
        innovations: list[Array] = [np.zeros(0)] * len(unloaded)
        means = np.array([belief.mean for belief in beliefs])
        _, first, alike = np.unique(means, axis=0, return_index=True, return_inverse=True)
        for number, one in enumerate(first):
            rows = np.flatnonzero(alike.ravel() == number).tolist()
            seen = self._law(
                np.array([unloaded[row].reading_n for row in rows]),
                np.array([unloaded[row].command_rad for row in rows]),
                beliefs[one].mean,
                beliefs[one].covariance,
                self._covariance_at_rest,
            )
            for place, row in enumerate(rows):
                slopes[row] = seen.by_parameter[place]
                innovations[row] = seen.innovation_n[place]
        return np.array(slopes), np.array(innovations)

    def _noise_n2(self, unloaded: Unloaded, now_ns: int) -> Array:
        """Covariance (D, D) of the channels' means against the law and the zeros of now.

        A cable that is nearly slack says nothing: on which side of the kink it is depends on its
        own unknown zero.
        """
        drift_n = self._drift_n(unloaded.taken_ns, now_ns)
        noise = self._machine.mean_variance(unloaded.count)
        slack = unloaded.reading_n < self._machine.slack_below
        variance = noise + MODEL_STD_N**2 + drift_n**2 + slack * _SLACK_STD_N**2
        return self._machine.innovation_noise(unloaded.command_rad, variance)

    def _drift_n(self, from_ns: int, to_ns: int) -> float:
        if not from_ns:
            return 0.0
        return self._machine.drift_per_hour * abs(to_ns - from_ns) / 3.6e12

    def _farthest(self, calibration: Calibration, unloaded: Unloaded) -> str:
        """Which channel is farthest from what was expected, as the end of a sentence."""
        channels = self._machine.channels
        believed = Belief(calibration.mean, calibration.covariance)
        innovation = self._linear([believed], [unloaded])[1][0]
        if len(innovation) != len(channels.names):
            return ""
        farthest = int(np.abs(innovation).argmax())
        off = float(innovation[farthest])
        side = "more" if off > 0.0 else "less"
        reading = f"{unloaded.reading_n[farthest]:.3g} {channels.units[farthest]}"
        return (
            f"; {channels.names[farthest]} reads {reading}, about {abs(off):.3g} {side} than "
            "expected at this command"
        )
