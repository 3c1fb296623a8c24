"""What is uncertain about a machine, by its file: one vector of deviations from its model."""

from __future__ import annotations

from typing import NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray

from cablesense_base import Array
from cablesense_sim.machine.machine import Machine
from cablesense_sim.machine.tendon_guides import TendonGuides
from cablesense_sim.parameter_groups import CARRIED_FRICTION, GroupedParameters, ParameterGroup

_AXES = ("x", "y", "z")


class RoutingSites(NamedTuple):
    """The S sites that tendons pass, and the two directions across the tendon at each.

    Attributes:
        ids: (S,) numbers in the model.
        names: of them.
        across: (S, 2, 3) in the frames of their bodies.
        rounds: lists of sites of which no two are on one tendon: they may be moved at once.
        tendon_of: (S, K) whether a tendon passes a site.
    """

    ids: NDArray[np.int64]
    names: tuple[str, ...]
    across: Array
    rounds: tuple[NDArray[np.int64], ...]
    tendon_of: NDArray[np.bool_]


class MachineParameters(GroupedParameters):
    """The uncertain parameters θ of a machine, as one vector of P.

    Of the K tendons: stiffness (share) and pretension (N). Of the S sites that they pass: both
    directions across, all first and then all second ones (m). Of the B bodies that move: mass
    (share), and the centre along x, y and z (m), all along x first. Of the joints with springs:
    stiffness (share), and, where a tolerance is stated of it, that of all together. The tilt of
    the base about the model's x and y axes (rad). Of the M channels: gain (share), and zero, of
    forces and of torques (N, N·m). Of the n coordinates: zero of their command or reading (rad,
    m). Last the coefficient of friction, and, if there is any, what the tendons that are read
    carry of it at each guide (`tendon_guides`), one guide after another.

    Attributes:
        routing: the sites.
        bodies: (B,) numbers of the bodies.
        springs: (J,) numbers of the joints with springs.
        is_force: (M,) whether a channel reads a force, and not a torque.
        rubs: whether tendons that are read bend at guides, with friction.
    """

    def __init__(self, machine: Machine) -> None:
        tolerances = machine.source.file.tolerances
        model = machine.model
        tendons = machine.tendons.names
        guides = _guides(machine)
        self.rubs = bool(guides.any())
        self._has_no_guide = ~guides
        channels = machine.channels
        self.routing = _routing(machine)
        self.bodies = np.array(
            [
                b
                for b in range(1, model.nbody)
                if model.body_weldid[b] and model.body_mass[b] > 0.0
            ],
            dtype=np.int64,
        )
        self.springs = np.flatnonzero(model.jnt_stiffness > 0.0)
        bodies = [model.body(int(b)).name or f"body_{b}" for b in self.bodies]
        centres = tuple(f"{body} along {axis}" for axis in _AXES for body in bodies)
        springs = tuple(model.joint(int(j)).name for j in self.springs)
        common_share = tolerances.common_joint_stiffness_share
        all_springs = ("all joints",) if common_share and springs else ()
        sites = tuple(
            f"{site} ({way})" for way in ("first", "second") for site in self.routing.names
        )
        named = list(zip(channels.names, channels.units, strict=True))
        forces = tuple(name for name, unit in named if unit == "N")
        torques = tuple(name for name, unit in named if unit != "N")
        self.is_force = np.array([unit == "N" for unit in channels.units])
        names = machine.coordinates.names
        angles = tuple(
            n for n, yes in zip(names, machine.coordinates.is_hinge, strict=True) if yes
        )
        slides = tuple(n for n in names if n not in angles)
        half = 0.5 * machine.source.file.cables.friction_coefficient if self.rubs else 0.0
        carried = float(np.hypot(half, half))
        rubbed = [
            tuple(f"{tendon} at guide {g}" for tendon in tendons[: guides.shape[1]])
            for g in range(len(guides))
        ]
        tilt_rad = float(np.deg2rad(tolerances.base_tilt_deg))
        zero_rad = float(np.deg2rad(tolerances.joint_zero_deg))
        group = ParameterGroup
        super().__init__(
            (
                group("tendon_stiffness", "1", tendons, tolerances.stiffness_share),
                group("pretension", "N", tendons, tolerances.pretension_n),
                group("routing", "m", sites, tolerances.routing_m),
                group("mass", "1", tuple(bodies), tolerances.mass_share),
                group("centre_of_mass", "m", centres, tolerances.centre_of_mass_m),
                group("joint_stiffness", "1", springs, tolerances.joint_stiffness_share),
                group("common_joint_stiffness", "1", all_springs, common_share),
                group("base_tilt", "rad", ("about x", "about y"), tilt_rad),
                group("sensor_gain", "1", channels.names, tolerances.gain_share),
                group("sensor_zero", "N", forces, tolerances.zero_n),
                group("torque_zero", "N·m", torques, tolerances.zero_n_m),
                group("joint_zero", "rad", angles, zero_rad),
                group("slide_zero", "m", slides, tolerances.joint_zero_m),
                group("friction", "1", ("machine",), half, half),
                *(
                    group(f"{CARRIED_FRICTION}_{g}", "1", places, carried)
                    for g, places in enumerate(rubbed)
                ),
            )
        )

    @property
    def prior_std(self) -> Array:
        """(P,) standard deviations by the tolerances; zero where a tendon has no such guide."""
        std = super().prior_std
        std[self.carried_friction][self._has_no_guide.ravel()] = 0.0
        return std


