"""Statics on joint torques that a recurrent network has cleared of motion and friction.

In motion, torques by statics include inertia. With friction each cable's tension along the arm
differs from that at its actuator, by a factor that depends on the past (equation (2) of the
paper). A gated recurrent unit (Cho et al., Learning phrase representations using RNN
encoder-decoder, 2014) estimates the factors, further offsets, and their deviations.

A stop operator follows the cable that is drawn, in units of its give, and stops at -1 and 1
(Visintin, Differential Models of Hysteresis, 1994, chapter III): the share of its largest friction
that a guide holds where only the drawing moves the cable.
"""

from __future__ import annotations

import math
from typing import ClassVar, NamedTuple

import torch
from torch import Tensor, nn

from cablesense_sim.arm import Arm
from cablesense_training.inference.estimator import NORMAL_95
from cablesense_training.inference.temporal_estimator import TemporalState
from cablesense_training.networks.closed_form import Balance, ClosedForm, inverse
from cablesense_training.networks.layers import SingleContactOutput, Standardiser, contact_of
from cablesense_training.networks.statics import statics

GIVES_M = (2e-5, 2e-4, 2e-3)
"""Lengths of cable drawn from the middle of a stop operator to its end."""

LARGEST_CORRECTION = 6.0
"""In standard deviations of the correction in training, joint by joint."""

LARGEST_LOG_FACTOR = 0.5
"""Bound on the logarithm of a cable's factor: friction beyond it is beyond this correction."""

LARGEST_OFFSET = 4.0
"""Bound on a cable's offset, in standard deviations of its tension differences in training."""

_LOG_STD_RANGE = (-7.0, 3.0)

_STATED_WIDTH = 32
_STILL_RAD_S = 1e-3
"""A set-point slower than this counts as at rest for the stated interval."""
_LARGEST_SIZE = math.asinh(1e6)

_PER_RAD = 10.0
"""Brings set-points to the size of the shares."""


class DrawnCables:
    """Follows set-points; `past` is the layout of a `TemporalState` without its recurrent part."""

    def __init__(self, cables: int, joints: int) -> None:
        self.past = TemporalState(0, cables * len(GIVES_M), cables, joints)
        self._parts = self.past.parts[1:]
        self.seen_size = 2 * self.past.shares + joints

    def follow(self, past: Tensor, lengths_m: Tensor, set_point_rad: Tensor) -> Tensor:
        """The past (B, size) one tick later, at cable lengths (B, M) and a set-point (B, 2N)."""
        shares, lengths, _, shares_tared, set_point_tared, known = past.split(self._parts, dim=-1)
        drawn = (lengths_m - lengths) * known
        gives = lengths_m.new_tensor(GIVES_M)
        shares = (shares + (drawn[..., None] / gives).flatten(-2)).clamp(-1.0, 1.0)
        now_known = 0.0 * known + 1.0  # the exporter takes ones_like for one row
        return torch.cat(
            [shares, lengths_m, set_point_rad, shares_tared, set_point_tared, now_known], dim=-1
        )

    def seen(self, past: Tensor) -> Tensor:
        """The network's view of a past: shares now and at the tare, set-point at the tare."""
        shares, _, _, shares_tared, set_point_tared, _ = past.split(self._parts, dim=-1)
        return torch.cat([shares, shares_tared, _PER_RAD * set_point_tared], dim=-1)


class Ticks(NamedTuple):
    """Inputs of one or more ticks, as `Sequences` has them: (…, M), and three times (…, 2N)."""

    tension_difference_n: Tensor
    joint_command_rad: Tensor
    joint_speed_rad_s: Tensor
    joint_acceleration_rad_s2: Tensor


class CorrectedAnswer(NamedTuple):
    """Answers for B ticks.

    Attributes:
        seen: (B, features) that `StatedInterval` sees.
        force_n: (B, N, 2) y and z components of the contact that each segment would have.
        torque_n_m, torque_std_n_m: (B, 2N) of the environment as corrected, and its deviation.
    """

    output: SingleContactOutput
    seen: Tensor
    force_n: Tensor
    torque_n_m: Tensor
    torque_std_n_m: Tensor


class Statement(NamedTuple):
    """Of B answers: logit of none, ends of the force, asinh N, deviation of its angle, log deg."""

    none_logit: Tensor
    low: Tensor
    high: Tensor
    log_angle_std: Tensor


