"""Effects from the actuators along the cables to the joints, which depend on the history."""

from __future__ import annotations

from functools import partial

import numpy as np

from cablesense_base import Array
from cablesense_sim.cable_pull import CablePull
from cablesense_sim.effects.effect import (
    Actuation,
    ArmEquilibrium,
    Effect,
    Parameter,
    Transmission,
    Values,
    cables,
    chosen,
    own_cables,
    shape,
)
from cablesense_sim.mechanism import Mechanism

_start_share = partial(shape, unit="1", low=-1.0, high=1.0, typical=0.5, fades=True, past=True)
"""A share of its limit that friction carries before the first sample."""
_WEIGHT_BORNE = shape(
    "weight_borne",
    "1",
    0.0,
    1.0,
    0.5,
    "share of its weight that the arm bore when the tensions along a cable were equal",
    1.0,
    trials=(0.0, 1.0),
    fades=True,
    past=True,
)


class ActuatorBacklash(Effect):
    """Play between screw and nut: the held length follows the command half the play behind."""

    name = "actuator_backlash"
    acts_on = "actuator"
    about = "lost motion of actuators on reversal"
    source = "Nordin and Gutman, Controlling mechanical systems with backlash, Automatica 2002"
    sites = ("cable",)
    advice = "Check couplings and nuts of these actuators, or approach poses from one side."
    parameters = (
        Parameter(
            "play_m", "m", 0.0, 0.005, 5e-5, "between the two flanks", starts=(5e-5, 2.5e-4)
        ),
        shape(
            "start",
            "1",
            -1.0,
            1.0,
            1.0,
            "where in the play it begins, from the short to the long side",
            past=True,
        ),
    )

    def actuation(self, place: str, values: Values) -> Actuation:
        return _Play(place, values["play_m"], values["start"])


class _Play(Actuation):
    def __init__(self, place: str, play_m: Array, start: Array) -> None:
        self._place = place
        self._half_m = 0.5 * play_m[:, None]
        self._start = start[:, None]
        self._held_m: Array | None = None

    def step(self, time_s: float, values: Array) -> Array:
        if self._held_m is None:
            self._held_m = values + self._start * self._half_m
        self._held_m = np.clip(self._held_m, values - self._half_m, values + self._half_m)
        return np.where(chosen(self._place, values.shape[-1]), self._held_m, values)


class CapstanFriction(Effect):
    """Cables that stick and slip at their guides, where the ratio of tensions is at most exp(μ θ).

    The wrap angle θ is the turn of a cable at the guides around each joint, plus its turn there
    in a straight arm and, before the first joint, at the actuator's pulley.
    """

    name = "capstan_friction"
    acts_on = "transmission"
    about = "friction of the cables over guides and pulleys"
    source = "equation (2) of the paper: T_out = T_in exp(-μ θ); see cablesense_sim.cable_chain"
    advice = (
        "Look for worn, dry or misaligned guides. Readings do not show loads within the loop that "
        "friction opens: let the arm breathe (docs/breathing.md) before a force is trusted."
    )
    version = 3  # before, the two guides of a segment were one
    parameters = (
        Parameter("coefficient", "1", 0.0, 1.5, 0.1, "of friction between cable and guide"),
        shape(
            "pulley_wrap_rad",
            "rad",
            0.0,
            20.0,
            1.0,
            "wrap angle at the actuator's pulley",
            starts=(0.5,),
            trials=(0.0, 1.0),
        ),
        shape(
            "guide_wrap_rad",
            "rad",
            0.0,
            20.0,
            1.0,
            "wrap angle at the guides between two joints with the arm straight",
            trials=(0.0, 1.0),
        ),
        shape(
            "run_compliance",
            "1",
            0.01,
            100.0,
            1.0,
            "compliance of a cable before the pulley, over that behind it",
            0.5,
            starts=(0.5,),
        ),
        shape(
            "run_by_length",
            "1",
            0.0,
            1.0,
            0.5,
            "0: it is the same for every cable; 1: the longer the cable in the arm, the less",
            starts=(0.5,),
        ),
        shape(
            "give_m",
            "m",
            0.0,
            2e-3,
            2e-5,
            "of cable that passes a guide from rest to slip; zero sticks rigidly",
            trials=(0.0, 3e-5),
        ),
        shape(
            "rounding",
            "1",
            0.0,
            0.95,
            0.5,
            "of the way from rest to slip: Dahl's exponent; at zero it slips at once",
            trials=(0.5,),
        ),
    )

    def history(self, segment_count: int, cable_count: int) -> tuple[Parameter, ...]:
        share = "share of what its guides hold that the past left on"
        starts = (
            _start_share(f"start_{cable}", about=f"{share} {cable}")
            for cable in cables(cable_count)
        )
        return _WEIGHT_BORNE, *starts

    def transmission(self, place: str, values: Values) -> Transmission:
        return _Guides(values)


