"""Cables that lengthen slowly under load and recover slowly."""

from __future__ import annotations

import numpy as np

from cablesense_base import Array
from cablesense_sim.effects.effect import (
    Effect,
    Parameter,
    Rest,
    Transmission,
    Values,
    own_cables,
    shape,
)
from cablesense_sim.mechanism import Mechanism


class CableCreep(Effect):
    """A cable with three Kelvin-Voigt elements behind its spring, evenly spread in log time.

    Their retardation times are the middle one, and `spread` times shorter and longer; at a spread
    of one they are a single element. Together they give way by `share` of the elastic stretch.
    """

    name = "cable_creep"
    acts_on = "transmission"
    about = "cables that creep under load"
    source = "Findley, Lai and Onaran, Creep and Relaxation of Nonlinear Materials, 1976, ch. 5"
    sites = ("arm", "segment")
    advice = "Pre-stretch the cables, or tare again after every long hold."
    needs_time = True
    parameters = (
        Parameter("share", "1", 0.0, 5.0, 0.1, "of the elastic stretch that creep adds"),
        shape("time_s", "s", 0.5, 3000.0, 20.0, "retardation time", 20.0,
              starts=(5.0, 20.0, 80.0)),
        shape("spread", "1", 1.0, 30.0, 3.0, "between neighbouring times", 1.0, starts=(1.0,)),
        shape("settled", "1", -1.0, 1.0, 0.5,
              "share of the creep under pretension that was over before the cables were tensioned",
              starts=(0.5,)),
        shape("begun", "1", 0.0, 1.0, 0.5,
              "share of the creep to come that was over before the first sample", starts=(0.5,),
              past=True),
    )  # fmt: skip

    def transmission(self, place: str, values: Values) -> Transmission:
        return _Creep(place, values)


class _Creep(Transmission):
    def __init__(self, place: str, values: Values) -> None:
        self._place = place
        self._share = values["share"][:, None]
        spread = values["spread"][:, None] ** np.array([-1.0, 0.0, 1.0])
        self._times_s = (values["time_s"][:, None] * spread)[:, None, :]
        self._settled, self._begun = values["settled"][:, None], values["begun"][:, None]

    def begin(self, mechanism: Mechanism, rest: Rest) -> None:
        here = own_cables(self._place, mechanism)
        self._give_m_n = self._share * here / mechanism.stiffness_n_m
        self._reference_n = self._settled * mechanism.pretension_n
        target = self._give_m_n * (rest.tensions_n - self._reference_n)
        self._parts_m = np.repeat((self._begun * target)[..., None] / 3.0, 3, axis=-1)
        self._rest = rest

    def lengthening_m(self, time_s: float) -> Array:
        return np.asarray(self._parts_at(time_s).sum(-1))

    def settle(self, rest: Rest) -> None:
        self._parts_m = self._parts_at(rest.time_s)
        self._rest = rest

    def _parts_at(self, time_s: float) -> Array:
        """Each element follows the load of the last rest towards its share."""
        target = self._give_m_n * (self._rest.tensions_n - self._reference_n)
        done = -np.expm1(-max(time_s - self._rest.time_s, 0.0) / self._times_s)
        return np.asarray(self._parts_m + done * (target[..., None] / 3.0 - self._parts_m))
