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

import io
import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from scipy.stats import chi2

from cablesense_base import Array, CableSenseError
from cablesense_base.files import read_bounded_bytes, write_atomically
from cablesense_contact.law import Law
from cablesense_contact.slides import Belief, CableSlides, Slides
from cablesense_sim.arm import Arm
from cablesense_sim.build import mechanism_of
from cablesense_sim.replay import mean_variance_n2, reading_variance_n2
from cablesense_sim.tolerances import ArmParameters

FORMAT = "cablesense-calibration/2"
MAX_FILE_BYTES = 64 * 1024 * 1024
REFUSED_BELOW = 1e-6
"""Probability, by the innovation's χ², below which an unloaded reading is refused: it is not one
of this arm without a load."""
DOUBTED_BELOW = 1e-4
"""The same of all innovations together, below which the tolerances are doubted."""
_ITERATIONS = 15
_CONVERGED_N = 1e-4
"""The fit ends where a step changes no reading by more."""
_DETERMINED = 0.5
"""A parameter is determined if its deviation is below this share of its tolerance."""
_MODEL_STD_N = 0.01
"""What a reading differs from the law by for other reasons than its noise: rounding of the last
digits, temperature, small vibrations."""


_SLACK_BELOW_STD = 4.0
"""An unloaded reading below this many deviations of a sensor's zero may be of a slack cable."""
_SLACK_STD_N = 1e3
"""Deviation of such a reading: it counts nothing."""


class CalibrationError(CableSenseError):
    """A reading or a file that no calibration can be made from: says what and what would do."""