class _Guides(Transmission):
    """A node at the pulley and at each guide plate: before every joint, and behind it."""

    def __init__(self, values: Values) -> None:
        self._values = values

    def begin(self, mechanism: Mechanism, equilibrium: ArmEquilibrium) -> None:
        zeros = np.zeros_like(self._values["coefficient"])
        self._coefficient = self._values["coefficient"][:, None] * mechanism.relative_friction
        names = (f"start_{cable}" for cable in cables(mechanism.cable_count))
        start = np.stack([self._values.get(name, zeros) for name in names], axis=-1)
        compliance_m_n = self._pieces_m_n(mechanism)
        self._longer = compliance_m_n / compliance_m_n.sum(-1, keepdims=True)
        lengths_m, limit = self._at(equilibrium.spans_m, equilibrium.bends_rad)
        borne = self._values.get("weight_borne", zeros + 1.0)[:, None, None]
        if (borne < 1.0).any():
            lengths_m = (1.0 - borne) * self._weightless_m(mechanism) + borne * lengths_m
        from cablesense_sim.cable_chain import CableChains  # compiled: none without friction waits

        self._chains = CableChains(
            compliance_m_n,
            lengths_m,
            limit,
            np.broadcast_to(start[..., None], limit.shape),
            self._values["give_m"][:, None, None],
            self._values["rounding"][:, None, None],
        )

    def _weightless_m(self, mechanism: Mechanism) -> Array:
        """(P, M, 1 + 2N) lengths of the pieces in the straight arm without weight."""
        (y, z), (v, w) = mechanism.plate_holes_m
        apart_m = np.sqrt((2.0 * mechanism.plate_offset_m) ** 2 + (v - y) ** 2 + (w - z) ** 2)
        spans_m = apart_m * mechanism.passes_joint
        lengths_m = np.zeros_like(self._longer)
        lengths_m[..., 0] = mechanism.pretension_n / mechanism.stiffness_n_m - spans_m.sum(-1)
        lengths_m[..., 2::2] = spans_m
        return lengths_m

    def hold(self, slack_m: Array, longer_m: Array) -> None:
        self._slack_m = slack_m
        self._longer_m = longer_m

    def pull(self, spans_m: Array, bends_rad: Array) -> CablePull:
        tensions, slope = self._chains.pull(*self._at(spans_m, bends_rad))
        pieces = [0, *range(2, tensions.shape[-1], 2)]  # at the actuator, and across the joints
        return CablePull(tensions[..., pieces], slope[..., pieces, :][..., pieces])

    def settle(self, equilibrium: ArmEquilibrium) -> None:
        self._chains.settle(*self._at(equilibrium.spans_m, equilibrium.bends_rad))

    def _pieces_m_n(self, mechanism: Mechanism) -> Array:
        """(P, M, 1 + 2N) compliances, which add up to that of the cable and its actuator."""
        whole = 1.0 / mechanism.stiffness_n_m
        actuator = np.minimum(1.0 / mechanism.actuator_stiffness_n_m, whole)
        before = run_compliance(
            mechanism,
            self._values["run_compliance"][:, None],
            self._values["run_by_length"][:, None],
        )
        behind = (whole - actuator) / (1.0 + before)
        length = mechanism.piece_length_m
        pieces = behind[..., None] * length / length.sum(-1, keepdims=True)
        return np.concatenate([(whole - behind)[..., None], pieces], axis=-1)

    def _at(self, spans_m: Array, bends_rad: Array) -> tuple[Array, Array]:
        """(P, M, 1 + 2N) lengths of the pieces, m, and (P, M, 2N) μ θ of the nodes.

        Lengths count from where the whole cable is just slack; what creeps does so evenly.
        """
        from cablesense_sim.guides import along_guides  # compiled: late

        evenly = self._longer, self._longer_m
        wraps = self._values["pulley_wrap_rad"], self._values["guide_wrap_rad"]
        return along_guides(spans_m, bends_rad, self._slack_m, *evenly, self._coefficient, *wraps)