def _guides(machine: Machine) -> NDArray[np.bool_]:
    """(G, M) whether tendons that are read bend at guides; none where no friction is stated."""
    if machine.source.file.cables.friction_coefficient == 0.0:
        return np.zeros((0, 0), dtype=bool)
    return TendonGuides(machine).exists


def _routing(machine: Machine) -> RoutingSites:
    """Sites of spatial tendons at the reference pose, each with two directions across."""
    model = machine.model
    data = mujoco.MjData(model)
    data.qpos[:] = machine.coordinates.positions(machine.reference)
    mujoco.mj_kinematics(model, data)
    paths = [_sites_of(model, int(t)) for t in machine.tendons.ids]
    ids = sorted({site for path in paths for site in path})
    tendon_of = np.array([[site in path for path in paths] for site in ids], dtype=bool)
    across = np.zeros((len(ids), 2, 3))
    for row, site in enumerate(ids):
        path = next(path for path in paths if site in path)
        across[row] = _across(data, path, path.index(site)) @ data.site_xmat[site].reshape(3, 3)
        # sites are moved in the frames of their bodies
        body = int(model.site_bodyid[site])
        turn = data.xmat[body].reshape(3, 3).T @ data.site_xmat[site].reshape(3, 3)
        across[row] = across[row] @ turn.T
    return RoutingSites(
        ids=np.array(ids, dtype=np.int64),
        names=tuple(model.site(site).name or f"site_{site}" for site in ids),
        across=across,
        rounds=_rounds(tendon_of),
        tendon_of=tendon_of.reshape(len(ids), len(paths)),
    )


def _sites_of(model: mujoco.MjModel, tendon: int) -> list[int]:
    """The sites of a tendon, in their order; none of a fixed tendon."""
    first = int(model.tendon_adr[tendon])
    wraps = range(first, first + int(model.tendon_num[tendon]))
    site = mujoco.mjtWrap.mjWRAP_SITE
    return [int(model.wrap_objid[w]) for w in wraps if model.wrap_type[w] == site]


def _across(data: mujoco.MjData, path: list[int], place: int) -> Array:
    """(2, 3) unit vectors across a tendon at one of its sites, in base axes."""
    before = data.site_xpos[path[max(place - 1, 0)]]
    after = data.site_xpos[path[min(place + 1, len(path) - 1)]]
    along = after - before
    length = float(np.linalg.norm(along))
    if length < 1e-9:
        return np.eye(3)[:2]
    # the two right-singular vectors that span what is across
    _, _, basis = np.linalg.svd((along / length)[None])
    return np.asarray(basis[1:])


def _rounds(tendon_of: NDArray[np.bool_]) -> tuple[NDArray[np.int64], ...]:
    """Sites in as few rounds as they come, with no tendon twice in a round."""
    rounds: list[list[int]] = []
    used: list[NDArray[np.bool_]] = []
    for site, passes in enumerate(tendon_of):
        for number, taken in enumerate(used):
            if not (taken & passes).any():
                rounds[number].append(site)
                used[number] = taken | passes
                break
        else:
            rounds.append([site])
            used.append(passes.copy())
    return tuple(np.array(members, dtype=np.int64) for members in rounds)