@dataclass(frozen=True)
class Unloaded:
    """The mean of some readings of the untouched arm at one command.

    Attributes:
        reading_n: (M,) their mean.
        command_rad: (2N,).
        count: how many readings.
        taken_ns: time of the last one since the epoch.
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
        chi2: the least sum of squares of the fit.
        made_from: where the prior comes from, as a sentence.
    """

    arm_identity: str
    mean: Array
    covariance: Array
    prior_mean: Array
    prior_covariance: Array
    unloaded: tuple[Unloaded, ...] = ()
    chi2: float = 0.0
    made_from: str = "the tolerances of the arm file"

    @property
    def misfit_probability(self) -> float:
        """Probability of residuals this large if the arm is as its tolerances say."""
        channels = sum(len(one.reading_n) for one in self.unloaded)
        return float(chi2.sf(self.chi2, channels)) if channels else 1.0

    @property
    def as_described(self) -> bool:
        """Whether the unloaded readings are those of an arm within the tolerances of its file."""
        return self.misfit_probability >= DOUBTED_BELOW

    @property
    def changed_ns(self) -> int:
        """Time of the last unloaded reading since the epoch; 0 without any."""
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
        slopes: (K, M, P) of the readings by what lasts: without what friction carries, and by the
            coefficient of what it carries in each pose.
    """

    about: Array
    mean: Array
    covariance: Array
    cost: float
    chi2: float
    slopes: Array


class Calibrator:
    """Makes calibrations of one arm from unloaded readings.

    Attributes:
        parameters: the arm's uncertain parameters.
    """

    def __init__(self, arm: Arm, law: Law) -> None:
        self.parameters = parameters_of(arm)
        self._arm = arm
        self._law = law
        self._slides = CableSlides(mechanism_of(arm), self.parameters)
        self._carried = self.parameters.carried_friction
        self._is_carried = np.zeros(len(self.parameters), dtype=bool)
        self._is_carried[self._carried] = True
        self._zeros = self.parameters.slices["sensor_zero"]
        sensor_n = np.hypot(arm.tolerances.sensor_zero_n, reading_variance_n2(arm.sensors) ** 0.5)
        self._slack_below_n = _SLACK_BELOW_STD * float(sensor_n)
        self._unrest = np.zeros((arm.joint_count, arm.joint_count))

    def by_tolerances(self) -> Calibration:
        """What the arm file alone says."""
        mean = self.parameters.prior_mean
        covariance = np.diag(self.parameters.prior_std**2)
        return Calibration(self._arm.identity, mean, covariance, mean, covariance)

    def moved(self, calibration: Calibration) -> Calibration:
        """The calibration after the arm has moved: the slides of its cables are unknown again."""
        known = Belief(calibration.mean, calibration.covariance)
        there = self._slides.carried(known, self._slides.unknown)
        return replace(calibration, mean=there.mean, covariance=there.covariance)

    def aged(self, calibration: Calibration, now_ns: int) -> Calibration:
        """The calibration at a time: zeros drift from the last unloaded reading on."""
        if not calibration.changed_ns or now_ns <= calibration.changed_ns:
            return calibration
        drift_n = self._drift_n(calibration.changed_ns, now_ns)
        covariance = calibration.covariance.copy()
        zeros = np.arange(self._zeros.start, self._zeros.stop)
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
        self._require_unloaded(misfit, len(unloaded.reading_n), force=force)
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
        known = calibration.std < _DETERMINED * prior
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
            return replace(calibration, mean=prior, covariance=covariance, chi2=0.0)
        now_ns = calibration.changed_ns
        # what was known before the last reading is near
        start = np.where(self._is_carried, prior, calibration.mean)
        step = np.zeros(len(prior))
        best: _Fit | None = None
        converged = False
        for _ in range(_ITERATIONS):
            fit = self._fit_about(start + step, calibration, now_ns)
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
        return replace(calibration, mean=mean, covariance=best.covariance, chi2=best.chi2)

    def _fit_about(self, about: Array, calibration: Calibration, now_ns: int) -> _Fit:
        """The update by all unloaded readings in turn, linear about one and the same mean."""
        prior = calibration.prior_mean
        covariance = calibration.prior_covariance
        unloaded = calibration.unloaded
        there = [
            self._slides.carried(Belief(about, covariance), self._slides_of(one))
            for one in unloaded
        ]
        slopes, innovations = self._linear(there, unloaded)
        off = np.where(self._is_carried, 0.0, about - prior)
        known = (np.diagonal(covariance) > 0.0) & ~self._is_carried
        cost = float(off[known] @ np.linalg.solve(covariance[np.ix_(known, known)], off[known]))
        mean = prior
        misfit = 0.0
        for one, here, slope, seen in zip(unloaded, there, slopes, innovations, strict=True):
            slides = self._slides_of(one)
            mean, covariance = self._slides.carried(Belief(mean, covariance), slides)
            noise = self._noise_n2(one, now_ns)
            of_slides = self._slides.alone(here, slides)
            by_slide = slope[:, self._carried]
            slid = (by_slide * of_slides) @ by_slide.T + noise
            cost += float(seen @ np.linalg.solve(slid, seen))
            innovation = seen + slope @ (here.mean - mean)
            spread = slope @ covariance @ slope.T + noise
            gain = np.linalg.solve(spread, slope @ covariance).T
            misfit += float(innovation @ np.linalg.solve(spread, innovation))
            mean = mean + gain @ innovation
            left = np.eye(len(prior)) - gain @ slope
            covariance = left @ covariance @ left.T + (gain @ noise) @ gain.T
        covariance = 0.5 * (covariance + covariance.T)
        lasting = np.array(
            [
                self._slides.by_lasting(slope, self._slides_of(one))
                for slope, one in zip(slopes, unloaded, strict=True)
            ]
        )
        return _Fit(about, mean, covariance, cost, misfit, lasting)

    def _slides_of(self, unloaded: Unloaded) -> Slides:
        """What is known of the cables' slides at an unloaded reading."""
        if unloaded.came_from_rad is None:
            return self._slides.unknown
        return self._slides.after_motion(unloaded.came_from_rad, unloaded.command_rad)

    def _linear(
        self, beliefs: Sequence[Belief], unloaded: Sequence[Unloaded]
    ) -> tuple[Array, Array]:
        """Slopes (K, M, P) of unloaded readings by the parameters, and innovations (K, M).

        Each reading has a belief of its own; those with the same mean are asked together.
        """
        slopes = np.empty((len(unloaded), self._arm.cable_count, len(self.parameters)))
        innovations = np.empty(slopes.shape[:2])
        means = np.array([belief.mean for belief in beliefs])
        _, first, alike = np.unique(means, axis=0, return_index=True, return_inverse=True)
        for number, one in enumerate(first):
            rows = np.flatnonzero(alike.ravel() == number).tolist()
            seen = self._law(
                np.array([unloaded[row].reading_n for row in rows]),
                np.array([unloaded[row].command_rad for row in rows]),
                beliefs[one].mean,
                beliefs[one].covariance,
                self._unrest,
            )
            slopes[rows] = seen.by_parameter
            innovations[rows] = seen.innovation_n
        return slopes, innovations

    def _noise_n2(self, unloaded: Unloaded, now_ns: int) -> Array:
        """Covariance (M, M) of the channels' means against the law and the zeros of now.

        A cable that is nearly slack says nothing: on which side of the kink it is depends on its
        own unknown zero.
        """
        drift_n = self._drift_n(unloaded.taken_ns, now_ns)
        noise = mean_variance_n2(self._arm.sensors, unloaded.count)
        slack = unloaded.reading_n < self._slack_below_n
        return np.diag(noise + _MODEL_STD_N**2 + drift_n**2 + slack * _SLACK_STD_N**2)

    def _drift_n(self, from_ns: int, to_ns: int) -> float:
        if not from_ns:
            return 0.0
        return self._arm.tolerances.drift_n_per_hour * abs(to_ns - from_ns) / 3.6e12

    def _require_unloaded(self, misfit: float, count: int, *, force: bool) -> None:
        if float(chi2.sf(misfit, count)) < REFUSED_BELOW and not force:
            raise CalibrationError(
                f"these readings are not those of the untouched arm: χ² {misfit:.0f} of "
                f"{count} channels, where {chi2.isf(REFUSED_BELOW, count):.0f} would do; is it "
                "touched, somewhere else than commanded, or not the arm of the file? Larger "
                "tolerances in the arm file, or force, accept them"
            )