class StatedInterval(nn.Module):
    """The statement about an answer: whether it is a contact, and where its force lies.

    Friction makes errors lopsided: a load that falls is read late, one that rises is not. After
    the network is trained, this head is fitted to the errors on held-out data. It sees the answer
    alone: with the network's memory as input it would be too certain. Forces are counted by their
    inverse hyperbolic sine: in newtons below one newton, by their ratios above it.

    Attributes:
        shift: (3,) by which low end, high end and the angle's deviation are moved outwards
            (Romano, Patterson and Candès, Conformalized Quantile Regression, 2019).
        surely: probability of no contact below which the low end is above nothing.
    """

    def __init__(self, segments: int) -> None:
        super().__init__()
        self.shift = nn.Buffer(torch.zeros(3))
        self.surely = nn.Buffer(torch.tensor(0.025))
        seen = 2 * segments + 4
        self.seen = Standardiser(seen)
        last = nn.Linear(_STATED_WIDTH, 4)
        self.heads = nn.Sequential(nn.Linear(seen, _STATED_WIDTH), nn.SiLU(), last)
        nn.init.zeros_(last.weight)
        nn.init.zeros_(last.bias)

    def forward(self, seen: Tensor, output: SingleContactOutput) -> Statement:
        """The statement about B answers, whose features (B, features) are `seen`."""
        none, low, high, wider = self.heads(self.seen(seen)).double().unbind(-1)
        size, sure = _asinh(output.magnitude_n), torch.log(output.angle_std_deg)
        ends = size - low - self.shift[0], size + high + self.shift[1]
        contacts = output.contact_logits[:, 1:]
        evidence = contacts[:, 0] - torch.log_softmax(contacts, dim=-1)[:, 0]
        odds = _asinh(output.contact_logits[:, 0] - evidence)
        return Statement(none + odds, *ends, sure + wider + self.shift[2])

    def stated(
        self, seen: Tensor, output: SingleContactOutput
    ) -> tuple[SingleContactOutput, Tensor]:
        """The answers as stated, and the intervals (B, 2) of the forces.

        From 0 on where there may be none; up to what may act unseen.
        """
        none, low, high, log_angle_std = self(seen, output)
        nothing = torch.zeros_like(low)
        low_n = torch.minimum(_sinh(low.clamp(0.0, _LARGEST_SIZE)), output.magnitude_n)
        low_n = low_n.where(torch.sigmoid(none) < self.surely, nothing)
        high_n = _sinh(high.clamp(0.0, _LARGEST_SIZE))
        high_n = torch.maximum(high_n, output.magnitude_n.where(low_n > 0.0, nothing))
        among = torch.log_softmax(output.contact_logits[:, 1:], dim=-1)
        stated = output._replace(
            contact_logits=torch.cat([none[:, None], among], dim=-1),
            magnitude_std_n=(high_n - low_n) / (2.0 * NORMAL_95),
            angle_std_deg=torch.exp(log_angle_std.clamp(max=_LARGEST_SIZE)),
        )
        return stated, torch.stack([low_n, high_n], dim=-1)


