"""The numbers of an arm by its uncertain parameters, as the measurement takes them.

`ArmParameters` says where the parameters of each group stand. The graph takes some groups together
as one *kind*, for example all holes, and the kinds in an order of its own (`groups_by_kind`).
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
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


BODIES = ("segment_mass", "centre_of_mass", "segment_length", "centre_across")
"""The groups whose parameters are taken together as the bodies of the segments."""


def groups_by_kind(segment_count: int) -> Mapping[str, tuple[str, ...]]:
    """Names of the groups of each kind, in the order in which the graph takes them."""
    plates = range(segment_count + 1)
    outward = tuple(f"hole_outward_{plate}" for plate in plates)
    around = tuple(f"hole_around_{plate}" for plate in plates)
    return {
        "cable_stiffness": ("cable_stiffness",),
        "pretension": ("pretension",),
        "run_compliance": ("run_compliance",),
        "holes": (*outward, *around),
        CARRIED_FRICTION: tuple(f"{CARRIED_FRICTION}_{guide}" for guide in plates),
        "sensor_gain": ("sensor_gain",),
        "sensor_zero": ("sensor_zero",),
        "bodies": BODIES,
        "base_tilt": ("base_tilt",),
        "joint_zero": ("joint_zero",),
        "friction": ("friction",),
    }


def positions_of(parameters: ArmParameters, groups: tuple[str, ...]) -> NDArray[np.int64]:
    """Indices of the parameters of some groups in θ, one group after another.

    Raises:
        ValueError: the arm has other groups than these.
    """
    slices = parameters.slices
    if set(groups) != set(slices):
        others = sorted(set(groups) ^ set(slices))
        raise ValueError(f"the law's graph and the arm's parameters differ in {others}")
    numbers = np.arange(len(parameters), dtype=np.int64)
    return np.concatenate([numbers[slices[name]] for name in groups])


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
        kinds = groups_by_kind(mechanism.segment_count)
        slices = parameters.slices
        self.size_by_kind = {
            kind: sum(slices[name].stop - slices[name].start for name in names)
            for kind, names in kinds.items()
        }
        positions = positions_of(parameters, sum(kinds.values(), ()))
        self.are_in_order = bool((positions == np.arange(len(positions))).all())
        self.positions = constant(positions)
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
        if not self.are_in_order:
            values = values[self.positions]
        parts = values.split(list(self.size_by_kind.values()))
        by_kind = dict(zip(self.size_by_kind, parts, strict=True))
        hole_shape = (2, count + 1, self.cable_count)
        bodies = by_kind["bodies"]
        first_length = BODIES.index("segment_length") * count
        return Parameters(
            compliance_m_n=self.compliance_m_n / torch.exp(by_kind["cable_stiffness"]),
            pretension_n=by_kind["pretension"],
            run_share=torch.sigmoid(self.run_log + by_kind["run_compliance"]),
            holes=self.cables.holes(by_kind["holes"].reshape(hole_shape)),
            carried_friction=by_kind[CARRIED_FRICTION].reshape(count + 1, self.cable_count),
            gain=by_kind["sensor_gain"],
            zero_n=by_kind["sensor_zero"],
            bodies=bodies,
            length_m=bodies[first_length : first_length + count],
            gravity_m_s2=self.gravity_m_s2 + by_kind["base_tilt"] @ self.gravity_by_tilt,
            joint_zero_rad=by_kind["joint_zero"],
        )


def gravity_by_tilt(mechanism: Mechanism) -> Matrix:
    """(2, 3) derivatives of gravity by the tilt of the base about its y and its x axis."""
    gravity = mechanism.gravity_m_s2
    return np.array([np.cross([0.0, 1.0, 0.0], gravity), np.cross([1.0, 0.0, 0.0], gravity)])


def _nominal(
    mechanism: Mechanism, parameters: ArmParameters, radius_m: Matrix
) -> tuple[Matrix, Matrix]:
    """The numbers of an arm as its file describes it, in the order of its parameters θ.

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