def parameters_of(arm: Arm) -> ArmParameters:
    """The uncertain parameters of an arm, by its file."""
    listed = [e for e in arm.effects if e.effect == "capstan_friction"]
    friction = float(listed[0].parameters.get("coefficient", 0.0)) if listed else 0.0
    return ArmParameters(mechanism_of(arm), arm.tolerances, friction)


def write_calibration(
    path: str | Path, calibration: Calibration, described: Arm | None = None
) -> None:
    """Write a calibration file, with the arm's description where it is given.

    Raises:
        CalibrationError: it cannot be written.
    """
    write_atomically(path, calibration_bytes(calibration, described), CalibrationError)


def calibration_bytes(calibration: Calibration, described: Arm | None = None) -> bytes:
    """The content of a calibration file: a NumPy archive with a JSON header.

    With the arm's description it can be shown without the arm file (`described_arm`).
    """
    header: dict[str, object] = {
        "format": FORMAT,
        "arm": calibration.arm_identity,
        "made_from": calibration.made_from,
        "chi2": calibration.chi2,
    }
    if described is not None:
        header["described"] = described.model_dump(mode="json")
    unloaded = calibration.unloaded
    content = io.BytesIO()
    np.savez_compressed(
        content,
        header=np.frombuffer(json.dumps(header).encode(), dtype=np.uint8),
        mean=calibration.mean,
        covariance=_upper(calibration.covariance),
        prior_mean=calibration.prior_mean,
        prior_covariance=_upper(calibration.prior_covariance),
        readings_n=np.array([one.reading_n for one in unloaded]),
        commands_rad=np.array([one.command_rad for one in unloaded]),
        counts=np.array([one.count for one in unloaded], dtype=np.int64),
        taken_ns=np.array([one.taken_ns for one in unloaded], dtype=np.int64),
        came_from_rad=np.array([_came_from(one) for one in unloaded]),
    )
    return content.getvalue()


def _came_from(unloaded: Unloaded) -> Array:
    """(2N,) where the arm came from, as a file holds it: its own command where unknown."""
    came_from_rad = unloaded.came_from_rad
    return unloaded.command_rad if came_from_rad is None else came_from_rad


def read_calibration(path: str | Path, arm: Arm) -> Calibration:
    """Read the calibration of an arm.

    Raises:
        CalibrationError: no calibration file, or one of another arm.
    """
    content = read_bounded_bytes(path, MAX_FILE_BYTES, "a calibration file", CalibrationError)
    return calibration_of(content, arm, str(path))


def calibration_of(content: bytes, arm: Arm, source: str) -> Calibration:
    """The calibration of an arm in the content of a file, which `source` names in errors.

    Raises:
        CalibrationError: no calibration, or one of another arm.
    """
    header, parts = _opened(content, source)
    try:
        calibration = Calibration(
            arm_identity=str(header["arm"]),
            mean=_real(parts["mean"]),
            covariance=_whole(_real(parts["covariance"])),
            prior_mean=_real(parts["prior_mean"]),
            prior_covariance=_whole(_real(parts["prior_covariance"])),
            unloaded=tuple(
                Unloaded(
                    reading,
                    command,
                    int(count),
                    int(taken),
                    None if np.array_equal(came_from, command) else came_from,
                )
                for reading, command, count, taken, came_from in zip(
                    _real(parts["readings_n"]),
                    _real(parts["commands_rad"]),
                    parts["counts"],
                    parts["taken_ns"],
                    _real(parts["came_from_rad"]),
                    strict=True,
                )
            ),
            chi2=float(header["chi2"]),
            made_from=str(header["made_from"]),
        )
    except Exception as error:  # NumPy raises whatever the broken place led to
        raise _no_calibration(source) from error
    _require_fitting(calibration, arm, source)
    return calibration


