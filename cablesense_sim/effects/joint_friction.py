"""Dry friction in universal joints."""

from __future__ import annotations

import numpy as np

from cablesense_base import Array
from cablesense_sim.effects.effect import (
    ROUNDED,
    DryContact,
    Effect,
    Parameter,
    Rest,
    Transmission,
    Values,
    chosen,
    shape,
    start_share,
)
from cablesense_sim.mechanism import Mechanism


class JointFriction(Effect):
    """Coulomb friction in both axes of a joint, which gives a little before it breaks away.

    The torque grows with the turn since the last reversal up to its limit, and then stays; it
    lasts at rest.
    """

    name = "joint_friction"
    acts_on = "transmission"
    about = "dry friction in joints"
    source = "Dahl, A solid friction model, Aerospace Corp. TOR-0158, 1968, with a sharp limit"
    sites = ("joint",)
    advice = "Move the joint by hand with slack cables; look for dry or jammed bearings."
    parameters = (
        Parameter("torque_n_m", "N·m", 0.0, 20.0, 0.1, "at which an axis breaks away"),
        shape("give_rad", "rad", 1e-5, 0.05, 1e-3, "turn from rest to breaking away", 3e-4,
              starts=(3e-4,), trials=(1e-4, 1e-3)),
        ROUNDED,
        start_share("start_pitch", about="share of the torque at first, about y"),
        start_share("start_yaw", about="share of the torque at first, about z"),
    )  # fmt: skip

    def transmission(self, place: str, values: Values) -> Transmission:
        return _DryJoints(place, values)


class _DryJoints(Transmission):
    def __init__(self, place: str, values: Values) -> None:
        self._place, self._values = place, values

    def begin(self, mechanism: Mechanism, rest: Rest) -> None:
        here = np.repeat(chosen(self._place, mechanism.segment_count), 2)
        self._limit_n_m = self._values["torque_n_m"][:, None] * here
        start = np.stack([self._values["start_pitch"], self._values["start_yaw"]], axis=-1)
        self._contact = DryContact(
            self._values["give_rad"][:, None],
            self._values["rounded"][:, None],
            np.tile(start, mechanism.segment_count),
        )

    def joint_torque_n_m(self, angles_rad: Array) -> tuple[Array, Array]:
        share, slope = self._contact.share(angles_rad)
        return self._limit_n_m * share, self._limit_n_m * slope

    def settle(self, rest: Rest) -> None:
        self._contact.settle(rest.angles_rad)
