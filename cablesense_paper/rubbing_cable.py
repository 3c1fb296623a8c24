"""The cable over a cylinder, Fig. 3 (c), drawn in MuJoCo under several laws of friction.

The cable over a cylinder, from rest to rest: this project's own friction on Fig. 3 (c).
"""

from __future__ import annotations

from enum import StrEnum
from typing import Any

import mujoco
import numpy as np
from scipy.optimize import brentq

from cablesense_base.arrays import Array
from cablesense_paper.cables import (
    AXIAL_RIGIDITY_N,
    CYLINDER_RADIUS_M,
    LENGTH_M,
    PRETENSION_N,
    STICK_STIFFNESS_N_M,
    around_a_cylinder,
    drive_direction,
)
from cablesense_sim.effects.transmission import DryContact

_HARD_SOLREF = (2e-3, 1.0)
"""Twice a step of 1 ms, as short as MuJoCo lets it be without `refsafe` taking over."""
_HARD_SOLIMP = (0.9999, 0.9999, 1e-3, 0.5, 2.0)
"""At MuJoCo's own bound, `mjMAXIMP`."""


class Friction(StrEnum):
    """What holds the piece of cable on the cylinder.

    NONE: nothing. FRICTIONLOSS: MuJoCo's dry friction, a constraint, as it comes; the paper uses
    it. HARDENED: the same, the constraint as hard as MuJoCo takes it. YIELDING: MuJoCo's spring
    that yields at a fixed force (`springyield`). CAPSTAN: that spring, its yield force following
    the tensions by equation (2), set at every step.
    """

    NONE = "none"
    FRICTIONLOSS = "frictionloss"
    HARDENED = "frictionloss, hardened"
    YIELDING = "yielding spring"
    CAPSTAN = "capstan"


def capstan_limit_n(near_n: Any, far_n: Any, friction_rad: float) -> Any:
    """The most by which two tensions with this sum can differ before the cable slips.

    Where T_far = T_near exp(-μ θ), as equation (2) has it, T_near - T_far = (T_near + T_far)
    tanh(μ θ / 2). `friction_rad` is μ θ.
    """
    return (near_n + far_n) * np.tanh(0.5 * friction_rad)


class RubbingCable:
    """The model of Fig. 3 (c) in time; tensions are those of its two halves.

    Attributes:
        model, data: MuJoCo's own.
    """

    def __init__(
        self,
        friction: Friction,
        coefficient: float,
        wrap_rad: float,
        timestep_s: float = 1e-3,
    ) -> None:
        """Laws with a fixed force take that which the capstan holds at the pretension."""
        self._friction = friction
        self._friction_rad = coefficient * wrap_rad
        self._direction = drive_direction(wrap_rad)
        fixed_n = float(capstan_limit_n(PRETENSION_N, PRETENSION_N, self._friction_rad))
        spec = around_a_cylinder(wrap_rad)
        spec.option.timestep = timestep_s
        ring = spec.joint("ring")
        self._torsion_n_m_rad = STICK_STIFFNESS_N_M * CYLINDER_RADIUS_M**2
        if friction in (Friction.FRICTIONLOSS, Friction.HARDENED):
            ring.frictionloss = fixed_n * CYLINDER_RADIUS_M
            if friction is Friction.HARDENED:
                ring.solref_friction, ring.solimp_friction = _HARD_SOLREF, _HARD_SOLIMP
        elif friction is not Friction.NONE:
            ring.stiffness = [self._torsion_n_m_rad, 0.0, 0.0]
            ring.springyield = self._yield_rad(fixed_n)
        self.model = spec.compile()
        self.data = mujoco.MjData(self.model)
        self._home_m = self.data.mocap_pos[0].copy()
        mujoco.mj_forward(self.model, self.data)

    @property
    def tensions_n(self) -> Array:
        """(2,) tension before the cylinder, at the drive, and beyond it."""
        stretch = self.data.ten_length - self.model.tendon_lengthspring[:, 1]
        return np.asarray(
            np.maximum(self.model.tendon_stiffness.reshape(2, -1)[:, 0] * stretch, 0.0)
        )

    def advance(self, drawn_m: float) -> None:
        """One step of time with the drive this far out."""
        self.data.mocap_pos[0] = self._home_m + drawn_m * self._direction
        mujoco.mj_kinematics(self.model, self.data)
        mujoco.mj_tendon(self.model, self.data)
        if self._friction is Friction.CAPSTAN:
            near_n, far_n = self.tensions_n
            held_n = capstan_limit_n(near_n, far_n, self._friction_rad)
            self.model.jnt_springyield[:] = self._yield_rad(held_n)
        mujoco.mj_step(self.model, self.data)
        mujoco.mj_kinematics(self.model, self.data)
        mujoco.mj_tendon(self.model, self.data)

    def drawn(self, course_m: Array) -> Array:
        """Tensions (T, 2) along a course (T,) of the drive, a step of time each."""
        tensions = np.empty((len(course_m), 2))
        for row, drawn_m in enumerate(course_m):
            self.advance(drawn_m)
            tensions[row] = self.tensions_n
        return tensions

    def _yield_rad(self, force_n: float) -> float:
        return force_n * CYLINDER_RADIUS_M / self._torsion_n_m_rad


_HALF_STIFFNESS_N_M = AXIAL_RIGIDITY_N / (0.5 * LENGTH_M)
_ROUNDING_M = 1e-15


def rubbing_tensions_n(course_m: Array, coefficient: float, wrap_rad: float) -> Array:
    """Tensions (T, 2) before and beyond the cylinder along a course (T,) of the drive.

    Where the cable has passed over the cylinder by s, T1 = T0 + k (c - s) and T2 = T0 + k s with
    c the course and k of half the cable; friction holds T1 = T2 exp(μ θ share(s)), the share of
    its limit after `cablesense_sim.effects.transmission`, as the effect `capstan_friction` does.
    The contact gives as much before it slips as the friction of `rubbing_cable` does.
    """
    friction_rad = coefficient * wrap_rad
    give_m = max(friction_rad, 1e-6) * PRETENSION_N / STICK_STIFFNESS_N_M
    none = np.zeros(1)
    contact = DryContact(np.array([give_m]), none, none, none)
    tensions = np.empty((len(course_m), 2))

    def missing_n(passed_m: float, drawn_m: float) -> float:
        share = contact.share(np.array([passed_m]))[0][0]
        near, far = _halves_n(passed_m, drawn_m)
        return float(near - far * np.exp(friction_rad * share))

    slack_m = PRETENSION_N / _HALF_STIFFNESS_N_M
    for row, drawn_m in enumerate(course_m):
        passed_m = brentq(missing_n, -slack_m, drawn_m + slack_m, (drawn_m,), xtol=_ROUNDING_M)
        contact.settle(np.array([passed_m]))
        tensions[row] = _halves_n(passed_m, drawn_m)
    return tensions


def _halves_n(passed_m: float, drawn_m: float) -> tuple[float, float]:
    near = PRETENSION_N + _HALF_STIFFNESS_N_M * (drawn_m - passed_m)
    return near, PRETENSION_N + _HALF_STIFFNESS_N_M * passed_m
