"""What is uncertain about a built arm: one list of parameters, for estimates and diagnosis alike.

No built arm equals its file. `Tolerances`, a part of the arm file, states by how much the arm may
differ from it: one standard deviation each. `ArmParameters` lays these out as one vector θ of
deviations, with the prior mean and covariance that follow from the tolerances; `built` gives the
mechanism, and `read` the readings, of an arm with given deviations.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Annotated, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from cablesense_base import Array
from cablesense_base.plain_yaml import FilePart, Number
from cablesense_sim.mechanism import Mechanism
from cablesense_sim.parameter_groups import CARRIED_FRICTION, GroupedParameters, ParameterGroup

_Share = Annotated[Number, Field(ge=0.0, le=0.5)]
_Metres = Annotated[Number, Field(ge=0.0, le=0.02)]
_Degrees = Annotated[Number, Field(ge=0.0, le=10.0)]
_Newtons = Annotated[Number, Field(ge=0.0, le=1e4)]
_Coefficient = Annotated[Number, Field(ge=0.0, le=1.0)]
_Logarithm = Annotated[Number, Field(ge=0.0, le=3.0)]


class StandardDeviations(FilePart):
    """Numbers by which what is built may differ from its file: one standard deviation each."""

    def scaled(self, factor: float) -> Self:
        """All of them times a factor; zero states that it equals its file."""
        return self.model_copy(
            update={name: factor * value for name, value in self.model_dump().items()}
        )


class Tolerances(StandardDeviations):
    """By how much a built arm may differ from its file: one standard deviation each.

    The defaults are those of a careful workshop. A general tolerance of ± t is taken as t = 2
    standard deviations.

    Attributes:
        cable_stiffness_share: of each cable with its actuator. Catalogues state the modulus of
            wire ropes to about ± 10 % (Feyrer, Wire Ropes, 2nd ed. 2015, section 2.2).
        pretension_n: of each cable, as set by hand against its sensor.
        segment_mass_share: of each segment, as weighed with its share of cables and screws.
        centre_of_mass_m: of each segment, along its axis and across it; ISO 2768-1, class c.
        base_tilt_deg: of the base about each horizontal axis, as set by a machinist's level on a
            bench.
        hole_radial_m, hole_around_m: of each guide hole, outward and around the axis; ISO 2768-1,
            class m, of dimensions from 6 to 30 mm (± 0.2 mm).
        segment_length_m: from joint centre to joint centre; ISO 2768-1, class f, of dimensions
            from 120 to 400 mm (± 0.2 mm).
        sensor_gain_share: of each channel; load cells with their amplifiers, uncalibrated.
        sensor_zero_n: of each channel, before a tare.
        joint_zero_deg: of each joint angle: the actuators hold the lengths of angles that are off
            by this.
        friction_coefficient: between cables and guides, of an arm whose file lists no friction:
            every arm has some, most likely from none to this (half of it is mean and deviation).
            Where the file lists friction, the coefficient is known to `friction_share` of it.
        friction_share: see `friction_coefficient`.
        run_compliance_log: of the logarithm of each cable's `run_compliance` (see the effect
            `capstan_friction`); 0.7 is a factor of two. It says how much of what friction carries
            a reading shows.
        drift_n_per_hour: drift of each sensor's zero since its last unloaded reading.
        contact_m: of the point on each segment at which a recording says that a load acted, along
            the axis; ISO 2768-1, class m, of dimensions from 30 to 120 mm (± 0.3 mm) and of where
            a hook or a tip is set by hand.
    """

    cable_stiffness_share: _Share = 0.05
    pretension_n: _Newtons = 1.0
    segment_mass_share: _Share = 0.02
    centre_of_mass_m: _Metres = 0.001
    base_tilt_deg: _Degrees = 0.5
    hole_radial_m: _Metres = 1e-4
    hole_around_m: _Metres = 1e-4
    segment_length_m: _Metres = 1e-4
    sensor_gain_share: _Share = 0.005
    sensor_zero_n: _Newtons = 0.5
    joint_zero_deg: _Degrees = 0.2
    friction_coefficient: _Coefficient = 0.02
    friction_share: _Share = 0.33
    run_compliance_log: _Logarithm = 0.7
    drift_n_per_hour: _Newtons = 1.0
    contact_m: _Metres = 3e-4


class ArmParameters(GroupedParameters):
    """The uncertain parameters θ of an arm with N segments and M cables, as one vector of P.

    Parameters of a cable come first, M of each kind in the order of the cables: stiffness (share),
    pretension (N), compliance before the pulley over that behind it (logarithm), hole of each
    plate 0 (base) to N outward and then around (m), carried friction at the actuator's pulley and
    at the guides of each joint 1 to N (1), gain (share) and zero (N) of the sensor. Then of the
    segments, N each: mass (share), centre (m), length (m); and 2N of their centres across the
    axis, all along y and then along z (m). Last the tilt of the base about y and x (rad), the
    joint zeros (2N, rad) and the coefficient of friction.

    At a guide where a cable wraps by Φ, its tensions have the ratio exp(ε Φ) towards the arm. The
    *carried friction* ε is the *slide* u, from -1 (the larger tension is at the actuator) to 1 (at
    the arm), times the coefficient. It is a state, not a property: each motion and each load
    changes it (`cablesense_contact.slides`).
    """

    def __init__(
        self, mechanism: Mechanism, tolerances: Tolerances, friction: float = 0.0
    ) -> None:
        """`friction` is the coefficient that the arm file lists; zero where it lists none."""
        count = mechanism.segment_count
        cables = tuple(f"cable_{i + 1}" for i in range(mechanism.cable_count))
        segments = tuple(f"segment_{n + 1}" for n in range(count))
        across = tuple(f"segment_{n + 1} along {axis}" for axis in "yz" for n in range(count))
        joints = tuple(f"joint_{n + 1}_{axis}" for n in range(count) for axis in ("pitch", "yaw"))
        plates = [tuple(f"{cable} at plate {n}" for cable in cables) for n in range(count + 1)]
        outward = [
            ParameterGroup(f"hole_outward_{n}", "m", places, tolerances.hole_radial_m)
            for n, places in enumerate(plates)
        ]
        around = [
            ParameterGroup(f"hole_around_{n}", "m", places, tolerances.hole_around_m)
            for n, places in enumerate(plates)
        ]
        guides = [tuple(f"{cable} at guide {n}" for cable in cables) for n in range(count + 1)]
        tilt_rad = float(np.deg2rad(tolerances.base_tilt_deg))
        zero_rad = float(np.deg2rad(tolerances.joint_zero_deg))
        if friction:
            coefficient = ParameterGroup(
                "friction", "1", ("arm",), tolerances.friction_share * friction, friction
            )
        else:
            half = 0.5 * tolerances.friction_coefficient
            coefficient = ParameterGroup("friction", "1", ("arm",), half, half)
        rubs = coefficient.mean > 0.0 or coefficient.std > 0.0
        run_log = tolerances.run_compliance_log if rubs else 0.0
        carried_std = math.hypot(coefficient.mean, coefficient.std)
        carried = [
            ParameterGroup(f"{CARRIED_FRICTION}_{n}", "1", places, carried_std)
            for n, places in enumerate(guides)
        ]
        groups = (
            ParameterGroup("cable_stiffness", "1", cables, tolerances.cable_stiffness_share),
            ParameterGroup("pretension", "N", cables, tolerances.pretension_n),
            ParameterGroup("run_compliance", "1", cables, run_log),
            *outward,
            *around,
            *carried,
            ParameterGroup("sensor_gain", "1", cables, tolerances.sensor_gain_share),
            ParameterGroup("sensor_zero", "N", cables, tolerances.sensor_zero_n),
            ParameterGroup("segment_mass", "1", segments, tolerances.segment_mass_share),
            ParameterGroup("centre_of_mass", "m", segments, tolerances.centre_of_mass_m),
            ParameterGroup("segment_length", "m", segments, tolerances.segment_length_m),
            ParameterGroup("centre_across", "m", across, tolerances.centre_of_mass_m),
            ParameterGroup("base_tilt", "rad", ("about y", "about x"), tilt_rad),
            ParameterGroup("joint_zero", "rad", joints, zero_rad),
            coefficient,
        )
        super().__init__(groups)
        self._mechanism = mechanism

    @property
    def prior_std(self) -> Array:
        """(P,) standard deviations by the tolerances; zero where a cable has no such hole."""
        std = super().prior_std
        for n in range(1, self._mechanism.segment_count + 1):
            absent = ~self._mechanism.passes_joint[:, n - 1]
            for name in (f"hole_outward_{n}", f"hole_around_{n}", f"{CARRIED_FRICTION}_{n}"):
                std[self.slices[name]][absent] = 0.0
        return std

    def built(self, theta: Array) -> Mechanism:
        """The mechanism of an arm that differs from its file by θ (P,).

        A mechanism has its centres of mass on the axes and holds the lengths of its commands:
        centres across the axis and joint zeros are not in it.
        """
        slices = self.slices
        nominal = self._mechanism
        count = nominal.segment_count
        outward = np.stack([theta[slices[f"hole_outward_{n}"]] for n in range(count + 1)], axis=1)
        around = np.stack([theta[slices[f"hole_around_{n}"]] for n in range(count + 1)], axis=1)
        base_y, base_z = displaced_m(
            nominal.hole_y_m, nominal.hole_z_m, outward[:, 0], around[:, 0]
        )
        plate_y, plate_z = displaced_m(
            nominal.segment_hole_y_m, nominal.segment_hole_z_m, outward[:, 1:], around[:, 1:]
        )
        about_y, about_x = theta[slices["base_tilt"]]
        turn = np.array([about_x, about_y, 0.0])
        stiffness_share = np.exp(theta[slices["cable_stiffness"]])
        return replace(
            nominal,
            gravity_m_s2=nominal.gravity_m_s2 + np.cross(turn, nominal.gravity_m_s2),
            segment_length_m=nominal.segment_length_m + theta[slices["segment_length"]],
            mass_kg=nominal.mass_kg * (1.0 + theta[slices["segment_mass"]]),
            centre_of_mass_m=nominal.centre_of_mass_m + theta[slices["centre_of_mass"]],
            hole_y_m=base_y,
            hole_z_m=base_z,
            segment_hole_y_m=plate_y,
            segment_hole_z_m=plate_z,
            stiffness_n_m=nominal.stiffness_n_m * stiffness_share,
            pretension_n=nominal.pretension_n + theta[slices["pretension"]],
        )

    def joint_zeros_rad(self, theta: Array) -> Array:
        """(2N,) by which the held lengths are those of other angles than the commanded ones."""
        return theta[self.slices["joint_zero"]]

    def read(self, theta: Array, tensions_n: Array) -> Array:
        """Readings (..., M) of tensions (..., M), without noise."""
        gain = 1.0 + theta[self.slices["sensor_gain"]]
        return gain * tensions_n + theta[self.slices["sensor_zero"]]

    def drawn(self, rng: np.random.Generator) -> Array:
        """Deviations (P,) of an arm of these tolerances, with slides between -1 and 1."""
        theta = super().drawn(rng)
        friction = self.slices["friction"]
        theta[friction] = np.abs(theta[friction])
        carried = self.carried_friction
        slides = rng.uniform(-1.0, 1.0, carried.stop - carried.start)
        theta[carried] = theta[friction] * slides
        return theta


def displaced_m(y: Array, z: Array, outward_m: Array, around_m: Array) -> tuple[Array, Array]:
    """Holes (y, z) moved along their own radial and tangential directions, from +z towards +y."""
    angle = np.arctan2(y, z)
    sine = np.sin(angle)
    cosine = np.cos(angle)
    return y + outward_m * sine + around_m * cosine, z + outward_m * cosine - around_m * sine


def plate_holes_of(mechanism: Mechanism) -> tuple[Array, NDArray[np.bool_]]:
    """Holes (N + 1, 2, M) as (y, z) in the base plate and the plates of each segment, m.

    The second (N + 1, M) says whether a cable has that hole.
    """
    y = np.concatenate([mechanism.hole_y_m[:, None], mechanism.segment_hole_y_m], axis=1)
    z = np.concatenate([mechanism.hole_z_m[:, None], mechanism.segment_hole_z_m], axis=1)
    has = np.concatenate([np.ones_like(mechanism.passes_joint[:, :1]), mechanism.passes_joint], 1)
    return np.stack([y.T, z.T], axis=1), has.T
