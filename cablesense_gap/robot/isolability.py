"""Which effects a planned motion can tell apart, before anything is recorded.

The model's torques (or positions) along the plan, with the noise of usual sensors, are prepared as
a recording would be, so rows that do not count, floors, tolerances and candidates are those of the
diagnosis. To first order, an effect `a` changes the channels by s, in floors. What another effect
`b` and the tolerances t leave of that is

    r² = |s - B b - N t|² / (Q C)    where    w |s - B b - N t|² + |P b|² + |t|² is least

with B and N the derivatives at Q rows of C channels, P the priors of b, and w the weight of a
residual of r. `a` and `b` are told apart if a verdict on a recording with `a` would not have `b`
in its ambiguity group: by the formula of the probabilities, with the residuals √(1 + r²) and 1.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cablesense_base import Array, CableSenseError, some_of
from cablesense_gap.diagnosis.linear_fit import products, weight
from cablesense_gap.diagnosis.probability import NEAR_BEST, Fits, bundled_calibration, log_weights
from cablesense_gap.diagnosis.problem import Problem
from cablesense_gap.diagnosis.selection import LinearEffect, linear_effects
from cablesense_gap.robot.inverse import Servos
from cablesense_gap.robot.model import Robot, actuated, inverse_dynamics
from cablesense_gap.robot.motion import derivatives, smoothed
from cablesense_gap.robot.preparation import prepared
from cablesense_gap.robot.protocol import RATE_HZ, RobotBlock, further_blocks, standard_protocol
from cablesense_gap.robot.recording import RobotRecording
from cablesense_gap.robot.system import RobotSystem
from cablesense_gap.system import problem_of
from cablesense_recording.recording import RecordingError

Channels = Literal["torques", "commands", "external"]
CHANNELS: Final[tuple[Channels, ...]] = ("torques", "commands", "external")
"""Torques of the drives; commands of the actuators alone; positions from outside the drives."""
_TORQUE_NOISE = 0.005
"""Standard deviation of one sample of a torque, as a share of the joint's torque, RMS."""
_ENCODER_RAD = 1e-4
_CAMERA_RAD = 1e-3
_ENCODER_M = 1e-5
_CAMERA_M = 1e-4
"""Standard deviation of one position of an encoder, and of a camera."""
_PATH_HZ = 10.0
"""Bandwidth of the planned motion: where blocks begin it has steps of speed."""
_PLAIN_TIMES = 3.0
"""Times the size from which an effect is named, at which it is compared with others."""
_SIZES = np.geomspace(0.02, 300.0, 40)
"""In typical ones, that are tried."""
CONFUSED = NEAR_BEST / (1.0 + NEAR_BEST)
"""Share of another effect, of two, from which on a verdict has both in its group."""
_MOST_ODDS = 700.0
"""Of logarithms of odds: farther ones have no exponential."""
_WEIGHTINGS = 3
"""Solutions of one fit, each at the weight of what the last one left."""
_MOST_BLOCKS = 3
"""Blocks that are proposed for a question."""
_REPETITIONS = 5.0
"""How often each of these is recorded: trials are held out in five folds."""
_WORTH_FACTOR = 1.1
"""Factor by which a block must raise the least difference to be proposed."""


class Site(NamedTuple):
    """An effect in one place."""

    effect: str
    place: str


@dataclass(frozen=True)
class Isolability:
    """What a motion shows of each effect in each place, and which others imitate it.

    Attributes:
        sites: effects with their places, S.
        effects: names, E.
        units: of the first number of each site.
        named_from: (S,) of that number, the size from which a verdict names the effect rather than
            none; infinite where none within its range does.
        shown: (S,) floors by which the effect changes the channels beyond what tolerances imitate.
        share: (S, E) probability of each other effect, in its best place, where a verdict weighs
            it against the true one; a half if nothing tells them apart.
        seen: (S,) whether a verdict would name the effect rather than none.
        compared: how they are compared, as a sentence.
    """

    sites: tuple[Site, ...]
    effects: tuple[str, ...]
    units: tuple[str, ...]
    named_from: Array
    shown: Array
    share: Array
    seen: NDArray[np.bool_]
    compared: str

    def imitators(self, site: int) -> tuple[str, ...]:
        """Effects that a verdict could name instead of one, the most alike first."""
        order = np.argsort(-self.share[site])
        site_effect = self.sites[site].effect
        return tuple(
            self.effects[e]
            for e in order.tolist()
            if self.share[site, e] >= CONFUSED and self.effects[e] != site_effect
        )

    def worst(self) -> Array:
        """(E, E) the largest share of another effect, over places of the true one; NaN of itself.

        Places at which a verdict would name none do not count.
        """
        table = np.full((len(self.effects), len(self.effects)), np.nan)
        for k, rows in enumerate(self._named_rows()):
            if len(rows):
                table[k] = self.share[rows].max(axis=0)
            table[k, k] = np.nan
        return table

    def may_confuse(self, effect: str, other: str) -> bool:
        """Whether a verdict on either effect may have the other in its group, in some place.

        So it may where it would name one of them nowhere.
        """
        table = self.worst()
        a = self.effects.index(effect)
        b = self.effects.index(other)
        return not (table[a, b] < CONFUSED and table[b, a] < CONFUSED)

    def _named_rows(self) -> list[NDArray[np.int64]]:
        """By effect, the numbers of the sites at which a verdict would name it."""
        named = np.isfinite(self.named_from)
        of_effect = np.array([site.effect for site in self.sites])
        return [np.flatnonzero(named & (of_effect == effect)) for effect in self.effects]