def run_compliance(mechanism: Mechanism, ratio: float | Array, by_length: float | Array) -> Array:
    """(..., M) compliances before the pulley over those behind it, of the numbers of an effect."""
    in_arm_m = np.cumsum(mechanism.segment_length_m)[mechanism.cable_segment - 1]
    return np.asarray(ratio * (in_arm_m.mean() / in_arm_m) ** by_length)


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
        shape(
            "give_rad",
            "rad",
            1e-5,
            0.05,
            1e-3,
            "turn from rest to breaking away",
            3e-4,
            starts=(3e-4,),
            trials=(1e-4, 1e-3),
        ),
        shape(
            "rounded",
            "1",
            0.0,
            1.0,
            0.5,
            "share of the contact that slips little by little",
            trials=(0.0, 1.0),
        ),
        _start_share("start_pitch", about="share of the torque at first, about y"),
        _start_share("start_yaw", about="share of the torque at first, about z"),
    )

    def transmission(self, place: str, values: Values) -> Transmission:
        return _DryJoints(place, values)


class _DryJoints(Transmission):
    """Axes that carry a share between -1 and 1 of their limit, and keep it at rest.

    A share moves with the joint until it slips. One part of the contact is sharp: it yields evenly
    over `give_rad` and then slips at once (Prandtl 1928). The other part is rounded: it approaches
    its limit as exp(-moved / presliding) (Dahl, as above).
    """

    def __init__(self, place: str, values: Values) -> None:
        self._place = place
        self._values = values
        self._give = values["give_rad"][:, None]
        self._rounded = values["rounded"][:, None]
        self._at: Array | None = None

    def begin(self, mechanism: Mechanism, equilibrium: ArmEquilibrium) -> None:
        affected = np.repeat(chosen(self._place, mechanism.segment_count), 2)
        self._limit_n_m = self._values["torque_n_m"][:, None] * affected
        start = np.stack([self._values["start_pitch"], self._values["start_yaw"]], axis=-1)
        self._sharp = np.tile(start, mechanism.segment_count)
        self._round = self._sharp

    def joint_torque_n_m(self, angles_rad: Array) -> tuple[Array, Array]:
        if self._at is None:  # it yields nothing until the first equilibrium is found
            return self._limit_n_m * self._sharp, np.zeros_like(angles_rad)
        sharp, round_, free, full = self._moved(angles_rad - self._at)
        round_slope = np.where(angles_rad == self._at, 1.0, np.abs(full - round_))
        even = 1.0 - self._rounded
        share = even * sharp + self._rounded * round_
        slope = (even * (np.abs(free) < 1.0) + self._rounded * round_slope) / self._give
        return self._limit_n_m * share, self._limit_n_m * slope

    def settle(self, equilibrium: ArmEquilibrium) -> None:
        if self._at is not None:
            self._sharp, self._round, *_ = self._moved(equilibrium.angles_rad - self._at)
        self._at = equilibrium.angles_rad

    def _moved(self, by_rad: Array) -> tuple[Array, Array, Array, Array]:
        moved = by_rad / self._give
        free = self._sharp + moved
        full = np.sign(moved)
        round_ = full - (full - self._round) * np.exp(-np.abs(moved))
        return np.clip(free, -1.0, 1.0), np.where(moved == 0.0, self._round, round_), free, full


