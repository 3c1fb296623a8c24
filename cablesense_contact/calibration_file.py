"""Calibrations as files: a NumPy archive with a JSON header, of one machine."""

from __future__ import annotations

import io
import json
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from cablesense_base import Array
from cablesense_base.files import read_bounded_bytes, write_atomically
from cablesense_contact.calibration import Calibration, CalibrationError, Unloaded
from cablesense_contact.felt import FeltMachine
from cablesense_contact.felt_arm import FeltArm
from cablesense_sim.arm import Arm
from cablesense_sim.parameter_groups import GroupedParameters, ParameterGroup

FORMAT = "cablesense-calibration/2"
MAX_FILE_BYTES = 64 * 1024 * 1024
"""Of a calibration file: more than a thousand times the largest arm's."""


@dataclass(frozen=True)
class CalibratedMachine:
    """The machine of a calibration, as far as its file needs it.

    Attributes:
        identity: of the machine.
        parameters: what is uncertain about it.
        channel_count, command_count: numbers in a reading, and in a command.
    """

    identity: str
    parameters: GroupedParameters
    channel_count: int
    command_count: int

    @classmethod
    def of(cls, machine: FeltMachine) -> CalibratedMachine:
        """Of a machine that is there."""
        return cls(
            machine.identity,
            machine.parameters,
            len(machine.channels.names),
            len(machine.command_names),
        )


def write_calibration(
    path: str | Path, calibration: Calibration, machine: FeltMachine | None = None
) -> None:
    """Write a calibration file, with a description of the machine where that is given.

    Raises:
        CalibrationError: it cannot be written.
    """
    write_atomically(path, calibration_bytes(calibration, machine), CalibrationError)


def calibration_bytes(calibration: Calibration, machine: FeltMachine | None = None) -> bytes:
    """The content of a calibration file: a NumPy archive with a JSON header.

    With the machine's description it can be shown without the machine's file (`described`): an
    arm's whole, of others what their parameters are.
    """
    header: dict[str, object] = {
        "format": FORMAT,
        "arm": calibration.arm_identity,
        "made_from": calibration.made_from,
        "chi2": calibration.chi2,
        "compared": calibration.compared,
    }
    if isinstance(machine, FeltArm):
        header["described"] = machine.arm.model_dump(mode="json")
    elif machine is not None:
        header["machine"] = _as_json(CalibratedMachine.of(machine))
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


def read_calibration(path: str | Path, machine: FeltMachine) -> Calibration:
    """Read the calibration of a machine.

    Raises:
        CalibrationError: no calibration file, or one of another arm.
    """
    content = read_bounded_bytes(path, MAX_FILE_BYTES, "a calibration file", CalibrationError)
    return calibration_of(content, machine, str(path))


def calibration_of(
    content: bytes, machine: FeltMachine | CalibratedMachine, source: str
) -> Calibration:
    """The calibration of a machine in the content of a file, which `source` names in errors.

    Raises:
        CalibrationError: no calibration, or one of another machine.
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
            compared=int(header.get("compared", np.size(parts["readings_n"]))),
            made_from=str(header["made_from"]),
        )
    except Exception as error:  # NumPy raises whatever the broken place led to
        raise _no_calibration(source) from error
    known = machine if isinstance(machine, CalibratedMachine) else CalibratedMachine.of(machine)
    _require_fitting(calibration, known, source)
    return calibration


def prior_notes(
    calibration: Calibration | None, machine: FeltMachine, source: str | Path
) -> tuple[str, ...]:
    """A sentence where a calibration rests on other tolerances than its machine's file states.

    None where none is in use.
    """
    if calibration is None or calibration.rests_on(machine.parameters):
        return ()
    return (
        f"{source}: made with other tolerances than the file of {machine.identity} states now, "
        "and those count; calibrate again to use what the file states",
    )


def described(content: bytes, source: str) -> Arm | CalibratedMachine:
    """The arm or machine whose calibration this content of a file is, by the description in it.

    Raises:
        CalibrationError: no calibration, or one without a description.
    """
    header, _ = _opened(content, source)
    try:
        if "described" in header:
            return Arm.model_validate(header["described"])
        if "machine" in header:
            return _of_json(str(header["arm"]), header["machine"])
    except (ValueError, KeyError, TypeError) as error:
        raise CalibrationError(
            f"{source}: the description of its arm cannot be true, so it was changed, or made by "
            "another version; calibrate again"
        ) from error
    raise CalibrationError(
        f"{source}: holds no description of its arm, {str(header.get('arm'))[:80]}; one that "
        "`cablesense calibrate` or a commissioning has written does"
    )


def _as_json(machine: CalibratedMachine) -> dict[str, object]:
    return {
        "parameters": [asdict(group) for group in machine.parameters.groups],
        "channel_count": machine.channel_count,
        "command_count": machine.command_count,
    }


def _of_json(identity: str, plain: dict[str, Any]) -> CalibratedMachine:
    """Raises: ValueError, KeyError or TypeError where it is not what `_as_json` gives."""
    groups = [
        ParameterGroup(
            name=str(group["name"]),
            unit=str(group["unit"]),
            places=tuple(str(place) for place in group["places"]),
            std=float(group["std"]),
            mean=float(group["mean"]),
        )
        for group in plain["parameters"]
    ]
    return CalibratedMachine(
        identity,
        GroupedParameters(tuple(groups)),
        int(plain["channel_count"]),
        int(plain["command_count"]),
    )


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


def _require_fitting(calibration: Calibration, machine: CalibratedMachine, path: str) -> None:
    if calibration.arm_identity != machine.identity:
        raise CalibrationError(
            f"{path}: is of arm {calibration.arm_identity[:80]}, not of {machine.identity}; "
            "calibrate this arm, or give the file that it was made with"
        )
    count = len(machine.parameters)
    sizes = {len(calibration.mean), len(calibration.prior_mean)}
    sizes |= {len(calibration.covariance), len(calibration.prior_covariance)}
    if sizes != {count}:
        raise CalibrationError(
            f"{path}: has {len(calibration.mean)} parameters; {machine.identity} has {count}: it "
            "was made by another version, so calibrate again"
        )
    numbers = [calibration.mean, calibration.covariance, calibration.prior_mean]
    numbers += [calibration.prior_covariance, np.array([calibration.chi2])]
    expected = (machine.channel_count,), (machine.command_count,)
    for one in calibration.unloaded:
        shapes = one.reading_n.shape, one.command_rad.shape
        if shapes != expected:
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