def described_arm(content: bytes, source: str) -> Arm:
    """The arm whose calibration this content of a file is, by the description in it.

    Raises:
        CalibrationError: no calibration, or one without a description.
    """
    header, _ = _opened(content, source)
    if "described" not in header:
        raise CalibrationError(
            f"{source}: holds no description of its arm, {str(header.get('arm'))[:80]}; one that "
            "`cablesense calibrate` or a commissioning has written does"
        )
    try:
        return Arm.model_validate(header["described"])
    except ValueError as error:
        raise CalibrationError(
            f"{source}: the description of its arm cannot be true, so it was changed, or made by "
            "another version; calibrate again"
        ) from error


def is_calibration(content: bytes) -> bool:
    """Whether this content of a file is meant to be a calibration."""
    try:
        with np.load(io.BytesIO(content), allow_pickle=False) as archive:
            return "prior_covariance" in archive.files
    except Exception:  # of NumPy and zip, whatever the content led to
        return False


def _opened(content: bytes, source: str) -> tuple[dict[str, Any], dict[str, Any]]:
    """The header, and the arrays by name."""
    try:
        with np.load(io.BytesIO(content), allow_pickle=False) as archive:
            parts = {name: archive[name] for name in archive.files}
        header = json.loads(bytes(parts.pop("header")))
        form = str(header["format"])
    except Exception as error:  # NumPy and zip raise whatever the broken place led to
        raise _no_calibration(source) from error
    if form != FORMAT:
        raise CalibrationError(f"{source}: format {form!r}; this version reads {FORMAT!r}")
    return header, parts


def _no_calibration(source: str) -> CalibrationError:
    return CalibrationError(
        f"{source}: no calibration file; `cablesense calibrate` and a commissioning make one"
    )


def _require_fitting(calibration: Calibration, arm: Arm, path: str) -> None:
    if calibration.arm_identity != arm.identity:
        raise CalibrationError(
            f"{path}: is of arm {calibration.arm_identity[:80]}, not of {arm.identity}; calibrate "
            "this arm, or give the file that it was made with"
        )
    count = len(parameters_of(arm))
    sizes = {len(calibration.mean), len(calibration.prior_mean)}
    sizes |= {len(calibration.covariance), len(calibration.prior_covariance)}
    if sizes != {count}:
        raise CalibrationError(
            f"{path}: has {len(calibration.mean)} parameters; {arm.identity} has {count}: it was "
            "made by another version, so calibrate again"
        )
    numbers = [calibration.mean, calibration.covariance, calibration.prior_mean]
    numbers += [calibration.prior_covariance, np.array([calibration.chi2])]
    for one in calibration.unloaded:
        shapes = one.reading_n.shape, one.command_rad.shape
        if shapes != ((arm.cable_count,), (arm.joint_count,)):
            raise CalibrationError(f"{path}: holds a reading of another arm; calibrate again")
        numbers += [one.reading_n, one.command_rad]
    if not all(np.isfinite(each).all() for each in numbers):
        raise CalibrationError(f"{path}: contains a number that is not finite; calibrate again")
    variances = np.diagonal(calibration.covariance), np.diagonal(calibration.prior_covariance)
    if min(each.min() for each in variances) < 0.0:
        raise CalibrationError(f"{path}: contains a negative variance; calibrate again")


def _real(numbers: Any) -> Array:
    """An array of real numbers; of others NumPy raises an error."""
    return np.asarray(numbers).astype(float, casting="same_kind")


def _upper(symmetric: Array) -> Array:
    """The upper triangle of a (P, P) matrix, row by row."""
    return symmetric[np.triu_indices(len(symmetric))]


def _whole(upper: Array) -> Array:
    """The symmetric matrix (P, P) of an upper triangle."""
    count = int(np.sqrt(2 * len(upper)))
    matrix = np.zeros((count, count))
    matrix[np.triu_indices(count)] = upper
    return matrix + np.triu(matrix, 1).T