class CableCreep(Effect):
    """A cable with three Kelvin-Voigt elements behind its spring, evenly spread in log time.

    Their retardation times are the middle one, and `spread` times shorter and longer; at a spread
    of one they are a single element. Together they yield by `share` of the elastic stretch. Before
    the first sample the arm stood as in it: what had settled did so under those tensions, weight
    and slack cables included, and not under the pretension.
    """

    name = "cable_creep"
    version = 2  # before, it settled under the pretension
    acts_on = "transmission"
    about = "cables that creep under load"
    source = "Findley, Lai and Onaran, Creep and Relaxation of Nonlinear Materials, 1976, ch. 5"
    sites = ("arm", "segment")
    advice = "Pre-stretch the cables, or tare again after every long hold."
    needs_time = True
    parameters = (
        Parameter("share", "1", 0.0, 5.0, 0.1, "of the elastic stretch that creep adds"),
        shape(
            "time_s", "s", 0.5, 3000.0, 20.0, "retardation time", 20.0, starts=(5.0, 20.0, 80.0)
        ),
        shape("spread", "1", 1.0, 30.0, 3.0, "between neighbouring times", 1.0, starts=(1.0,)),
        shape(
            "settled",
            "1",
            -1.0,
            1.0,
            0.5,
            "share of the creep under the first tensions that was over before the tensioning",
            starts=(0.5,),
        ),
        shape(
            "begun",
            "1",
            0.0,
            1.0,
            0.5,
            "share of the creep to come that was over before the first sample",
            starts=(0.5,),
            past=True,
        ),
    )

    def transmission(self, place: str, values: Values) -> Transmission:
        return _Creep(place, values)


class _Creep(Transmission):
    def __init__(self, place: str, values: Values) -> None:
        self._place = place
        self._share = values["share"][:, None]
        spread = values["spread"][:, None] ** np.array([-1.0, 0.0, 1.0])
        self._times_s = (values["time_s"][:, None] * spread)[:, None, :]
        self._settled = values["settled"][:, None]
        self._begun = values["begun"][:, None]

    def begin(self, mechanism: Mechanism, equilibrium: ArmEquilibrium) -> None:
        affected = own_cables(self._place, mechanism)
        self._compliance_m_n = self._share * affected / mechanism.stiffness_n_m
        self._reference_n = self._settled * equilibrium.tensions_n
        target = self._compliance_m_n * (equilibrium.tensions_n - self._reference_n)
        self._parts_m = np.repeat((self._begun * target)[..., None] / 3.0, 3, axis=-1)
        self._equilibrium = equilibrium

    def lengthening_m(self, time_s: float) -> Array:
        """Each element follows the load of the last equilibrium: the next one is not known yet."""
        return np.asarray(self._parts_at(time_s, self._equilibrium.tensions_n).sum(-1))

    def settle(self, equilibrium: ArmEquilibrium) -> None:
        self._parts_m = self._parts_at(equilibrium.time_s, equilibrium.tensions_n)
        self._equilibrium = equilibrium

    def _parts_at(self, time_s: float, tensions_n: Array) -> Array:
        """Each element follows its share of a tension that changes evenly to `tensions_n`."""
        periods = max(time_s - self._equilibrium.time_s, 0.0) / self._times_s
        done = -np.expm1(-periods)
        on_average = np.divide(done, periods, out=np.ones_like(done), where=periods > 0.0)
        before, after = (
            (self._compliance_m_n * (n - self._reference_n) / 3.0)[..., None]
            for n in (self._equilibrium.tensions_n, tensions_n)
        )
        late = (after - before) * (1.0 - on_average)
        return np.asarray(self._parts_m + done * (before - self._parts_m) + late)
