"""The course of a recording or an experiment: commands and known loads in time."""

from __future__ import annotations

from typing import NamedTuple

from cablesense_base import Array


class Course(NamedTuple):
    """What an arm is put through: R samples, in time order.

    Attributes:
        time_s: (R,) ascending.
        command_rad: (R, 2N) commanded joint angles, pitch then yaw of each joint, base first; of a
            machine that MuJoCo describes (R, C), rad or m.
        forces_n: (R, N, 3) the load on each segment, base frame.
        places_m: (R, N) where on their axes loads act, from the joint centres; NaN for the arm
            file's `contact_m`. None where no sample states a place.
    """

    time_s: Array
    command_rad: Array
    forces_n: Array
    places_m: Array | None = None