def planned(robot: Robot, blocks: Sequence[RobotBlock], channels: Channels) -> RobotSystem:
    """The robot on a recording of a plan that nothing has changed, with the noise of sensors.

    Raises:
        RecordingError: the model lacks what the channels need: motors or position servos.
    """
    rng = np.random.default_rng(0)
    external = channels == "external"
    hinge = np.array([unit == "rad" for unit in robot.position_units])
    encoder = np.where(hinge, _ENCODER_RAD, _ENCODER_M)
    noise = np.where(hinge, _CAMERA_RAD, _CAMERA_M) if external else encoder
    positions = []
    torques = []
    commands = []
    for block in blocks:
        path = smoothed(block.position, RATE_HZ, _PATH_HZ)
        speed, acceleration = derivatives(path, RATE_HZ)
        torque = inverse_dynamics(robot.model, path, speed, acceleration)
        positions.append(path)
        torques.append(torque)
        if external:
            commands.append(_servo_commands(robot, path, speed, torque))
        elif channels == "commands":
            commands.append(_motor_commands(robot, path, speed, torque))
    position = np.concatenate(positions)
    torque = np.concatenate(torques)
    size = np.sqrt((torque**2).mean(axis=0))
    torque_noise = _TORQUE_NOISE * np.maximum(size, 1e-3 * size.max() + 1e-9)
    trial = np.repeat(np.arange(len(blocks)), [len(block.position) for block in blocks])
    measured = channels == "torques"
    command = np.full((len(position), robot.model.nu), np.nan)
    read_torque = np.full_like(torque, np.nan)
    if measured:
        read_torque = torque + torque_noise * rng.standard_normal(torque.shape)
    else:
        command = np.concatenate(commands)
    recording = RobotRecording(
        name=f"plan of {robot.name}",
        time_s=np.arange(len(position)) / RATE_HZ,
        trial=trial,
        position=position + noise * rng.standard_normal(position.shape),
        torque=read_torque,
        command=command,
    )
    return RobotSystem(robot, prepared(recording, robot, external=external), {})


def _servo_commands(robot: Robot, position: Array, speed: Array, torque: Array) -> Array:
    """(T, U) commands under which position servos follow a path that takes these torques."""
    servos = Servos.of(robot)
    target = position + (torque + servos.damping * speed) / servos.stiffness
    command = np.zeros((len(position), robot.model.nu))
    command[:, robot.servo_controls] = (target - servos.offset) / servos.per_command
    return command


def _motor_commands(robot: Robot, position: Array, speed: Array, torque: Array) -> Array:
    """(T, U) the smallest commands under which the actuators give these torques.

    Raises:
        RecordingError: the actuators cannot give them.
    """
    controls = robot.model.nu
    if not controls:
        raise RecordingError(
            f"{robot.path.name}: has no actuators; commands cannot be recorded of it: plan for "
            "torques"
        )
    still = actuated(robot, position, speed, np.zeros((len(position), controls)))
    by_control = []
    for control in np.eye(controls):
        commanded = np.tile(control, (len(position), 1))
        by_control.append(actuated(robot, position, speed, commanded) - still)
    gains = np.moveaxis(np.array(by_control), 0, -1)
    command = (np.linalg.pinv(gains) @ (torque - still)[..., None])[..., 0]
    given = (gains @ command[..., None])[..., 0] + still
    if not np.allclose(given, torque, atol=1e-3 * float(np.abs(torque).max()) + 1e-9):
        raise RecordingError(
            f"{robot.path.name}: its actuators cannot give the torques of the planned motion "
            "within their ranges; plan for torques"
        )
    return np.asarray(command)


