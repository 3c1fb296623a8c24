"""The cable over a cylinder, Fig. 3 (c), drawn in MuJoCo under several laws of friction."""

from __future__ import annotations

from enum import StrEnum
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from cablesense_paper.cables.one_metre_cable import (
    CYLINDER_RADIUS_M,
    PRETENSION_N,
    STICK_STIFFNESS_N_M,
    around_a_cylinder,
    drive_direction,
)

Array = NDArray[np.float64]

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