class TemporalNetwork(nn.Module):
    """One contact from a sequence of ticks, by the closed form of an arm.

    Attributes:
        hidden: size of the recurrent unit's state.
        memory: size of the whole state that is carried from tick to tick.
    """

    several: ClassVar[bool] = False
    pose_aware: ClassVar[bool] = True

    def __init__(self, closed_form: ClosedForm, hidden: int = 96) -> None:
        super().__init__()
        cables = closed_form.kinematics.cable_count
        segments = closed_form.kinematics.segment_count
        joints = 2 * segments
        self.cable_count, self.segment_count = cables, segments
        self.drawn = DrawnCables(cables, joints)
        self.hidden, self.memory = hidden, hidden + self.drawn.past.size
        self.closed_form = closed_form
        self.torque = Standardiser(joints)
        self.tension = Standardiser(cables)
        self.course = Standardiser(3 * joints)
        self.error = Standardiser(joints)
        seen = 4 * joints + cables + self.drawn.seen_size
        self.encoder = nn.Sequential(nn.Linear(seen, hidden), nn.SiLU())
        self.cell = nn.GRU(hidden, hidden, batch_first=True)
        self.reader = nn.Sequential(nn.Linear(2 * hidden, hidden), nn.SiLU())
        self.shift = nn.Linear(hidden, joints)
        self.factor = nn.Linear(hidden, cables)
        self.offset = nn.Linear(hidden, cables)
        self.log_std = nn.Linear(hidden, joints)
        self.belief = nn.Linear(hidden, segments)
        for head in (self.shift, self.factor, self.offset, self.log_std, self.belief):
            nn.init.zeros_(head.weight)
            nn.init.zeros_(head.bias)
        self.log_trust = nn.Parameter(torch.zeros(()))
        self.interval = StatedInterval(segments)

    @classmethod
    def for_arm(cls, arm: Arm, tare_samples: int = 50) -> TemporalNetwork:
        """The network of an arm, its sensors, and a tare averaged over `tare_samples` readings."""
        return cls(statics(arm, tare_samples, exact=True, unexplained_n2=0.0))

    def adapt(self, torque_n_m: Tensor, ticks: Ticks, error_n_m: Tensor) -> None:
        """Set all scales from training rows: torques, inputs, and what the torques are off by."""
        self.torque.adapt(torque_n_m)
        self.tension.adapt(ticks.tension_difference_n)
        self.course.adapt(torch.cat(ticks[1:], dim=-1))
        self.error.adapt(error_n_m)

    def balance(self, ticks: Ticks) -> Balance:
        """Statics at the set-points of flat ticks, in float64."""
        return self.closed_form(
            ticks.tension_difference_n.double(), ticks.joint_command_rad.double()
        )

    def encode(self, torque_n_m: Tensor, past: Tensor, ticks: Ticks) -> Tensor:
        """(…, hidden) of torques (…, 2N), the past (…, size) of commands, and ticks alike."""
        seen = [
            self.torque(torque_n_m),
            self.drawn.seen(past),
            self.tension(ticks.tension_difference_n),
            self.course(torch.cat(ticks[1:], dim=-1)),
        ]
        return self.encoder(torch.cat(seen, dim=-1))

    def remember(self, encoded: Tensor, state: Tensor) -> tuple[Tensor, Tensor]:
        """States (S, T, hidden) along T ticks from a state (S, hidden), and the last of them."""
        states, last = self.cell(encoded, state[None])
        return states, last[0]

    def next_state(self, encoded: Tensor, state: Tensor) -> Tensor:
        """What `remember` does, for one tick of B rows and in operators that any runtime has."""
        weights_in, weights_kept, bias_in, bias_kept = self.cell.all_weights[0]
        given = encoded @ weights_in.T + bias_in
        kept = state @ weights_kept.T + bias_kept
        reset_in, update_in, new_in = given.chunk(3, dim=-1)
        reset_kept, update_kept, new_kept = kept.chunk(3, dim=-1)
        reset = torch.sigmoid(reset_in + reset_kept)
        update = torch.sigmoid(update_in + update_kept)
        new = torch.tanh(new_in + reset * new_kept)
        return (1.0 - update) * new + update * state

    def answer(
        self, balance: Balance, encoded: Tensor, states: Tensor, speed_rad_s: Tensor
    ) -> CorrectedAnswer:
        """Answers for B flat ticks, from encoded and remembered features (B, hidden).

        `speed_rad_s` (B, 2N) is that of the set-point.
        """
        speed = torch.sqrt((speed_rad_s * speed_rad_s).sum(-1)).to(balance.tension_n.dtype)
        read = self.reader(torch.cat([encoded, states], dim=-1))
        bounded = LARGEST_CORRECTION * torch.tanh(self.shift(read) / LARGEST_CORRECTION)
        shift = (bounded * self.error.std + self.error.mean).double()
        std = torch.exp(self.log_std(read).clamp(*_LOG_STD_RANGE)).double()
        std = std * self.error.std.double()
        factor = LARGEST_LOG_FACTOR * torch.tanh(self.factor(read) / LARGEST_LOG_FACTOR)
        lost = balance.tension_n * (torch.exp(factor.double()) - 1.0)
        offset = LARGEST_OFFSET * torch.tanh(self.offset(read) / LARGEST_OFFSET)
        lost = lost + (offset * self.tension.std).double()
        torque = balance.torque_n_m - shift + (balance.jacobian_t_m @ lost[..., None])[..., 0]
        precision = inverse(inverse(balance.precision) + torch.diag_embed(std * std))
        candidates = self.closed_form.candidates(
            balance._replace(torque_n_m=torque, precision=precision)
        )
        evidence = candidates.log_evidence(torch.exp(self.log_trust)) + self.belief(read)
        found = candidates.likeliest(evidence)
        output = contact_of(evidence, found.force_n, found.std_n)
        seen = [
            torch.softmax(output.contact_logits, dim=-1),
            _asinh(torch.linalg.vector_norm(candidates.force_n, dim=-1)),
            torch.log(torch.cat([found.std_n, speed[:, None] + _STILL_RAD_S], dim=-1)),
        ]
        seen_of = torch.cat([part.to(read.dtype) for part in seen], dim=-1).detach()
        return CorrectedAnswer(output, seen_of, candidates.force_n, torque, std)

    def forward(self, ticks: Ticks, state: Tensor) -> tuple[SingleContactOutput, Tensor, Tensor]:
        """Answers for one tick of B rows with states (B, memory), next states, and intervals."""
        balance = self.balance(ticks)
        kind = self.log_trust.dtype
        before, past = state.split([self.hidden, self.drawn.past.size], dim=-1)
        inputs = Ticks(*(part.to(kind) for part in ticks))
        past = self.drawn.follow(past, balance.commanded_m.to(kind), inputs.joint_command_rad)
        encoded = self.encode(balance.torque_n_m.to(kind), past, inputs)
        following = self.next_state(encoded, before)
        answer = self.answer(balance, encoded, following, ticks.joint_speed_rad_s)
        stated, interval_n = self.interval.stated(answer.seen, answer.output)
        return stated, torch.cat([following, past], dim=-1), interval_n


def _asinh(values: Tensor) -> Tensor:
    """In operators that ONNX Runtime has for float64."""
    size = values.abs()
    return torch.sign(values) * torch.log(size + torch.sqrt(size * size + 1.0))


def _sinh(values: Tensor) -> Tensor:
    return 0.5 * (torch.exp(values) - torch.exp(-values))