def isolability(system: RobotSystem, sizes: Mapping[Site, float] | None = None) -> Isolability:
    """What the motion of a system tells apart.

    Each effect is judged at three times the size from which a verdict names it, within its range.
    `sizes` are other sizes by effect and place, in typical ones; only these are then judged.
    """
    columns = _Columns.of(system, [c.effect for c in system.candidates])
    compared = _Compared(columns, np.ones(len(columns.gram)))
    parameters = columns.problem.parameters
    offered = columns.offered
    judged = list(range(len(offered)))
    if sizes is not None:
        judged = [k for k in judged if Site(offered[k].effect, offered[k].place) in sizes]
    effects = tuple(dict.fromkeys(e.effect for e in offered))
    sites = tuple(Site(offered[k].effect, offered[k].place) for k in judged)
    first = [parameters[offered[k].varied[0]] for k in judged]
    shape = (len(judged), len(effects))
    share = np.zeros(shape)
    shown = np.zeros(len(judged))
    named_from = np.full(len(judged), np.inf)
    seen = np.zeros(len(judged), dtype=bool)
    for row, k in enumerate(judged):
        most = first[row].high / first[row].typical
        least = compared.least_named(k, most)
        size = min(_PLAIN_TIMES * least, most) if sizes is None else sizes[sites[row]]
        alone = compared.left(k, None, size)
        named_from[row] = least * first[row].typical
        shown[row] = alone.floors
        seen[row] = compared.share_of_rival(k, alone) < CONFUSED
        for column, effect in enumerate(effects):
            rivals = [n for n, other in enumerate(offered) if other.effect == effect and n != k]
            if rivals:
                fits = [compared.left(k, n, size) for n in rivals]
                nearest = min(range(len(fits)), key=lambda n: fits[n].cost)
                rival = fits[nearest], rivals[nearest]
                share[row, column] = compared.share_of_rival(k, alone, rival)
    return Isolability(
        sites=sites,
        effects=effects,
        units=tuple(parameter.unit for parameter in first),
        named_from=named_from,
        shown=shown,
        share=share,
        seen=seen,
        compared=system.compared,
    )


class _Left(NamedTuple):
    """What a fit leaves of an effect: RMS in floors, χ² of the tolerances, and their sum."""

    floors: float
    chi2: float
    cost: float


@dataclass(frozen=True)
class _Columns:
    """Derivatives by effects and tolerances, as products.

    Attributes:
        offered: effects in all their places.
        gram: (T, K, K) of the tolerances' and all effects' columns, by trial.
        count: (T,) readings of each trial.
    """

    problem: Problem
    offered: tuple[LinearEffect, ...]
    gram: Array
    count: Array

    @staticmethod
    def of(system: RobotSystem, effects: Sequence[str]) -> _Columns:
        """Those of some effects of a system."""
        problem = problem_of(system)
        candidates = [c for c in system.candidates if c.effect in effects]
        offered = tuple(e for c in candidates for e in linear_effects(problem, c))
        columns = [problem.nuisance_columns, *(effect.columns for effect in offered)]
        nothing = np.zeros_like(problem.nominal)
        made = products(np.concatenate(columns), nothing, problem.trial, problem.used)
        return _Columns(problem, offered, made.gram, made.count)


