"""The course of section IV-A: joint angles through −10°, 0°, 10°, 0° again and again."""

from __future__ import annotations

import numpy as np

from cablesense_base.arrays import Array

AMPLITUDE_RAD = float(np.deg2rad(10.0))
PERIOD_S = 4.0


def course_rad(time_s: Array, joints: list[int], joint_count: int) -> Array:
    """Joint angles (T, 2N) at times (T,): a sine in the given joints, the others at zero.

    The first period rises from rest without a jolt; the whole periods after it are alike. The
    paper gives the four angles and a periodic course, and neither its period nor which joints.
    """
    risen = np.clip(time_s / PERIOD_S, 0.0, 1.0)
    envelope = risen**3 * (10.0 - 15.0 * risen + 6.0 * risen**2)
    angles = np.zeros((len(time_s), joint_count))
    swing = -AMPLITUDE_RAD * envelope * np.sin(2.0 * np.pi * time_s / PERIOD_S)
    angles[:, joints] = swing[:, None]
    return angles
