"""A machine and how well it is known, for programs that have readings as arrays.

    arm = KnownMachine.load("my_arm.yaml", "my_arm.onnx")
    arm = arm.tared(untouched_n, command_rad)
    print(arm.touch(reading_n, command_rad))

The estimator node knows more than one reading says: how the machine came to its pose, and what
its readings were before. Here each reading stands for itself, of a machine at rest.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from cablesense_base import Array
from cablesense_contact.calibration import Calibration, Calibrator, Unloaded
from cablesense_contact.calibration_file import read_calibration
from cablesense_contact.errors import ModelFileError
from cablesense_contact.felt import FeltMachine, torque_covariance_at_rest
from cablesense_contact.judgement import ContactState, Judge, Judgement
from cablesense_contact.law import Law, LawOutput
from cablesense_contact.slides import Belief
from cablesense_online.loading import load
from cablesense_online.samples import ReadingLimits, SampleError


@dataclass(frozen=True)
class Touch:
    """What a reading says of the machine. Intervals are of 95 %.

    Place, force and moment are those of the likeliest contact, also where none is stated.

    Attributes:
        state: what is stated.
        link: the frame of the touched link, such as `segment_3`; empty where nothing touches, or
            the reading is implausible.
        place_m: where on the link's axis, from its frame on.
        place_ci95_m: from where to where it may be.
        force_n: (3,) along the axes that the link has at the command.
        magnitude_n: of its part across the link's axis.
        magnitude_ci95_n: from how little to how much that may be.
        moment_n_m: (2,) about the frame, around its y and z: what is known in state `MOMENT`.
        doubt: what else would explain the reading; empty without doubt.
    """

    state: ContactState
    link: str
    place_m: float
    place_ci95_m: tuple[float, float]
    force_n: Array
    magnitude_n: float
    magnitude_ci95_n: tuple[float, float]
    moment_n_m: Array
    doubt: str

    @property
    def angle_deg(self) -> float:
        """Direction of the force across the axis: 0 along the link's z, 90 along its y."""
        return math.degrees(math.atan2(self.force_n[1], self.force_n[2])) % 360.0

    def __str__(self) -> str:
        stated = self.state.value
        if self.state is ContactState.MOMENT:
            moment_n_m = math.hypot(*self.moment_n_m)
            stated += f" on {self.link}: {moment_n_m:.3f} N·m about its joint"
        elif self.link:
            place_mm = " to ".join(f"{1e3 * place_m:.0f}" for place_m in self.place_ci95_m)
            force_n = " to ".join(f"{size_n:.2f}" for size_n in self.magnitude_ci95_n)
            stated += f" on {self.link}, {place_mm} mm from its joint: {force_n} N"
        return f"{stated} ({self.doubt})" if self.doubt else stated


@dataclass(frozen=True)
class KnownMachine:
    """An arm, or any machine of MuJoCo, that is known as well as a calibration says.

    Attributes:
        machine: the machine.
        law: what its model file answers.
        calibration: how well it is known.
    """

    machine: FeltMachine
    law: Law
    calibration: Calibration

    @classmethod
    def load(
        cls, machine: str | Path, model: str | Path = "", calibration: str | Path = ""
    ) -> KnownMachine:
        """One of files, or of a bundled arm.

        Args:
            machine: an arm file, a machine file, or the name of a bundled arm.
            model: made of it by `cablesense export`; by default the bundled one.
            calibration: made by `cablesense calibrate`; by default the tolerances of the file.

        Raises:
            CableSenseError: a file is missing or invalid, or of another machine.
            ModelFileError: the model is a network of the paper.
        """
        loaded = load(str(machine), str(model))
        if loaded.law is None:
            raise ModelFileError(
                f"{loaded.path}: a network takes no calibration; make a model with "
                "`cablesense export`"
            )
        calibrator = Calibrator(loaded.machine, loaded.law)
        known = calibrator.by_tolerances()
        if calibration:
            known = read_calibration(str(calibration), loaded.machine)
        return cls(loaded.machine, loaded.law, known)

    def tared(self, untouched: Array, command: Array) -> KnownMachine:
        """The machine as it is known after readings that nothing touched.

        Args:
            untouched: (K, M) readings at rest in one pose, or (M,) the only one.
            command: (C,) joint angles, rad, or what else the machine's commands are.

        Raises:
            CalibrationError: they are not readings of this machine when nothing touches it.
        """
        readings = np.atleast_2d(untouched)
        unloaded = Unloaded(readings.mean(axis=0), command, count=len(readings))
        calibrator = Calibrator(self.machine, self.law)
        return replace(self, calibration=calibrator.updated(self.calibration, unloaded))

    def touch(self, reading: Array, command: Array) -> Touch:
        """What a reading (M,) at a command (C,) says.

        Raises:
            SampleError: as `touches`.
        """
        return self.touches(np.asarray(reading)[np.newaxis], np.asarray(command)[np.newaxis])[0]

    def touches(self, readings: Array, commands: Array) -> Sequence[Touch]:
        """What readings (B, M) at commands (B, C) say, each for itself.

        Raises:
            SampleError: a reading is not finite, saturated, or one that no such cable gives.
        """
        machine = self.machine
        _require_usable(readings, ReadingLimits(machine.channels))
        by_calibration = Belief(self.calibration.mean, self.calibration.covariance)
        belief = machine.slides.carried(by_calibration, machine.slides.unknown)
        unrest = torque_covariance_at_rest(machine)
        posterior = self.law(readings, commands, belief.mean, belief.covariance, unrest)
        judge = Judge(machine)
        touches = []
        for row, reading in enumerate(readings):
            seen = posterior.row(row)
            touches.append(_touch(seen, judge(seen, reading), machine.link_names))
        return touches


def _require_usable(readings: Array, limits: ReadingLimits) -> None:
    for number, reading in enumerate(readings, start=1):
        try:
            limits.check(reading.tolist())
        except SampleError as problem:
            text = f"reading {number} of {len(readings)}: {problem}"
            raise SampleError(problem.kind, text) from None


def _touch(seen: LawOutput, judgement: Judgement, link_names: Sequence[str]) -> Touch:
    """What is stated of one reading, of which the law's output is a batch of one."""
    is_touched = judgement.state not in (ContactState.FREE, ContactState.IMPLAUSIBLE)
    place_ci95_m = seen.place_ci95_m[0]
    magnitude_ci95_n = seen.magnitude_ci95_n[0]
    force_n = seen.force_n[0]
    return Touch(
        state=judgement.state,
        link=link_names[judgement.segment - 1] if is_touched else "",
        place_m=float(seen.place_m[0]),
        place_ci95_m=(float(place_ci95_m[0]), float(place_ci95_m[1])),
        force_n=force_n,
        magnitude_n=math.hypot(force_n[1], force_n[2]),
        magnitude_ci95_n=(float(magnitude_ci95_n[0]), float(magnitude_ci95_n[1])),
        moment_n_m=seen.moment_n_m[0],
        doubt=judgement.doubt,
    )
