"""The statement on the contacts of a machine that MuJoCo describes, as a torch module."""

from __future__ import annotations

import numpy as np

from cablesense_base import Array
from cablesense_contact.machine.felt_directions import felt_across
from cablesense_contact.machine.law import GRAPH_FORCE_N
from cablesense_contact.machine.observation import Observer
from cablesense_sim.machine.machine import Machine
from cablesense_sim.machine.statics import MachineStatics
from cablesense_sim.touch import TouchedPlaces
from cablesense_training.law.posterior import LARGEST_N
from cablesense_training.law.statement import ContactStatement
from cablesense_training.law.wrench import FORCE_STD_N


def machine_statement(machine: Machine) -> ContactStatement:
    """The statement of a machine's links."""
    assert GRAPH_FORCE_N == LARGEST_N
    links = machine.links
    touched = TouchedPlaces(links.touched_m, links.radius_m, machine.source.file.touch.friction)
    length_m = np.abs(links.touched_m).max(axis=1)
    span_m = links.touched_m[:, 1] - links.touched_m[:, 0]
    # one link begins where the one before it ends
    ends_m = np.cumsum(span_m)
    joint_m = ends_m - links.touched_m[:, 1]
    return ContactStatement(
        touched,
        length_m,
        joint_m,
        _torque_scale(machine),
        felt_across=felt_across(Observer(machine)),
        partly_felt=True,
    )


def _torque_scale(machine: Machine) -> Array:
    """(n,) by forces in the middle of all links, as independent at each coordinate."""
    statics = MachineStatics(machine)
    statics.at(machine.reference)
    frames = statics.links()
    middle_m = machine.links.touched_m.mean(axis=1)
    place_m = middle_m[:, None] * frames.axes[:, :, 0]
    moments = np.cross(place_m[:, None], np.eye(3))
    unit = frames.by_force_m + np.einsum("nfx,nxj->nfj", moments, frames.by_moment)
    variance = np.einsum("nfj,nfj->j", unit, unit)
    floor = 1e-6 * float(variance.max())
    return np.asarray(FORCE_STD_N * np.sqrt(variance + floor))
