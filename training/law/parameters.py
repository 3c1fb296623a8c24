"""The numbers of an arm by its uncertain parameters, as the measurement takes them."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor, nn

from cablesense_sim.mechanism import Mechanism
from cablesense_sim.parameter_groups import CARRIED_FRICTION
from cablesense_sim.tolerances import ArmParameters
from cablesense_sim.uncertain_arm import CableFriction
from cablesense_training.law.geometry import CableGeometry, Holes, Matrix, constant


class Parameters(NamedTuple):
    """The mean parameters by kind, as the measurement takes them."""

    compliance_m_n: Tensor  # (M,)
    pretension_n: Tensor  # (M,)
    run_share: Tensor  # (M,) of the compliance, before the pulley
    holes: Holes
    carried_friction: Tensor  # (N + 1, M)
    gain: Tensor  # (M,) one and the deviation
    zero_n: Tensor  # (M,)
    bodies: Tensor  # (5N,) of segments: mass, centre, length; centres along y and along z
    length_m: Tensor  # (N,)
    gravity_m_s2: Tensor  # (1, 3)
    joint_zero_rad: Tensor  # (2N,)


class ArmNumbers(nn.Module):
    """`Parameters` of a mean θ (P,).

    Args:
        mechanism: the arm as its file describes it.
        parameters: its uncertain parameters.
        friction: where the cables rub.
        cables: its geometry.
    """

    def __init__(
        self,
        mechanism: Mechanism,
        parameters: ArmParameters,
        friction: CableFriction,
        cables: CableGeometry,
    ) -> None:
        super().__init__()
        self.segment_count = mechanism.segment_count
        self.cable_count = mechanism.cable_count
        self.sizes = _sizes(parameters)
        self.cables = cables
        nominal, scale = _nominal(mechanism, parameters, cables.radius_m)
        self.nominal = constant(nominal)
        self.scale = constant(scale)
        self.compliance_m_n = constant(1.0 / mechanism.stiffness_n_m)
        self.run_log = constant(np.log(friction.run_compliance))
        self.gravity_m_s2 = constant(mechanism.gravity_m_s2[None])
        self.gravity_by_tilt = constant(gravity_by_tilt(mechanism))

    def forward(self, mean: Tensor) -> Parameters:
        """The parameters of a mean θ (P,)."""
        count = self.segment_count
        values = self.nominal + self.scale * mean
        parts = values.split(self.sizes)
        stiffness, pretension, run, holes, carried, gain, zero, bodies, tilt, joint_zero, _ = parts
        return Parameters(
            compliance_m_n=self.compliance_m_n / torch.exp(stiffness),
            pretension_n=pretension,
            run_share=torch.sigmoid(self.run_log + run),
            holes=self.cables.holes(holes.reshape(2, count + 1, self.cable_count)),
            carried_friction=carried.reshape(count + 1, self.cable_count),
            gain=gain,
            zero_n=zero,
            bodies=bodies,
            length_m=bodies[2 * count : 3 * count],
            gravity_m_s2=self.gravity_m_s2 + tilt @ self.gravity_by_tilt,
            joint_zero_rad=joint_zero,
        )


def gravity_by_tilt(mechanism: Mechanism) -> Matrix:
    """(2, 3) derivatives of gravity by the tilt of the base about its y and its x axis."""
    gravity = mechanism.gravity_m_s2
    return np.array([np.cross([0.0, 1.0, 0.0], gravity), np.cross([1.0, 0.0, 0.0], gravity)])


def _nominal(
    mechanism: Mechanism, parameters: ArmParameters, radius_m: Matrix
) -> tuple[Matrix, Matrix]:
    """The numbers of an arm as its file describes it, in the places of its parameters θ.

    Of holes they are radius and offset around. With the second, n + s θ are those of another arm.
    """
    slices = parameters.slices
    nominal = np.zeros(len(parameters))
    scale = np.ones(len(parameters))
    nominal[slices["pretension"]] = mechanism.pretension_n
    for plate, radius in enumerate(radius_m):
        nominal[slices[f"hole_outward_{plate}"]] = radius
    nominal[slices["sensor_gain"]] = 1.0
    nominal[slices["segment_mass"]] = mechanism.mass_kg
    scale[slices["segment_mass"]] = mechanism.mass_kg
    nominal[slices["centre_of_mass"]] = mechanism.centre_of_mass_m
    nominal[slices["segment_length"]] = mechanism.segment_length_m
    return nominal, scale


def _sizes(parameters: ArmParameters) -> list[int]:
    """Numbers of parameters of each kind, with all holes together, all guides, and all bodies."""
    sizes: dict[str, int] = {}
    bodies = ("segment_mass", "centre_of_mass", "segment_length", "centre_across")
    for name, part in parameters.slices.items():
        kind = name.rstrip("0123456789") if name.startswith(CARRIED_FRICTION) else name
        kind = "hole" if name.startswith("hole") else kind
        kind = "bodies" if name in bodies else kind
        sizes[kind] = sizes.get(kind, 0) + part.stop - part.start
    return list(sizes.values())
