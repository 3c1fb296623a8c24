"""Dry friction in universal joints."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from cablesense_sim.effects.effect import (
    WHOLE_ARM,
    Array,
    Effect,
    Parameter,
    Values,
    chosen,
    joints,
)
from cablesense_sim.effects.transmission import Rest, Transmission

if TYPE_CHECKING:
    from cablesense_sim.mechanism import Mechanism


class JointFriction(Effect):
    """Coulomb friction in both axes of a joint, which gives a little before it breaks away.

    The torque grows evenly with the turn since the last reversal up to its limit, and then stays;
    it lasts at rest.
    """

    name = "joint_friction"
    acts_on = "transmission"
    about = "dry friction in one or more universal joints"
    source = "Dahl, A solid friction model, Aerospace Corp. TOR-0158, 1968, with a sharp limit"
    parameters = (
        Parameter("torque_n_m", "N·m", 0.0, 20.0, 0.1, "at which an axis breaks away"),
        Parameter(
            "give_rad",
            "rad",
            1e-5,
            0.05,
            1e-3,
            "turn from rest to breaking away",
            3e-4,
            "shape",
            (3e-4,),
            (1e-4, 1e-3),
        ),
        Parameter("start", "1", -1.0, 1.0, 0.5, "share of the torque at first", role="shape"),
    )

    def places(self, segment_count: int, cable_count: int) -> tuple[str, ...]:
        return (WHOLE_ARM, *joints(segment_count))

    def transmission(self, place: str, values: Values) -> Transmission:
        return _DryJoints(place, values)


class _DryJoints(Transmission):
    def __init__(self, place: str, values: Values) -> None:
        self._place = place
        self._limit_n_m = values["torque_n_m"][:, None]
        self._give_rad = values["give_rad"][:, None]
        self._start = values["start"][:, None]

    def begin(self, mechanism: Mechanism, rest: Rest) -> None:
        here = np.repeat(chosen(self._place, mechanism.segment_count), 2)
        self._limit_n_m = self._limit_n_m * here
        self._angles_rad = rest.angles_rad
        self._share = np.broadcast_to(self._start, rest.angles_rad.shape)

    def joint_torque_n_m(self, angles_rad: Array) -> tuple[Array, Array]:
        free = self._free_share(angles_rad)
        share = np.clip(free, -1.0, 1.0)
        sticks = np.abs(free) < 1.0
        return self._limit_n_m * share, self._limit_n_m * sticks / self._give_rad

    def settle(self, rest: Rest) -> None:
        self._share = np.clip(self._free_share(rest.angles_rad), -1.0, 1.0)
        self._angles_rad = rest.angles_rad

    def _free_share(self, angles_rad: Array) -> Array:
        return np.asarray(self._share + (angles_rad - self._angles_rad) / self._give_rad)
