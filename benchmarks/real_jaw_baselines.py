"""What an estimator of the jaw's torque has to beat: regressions and boosted trees.

All of them see the drive's angle, torque and motor current up to the sample that they answer for,
and nothing else.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Protocol

import numpy as np
from real_jaw_recordings import JawRecording
from sklearn.ensemble import HistGradientBoostingRegressor

from cablesense_base import Array

RADII_RAD = (0.002, 0.005, 0.01, 0.02, 0.03, 0.05, 0.08, 0.12, 0.2, 0.35)
"""Of the play operators: from a sensor's step to a third of the drive's course."""

_RIDGE = 1e-4
_HISTORY = (5, 10, 20, 30, 50)
"""Samples back, up to half a second."""


class TorqueEstimator(Protocol):
    """Tells the jaw's torque from the drive's signals."""

    def adapted(self, recordings: Sequence[JawRecording]) -> TorqueEstimator:
        """The estimator for another tool, of which some recordings are known."""
        ...

    def torques_nm(self, recordings: Sequence[JawRecording]) -> list[Array]:
        """The jaw's torque (T,) in each recording, each from the samples up to then."""
        ...


def stops(angle_rad: Array, radii_rad: Sequence[float] = RADII_RAD) -> Array:
    """(T, K) elastic parts of play operators of K radii, as shares -1 to 1 of the radius.

    1 and -1 while the operator's other end follows, upwards and downwards; that of the least
    radius is the direction of motion.
    """
    radii = np.asarray(radii_rad)
    held = np.full(len(radii), angle_rad[0])
    shares = np.empty((len(angle_rad), len(radii)))
    for row, angle in enumerate(angle_rad):
        held = np.clip(held, angle - radii, angle + radii)
        shares[row] = (angle - held) / radii
    return shares


def gain_and_offset(recording: JawRecording) -> Array:
    """(T, 2)."""
    torque = recording.drive_torque_nm
    return np.stack([np.ones_like(torque), torque], axis=1)


def coulomb(recording: JawRecording) -> Array:
    """(T, 3) with a constant friction by direction besides."""
    direction = stops(recording.drive_angle_rad, RADII_RAD[:1])
    return np.hstack([gain_and_offset(recording), direction])


def load_proportional(recording: JawRecording) -> Array:
    """(T, 4) with a friction besides that grows with the torque."""
    features = coulomb(recording)
    return np.hstack([features, features[:, 1:2] * features[:, 2:3]])


def play(recording: JawRecording) -> Array:
    """(T, 66) products of signals, and of 1 and those with the stops of the drive's angle."""
    angle, torque = recording.drive_angle_rad, recording.drive_torque_nm
    current = recording.motor_current_a
    signals = np.stack(
        [np.ones_like(angle), torque, angle, current, torque * angle, current * angle], axis=1
    )
    shares = np.insert(stops(angle), 0, 1.0, axis=1)
    return (signals[:, :, None] * shares[:, None, :]).reshape(len(angle), -1)


def history(recording: JawRecording) -> Array:
    """(T, 13) angle, speed, torque and current, and torque and angle of the last half second."""
    angle, torque = recording.drive_angle_rad, recording.drive_torque_nm
    now = np.arange(len(angle))
    past = [np.maximum(now - back, 0) for back in _HISTORY]
    speed = angle - angle[past[0]]
    columns = [angle, speed, torque, recording.motor_current_a]
    return np.stack([*columns, *(torque[p] for p in past), *(angle[p] for p in past)], axis=1)


class Regression:
    """A linear regression on features of the drive's signals, fitted anew to each tool."""

    def __init__(
        self, features: Callable[[JawRecording], Array], recordings: Sequence[JawRecording]
    ) -> None:
        self._features = features
        matrix = np.vstack([features(r) for r in recordings])
        scale = np.sqrt((matrix**2).mean(0))
        matrix = matrix / scale
        torque = np.concatenate([r.jaw_torque_nm for r in recordings])
        ridge = _RIDGE * len(matrix) * np.eye(len(scale)) * (len(scale) > 4)
        self._weights = np.linalg.solve(matrix.T @ matrix + ridge, matrix.T @ torque) / scale

    def adapted(self, recordings: Sequence[JawRecording]) -> Regression:
        """The same, fitted to those recordings alone."""
        return Regression(self._features, recordings)

    def torques_nm(self, recordings: Sequence[JawRecording]) -> list[Array]:
        """The jaw's torque (T,) in each recording."""
        return [self._features(r) @ self._weights for r in recordings]


class BoostedTrees:
    """Boosted trees on half a second of the drive's signals, grown anew for each tool."""

    def __init__(self, recordings: Sequence[JawRecording]) -> None:
        self._trees = HistGradientBoostingRegressor(random_state=0, early_stopping=False)
        self._trees.fit(
            np.vstack([history(r) for r in recordings]),
            np.concatenate([r.jaw_torque_nm for r in recordings]),
        )

    def adapted(self, recordings: Sequence[JawRecording]) -> BoostedTrees:
        """The same, grown for those recordings alone."""
        return BoostedTrees(recordings)

    def torques_nm(self, recordings: Sequence[JawRecording]) -> list[Array]:
        """The jaw's torque (T,) in each recording."""
        return [np.asarray(self._trees.predict(history(r))) for r in recordings]