class _Compared:
    """Fits of effects by each other and by tolerances, on trials that are recorded so often."""

    def __init__(self, columns: _Columns, times: Array) -> None:
        """Each of the T trials is recorded `times` (T,) times."""
        self._problem = columns.problem
        self._offered = columns.offered
        self._gram = np.tensordot(times, columns.gram, axes=1)
        self._count = float(times @ columns.count)
        self._nuisance = np.arange(len(columns.problem.nuisance_columns))
        lengths = [len(effect.columns) for effect in columns.offered]
        ends = len(self._nuisance) + np.cumsum(lengths, dtype=np.int64)
        self._owned = [
            np.arange(end - length, end) for end, length in zip(ends, lengths, strict=True)
        ]
        of_effects = [effect.precision for effect in columns.offered]
        self._precision = np.concatenate([np.ones(len(self._nuisance)), *of_effects])

    def places_of(self, effect: str) -> list[int]:
        """Numbers of the offered ones of an effect."""
        return [k for k, offered in enumerate(self._offered) if offered.effect == effect]

    def left(self, k: int, rival: int | None, size: float) -> _Left:
        """What tolerances, and a rival with free numbers, leave of one effect."""
        effect_columns = self._owned[k]
        values = size * self._is_size(k).astype(float)
        fitted = self._nuisance
        if rival is not None:
            fitted = np.concatenate([fitted, self._owned[rival]])
        square = float(values @ self._gram[np.ix_(effect_columns, effect_columns)] @ values)
        moment = self._gram[np.ix_(fitted, effect_columns)] @ values
        gram = self._gram[np.ix_(fitted, fitted)]
        floor = self._problem.floor
        mean_square = floor**2
        solution = np.zeros(len(fitted))
        remaining = square
        for _ in range(_WEIGHTINGS):
            weight_ = weight(mean_square, floor)
            whole = weight_ * gram + np.diag(self._precision[fitted])
            solution = np.linalg.solve(whole, weight_ * moment)
            remaining = square - 2.0 * moment @ solution + solution @ gram @ solution
            mean_square = floor**2 + max(remaining, 0.0) / self._count
        chi2 = float((solution[: len(self._nuisance)] ** 2).sum())
        floors = float(np.sqrt(max(remaining, 0.0) / self._count)) / floor
        return _Left(floors, chi2, float(weight_ * max(remaining, 0.0)) + chi2)

    def least_named(self, k: int, most: float) -> float:
        """The size, in typical ones, from which a verdict names an effect, or infinity."""
        for size in _SIZES[most >= _SIZES].tolist():
            if self.share_of_rival(k, self.left(k, None, size)) < CONFUSED:
                return float(size)
        named = self.share_of_rival(k, self.left(k, None, most)) < CONFUSED
        return float(most) if named else np.inf

    def share_of_rival(
        self, k: int, alone: _Left, rival: tuple[_Left, int] | None = None
    ) -> float:
        """Probability of a rival, by default of none, where it is weighed against the true effect.

        `alone` is what tolerances leave of the effect; the rival is what it leaves, and its
        number.
        """
        floor = self._problem.floor
        rest = alone
        rival_sizes = 0
        if rival is not None:
            rest = rival[0]
            rival_sizes = self._size_count(rival[1])
        residuals = floor * np.hypot(1.0, [alone.floors, 0.0, rest.floors])
        fits = Fits(
            held_out_rmse=residuals,
            effects=np.array([0, 1, 1]),
            sizes=np.array([0, self._size_count(k), rival_sizes]),
            nuisance_chi2=np.array([alone.chi2, 0.0, rest.chi2]),
            nuisance_count=len(self._nuisance),
        )
        weights = log_weights(fits, floor, bundled_calibration())
        against = weights[0] if rival is None else weights[2]
        return float(1.0 / (1.0 + np.exp(np.clip(weights[1] - against, -_MOST_ODDS, _MOST_ODDS))))

    def _size_count(self, k: int) -> int:
        return int(self._is_size(k).sum())

    def _is_size(self, k: int) -> NDArray[np.bool_]:
        roles = [self._problem.parameters[term].role for term in self._offered[k].varied]
        return np.array([role == "size" for role in roles], dtype=bool)


def blocks_that_part(
    robot: Robot, pair: tuple[str, str], channels: Channels = "torques"
) -> list[RobotBlock]:
    """Blocks to record for a question, each several times: there two effects differ most.

    Of the protocol's blocks and of others, one after the other is added that raises most what is
    left of either effect beyond the other, at their most alike places.

    Raises:
        CableSenseError: an effect is unknown, or shows in no channel.
    """
    offered = [*standard_protocol(robot), *further_blocks(robot)]
    system = planned(robot, offered, channels)
    known = [candidate.effect for candidate in system.candidates]
    unknown = [effect for effect in pair if effect not in known]
    if unknown:
        raise CableSenseError(
            f"{some_of(unknown)}: no effect of {robot.name} that these channels show; known are "
            f"{', '.join(known)}"
        )
    columns = _Columns.of(system, pair)
    times = np.zeros(len(columns.gram))
    chosen: list[RobotBlock] = []
    difference = -1.0
    while len(chosen) < _MOST_BLOCKS:
        added = times + _REPETITIONS * np.eye(len(times))
        differences = [_least_difference(_Compared(columns, each), pair) for each in added]
        best = int(np.argmax(differences))
        if differences[best] < _WORTH_FACTOR * difference:
            break
        difference = differences[best]
        times = added[best]
        chosen.append(offered[best])
    return chosen


def _least_difference(compared: _Compared, pair: tuple[str, str]) -> float:
    """Floors that are left of either effect beyond the other, at their most alike places."""
    left = []
    for effect, other in (pair, pair[::-1]):
        for k in compared.places_of(effect):
            fits = [compared.left(k, n, 1.0) for n in compared.places_of(other)]
            left.append(min(fits, key=lambda fit: fit.cost).floors)
    return min(left, default=0.0)
