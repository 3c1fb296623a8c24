"""Builds an arm's simulated arrays, and the effects that act on them, from its description."""

from __future__ import annotations

import numpy as np

from cablesense_sim.arm import Arm, of_each_segment
from cablesense_sim.effects.registry import EffectEntry, checked_entry
from cablesense_sim.mechanism import Mechanism


def mechanism_of(arm: Arm) -> Mechanism:
    """The mechanism that an arm file describes, as it was drawn: without the effects it lists."""
    count = arm.segment_count
    segment_cables = arm.cables.per_segment
    segment = np.repeat(np.arange(1, count + 1), segment_cables)
    radius, angle = arm.holes
    y = radius * np.sin(angle)
    z = radius * np.cos(angle)
    length = np.asarray(of_each_segment(arm.segments.length_m, count))
    offset = arm.segments.plate_offset_m
    kp = arm.actuators.kp_n_m
    joint_x = offset + np.concatenate([[0.0], np.cumsum(length)[:-1]])
    straight = arm.cables.run_m + joint_x[segment - 1] + offset
    if arm.cables.stiffness_n_m is not None:
        in_series = np.full(segment.shape, arm.cables.stiffness_n_m)
        cable_alone = 1.0 / (1.0 / in_series - 1.0 / kp)
    else:
        assert arm.cables.axial_rigidity_n is not None
        cable_alone = arm.cables.axial_rigidity_n / straight
        in_series = 1.0 / (1.0 / cable_alone + 1.0 / kp)
    return Mechanism(
        gravity_m_s2=np.asarray(arm.gravity_m_s2, dtype=float),
        segment_length_m=length,
        mass_kg=np.asarray(of_each_segment(arm.segments.mass_kg, count)),
        centre_of_mass_m=0.5 * length,
        contact_m=np.asarray(of_each_segment(arm.segments.contact_m, count)),
        plate_offset_m=offset,
        cable_segment=segment,
        hole_y_m=y,
        hole_z_m=z,
        segment_hole_y_m=np.repeat(y[:, None], count, axis=1),
        segment_hole_z_m=np.repeat(z[:, None], count, axis=1),
        stiffness_n_m=in_series,
        cable_stiffness_n_m=cable_alone,
        actuator_stiffness_n_m=kp,
        pretension_n=np.full(segment.shape, arm.cables.pretension_n),
        run_m=arm.cables.run_m,
        joint_damping_n_m_s=arm.segments.joint_damping_n_m_s,
        joint_stiffness_n_m_rad=np.zeros(count),
        relative_friction=np.ones(segment.shape),
    )


def entries_of(arm: Arm) -> list[EffectEntry]:
    """The effects that an arm file lists, in the order of the file; they act in their own."""
    sizes = arm.segment_count, arm.cable_count
    return [checked_entry(e.effect, e.at, e.parameters, *sizes) for e in arm.effects]
