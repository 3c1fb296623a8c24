"""What the efforts and positions of a recording are: their unit, and whether they have gravity.

Each interpretation of a joint's effort is one hypothesis of a linear regression on the parts of
the model's torque,

    effort = b_d (inertia and Coriolis) + b_g gravity + friction + damping + rotor + zero + noise,

in which the interpretation says where b_d and b_g are: both near 1 for torque, near 1000 for
torque in mN·m, b_g near 0 for torque without gravity, both near the same unknown number for a
current. How near is what models of real machines leave. Positions in degrees and times in
milliseconds change the model's torque instead. All other coefficients, and the size of the noise,
are as wide for every hypothesis, so the posterior follows from b_d and b_g alone: where a motion
does not show them, nothing is stated. One hypothesis is that the efforts are torques of a machine
that has what no model knows: a spring, which looks like inertia of the other sign in a sine, and
friction that depends on the place.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Final, NamedTuple

import numpy as np
from scipy.special import logsumexp

from cablesense_base import Array, some_of
from cablesense_gap.robot.model import Robot, gravity_torque, inverse_dynamics
from cablesense_gap.robot.motion import Motion
from cablesense_recording.units import OTHER_TIME_UNITS

SURE: Final = 0.99
"""Posterior probability from which on an interpretation other than the stated one is told."""

_MODEL_SHARE = 0.2
"""Standard deviation of b_d and b_g about those of an interpretation: link masses of models."""
_LEFT_GRAVITY = 0.15
"""That of b_g where a drive takes gravity out, by its own masses."""
_EFFECT_SHARE = 3.0
"""That of b_d and b_g where anything else changes the machine: springs, a base upside down."""
_EFFECTS = np.geomspace(0.3, 10.0, 8)
"""Factors of inertia and of gravity by effects as payloads, each pair as likely."""
_NUISANCE_SHARE = 3.0
"""That of friction, damping and zero, in the size of the effort; of a rotor, in the model's."""
_NOISES = np.geomspace(0.003, 1.5, 12)
"""Noise and model error, each as likely, as shares of the effort."""
_GAINS = np.geomspace(1e-4, 1e4, 75)
"""Gains of an unknown unit, each as likely: steps of a fourth, within the model's share."""
_ROWS_A_SAMPLE = 3.0
"""Rows are three in a period of the bandwidth, and a model's error changes no faster."""
_ORDINARY_GAIN = 5.0
"""A gain within this factor is an effect: a wrong torque constant, a payload."""

_ROTOR = 3
"""Number of the rotor's coefficient among the nuisances; unmodelled ones are behind it."""
_UNITS: Final = {"N·m": {"mN·m": 1e3, "N·cm": 1e2}, "N": {"mN": 1e3}}
"""By unit, others in which efforts are recorded, and how many of these make one."""
_PER_DEGREE = float(np.pi / 180.0)

_PRIOR: Final = {
    "torque": 0.6,
    "effect": 0.26,
    "anything": 0.01,
    "unit": 0.05,
    "sign": 0.02,
    "without gravity": 0.05,
    "gain": 0.005,
    "reversed gain": 0.005,
}
"""Prior probability of each kind of interpretation; several of a kind share it."""
_AS_STATED: Final = ("torque", "effect", "anything")
"""Kinds in which the effort is the torque that the model means, whatever the machine is."""
_SHARED = 0.3
"""Prior probability that the efforts of all joints are of one kind, as one driver makes them."""
_OTHER_COLUMNS = 0.05
"""Prior probability that positions or times are in another unit, a position has the other sign, or
two efforts are exchanged, shared by all ways."""


_Kind = tuple[str, str]
"""Kind of an interpretation, and the name of its unit."""


class Parts(NamedTuple):
    """The model's torque (Q, J) as it is compared: the motion's part, and gravity's."""

    dynamic: Array
    gravity: Array


@dataclass(frozen=True)
class Interpretation:
    """One interpretation of a joint's effort.

    Attributes:
        kind: as in the priors.
        name: of a unit.
        dynamic, gravity: b_d and b_g.
        dynamic_sd, gravity_sd: their standard deviations.
        log_prior: natural logarithm of its probability before any data.
    """

    kind: str
    name: str
    dynamic: float
    gravity: float
    dynamic_sd: float
    gravity_sd: float
    log_prior: float


@dataclass(frozen=True)
class _Change:
    """Another unit or sign of the motion: factors of positions (J,) and of times, and its name."""

    position: Array
    time: float
    text: str


@dataclass(frozen=True)
class EffortInterpretations:
    """Posterior probabilities of the interpretations of a recording's efforts.

    Attributes:
        suspect: what the columns are instead of what they state, as sentences without an end.
        doubts: what is odd and decides nothing, as whole sentences.
        gain: (J,) of efforts by the model's torques, if these are of an unknown unit.
        gain_range: (J, 2) between which the gain is with 95 %.
    """

    suspect: tuple[str, ...]
    doubts: tuple[str, ...]
    gain: Array
    gain_range: Array


def effort_interpretations(
    robot: Robot, motion: Motion, stated: Sequence[bool] = ()
) -> EffortInterpretations:
    """What a recording's efforts and positions are, by its motion and the nominal robot.

    `motion` has measured torques. Of joints (J,) whose effort is `stated`, gravity and gain are
    left as the user says.
    """
    regressions = _Regressions(robot, motion)
    as_recorded = _Change(np.ones(len(robot.joints)), 1.0, "")
    nominal = regressions.of(as_recorded)
    rivals = [_Rival(change.text, regressions.of(change)) for change in _other_motions(robot)]
    rivals += regressions.exchanges(nominal)
    log_prior = [np.log1p(-_OTHER_COLUMNS)]
    log_prior += [np.log(_OTHER_COLUMNS / max(len(rivals), 1))] * len(rivals)
    log_evidence = [nominal.log_evidence, *(rival.regression.log_evidence for rival in rivals)]
    posterior = np.exp(_normalised(np.array(log_evidence) + np.array(log_prior)))
    best = int(posterior.argmax())
    if best and posterior[best] >= SURE:
        suspect = [rivals[best - 1].text]
    else:
        suspect = list(_suspect_efforts(robot, nominal, stated))
    doubts = [] if suspect else list(_doubtful_gains(robot, nominal, stated))
    gain, gain_range = nominal.gains()
    return EffortInterpretations(tuple(suspect), tuple(doubts), gain, gain_range)


def _normalised(log_weight: Array) -> Array:
    return np.asarray(log_weight - logsumexp(log_weight))


def look_exchanged(first: str, second: str) -> str:
    """A sentence without an end on two columns."""
    return f"{first} and {second} look exchanged"


def looks_reversed(column: str) -> str:
    """A sentence without an end on a column."""
    return f"{column} looks as if it had the other sign"


def _other_motions(robot: Robot) -> Iterator[_Change]:
    """Degrees at all hinges or one, times in another unit than seconds, and reversed positions.

    What is refused when a recording is read (`_check_units` of
    `cablesense_recording.robot_recording`) does not come here: rows far apart between which
    nothing moves, and angles beyond what joints turn. Here are those whose rows are near for
    their unit, or whose joints turn little, as the efforts show them.
    """
    joints = robot.joints
    hinges = np.array([unit == "rad" for unit in robot.position_units])
    ones = np.ones(len(joints))
    if hinges.sum() > 1:
        all_hinges = np.where(hinges, _PER_DEGREE, 1.0)
        yield _Change(all_hinges, 1.0, "positions look like degrees; they must be in rad")
    for number in np.flatnonzero(hinges).tolist():
        of_one = ones.copy()
        of_one[number] = _PER_DEGREE
        text = f"position.{joints[number]} looks like degrees; it must be in rad"
        yield _Change(of_one, 1.0, text)
    for unit, seconds in OTHER_TIME_UNITS.items():
        yield _Change(ones, seconds, f"time_s looks like {unit}; it must be in seconds")
    for number, joint in enumerate(joints):
        reverses_one = np.where(np.arange(len(joints)) == number, -1.0, 1.0)
        yield _Change(reverses_one, 1.0, looks_reversed(f"position.{joint}"))


class _Regressions:
    """Regressions of one recording's efforts on the model's torques of changed motions."""

    def __init__(self, robot: Robot, motion: Motion) -> None:
        self._robot = robot
        self._motion = motion
        measured = np.nan_to_num(motion.torque)
        self._effort = motion.compared(measured)
        ones = np.ones_like(motion.speed)
        away = motion.position - motion.position.mean(axis=0)
        unmodelled = away, away**2, away * motion.direction
        columns = (motion.direction, motion.speed, ones, motion.acceleration, *unmodelled)
        self._nuisances = [motion.compared(column) for column in columns]
        counted = motion.counts.any(axis=0)
        self._judged = np.flatnonzero(counted & (np.abs(self._effort).max(axis=0) > 0.0)).tolist()

    def of(self, change: _Change) -> _Regression:
        """That on the torques of the model along the changed motion."""
        motion = self._motion
        model = self._robot.model
        position = motion.position * change.position
        speed = motion.speed * change.position / change.time
        acceleration = motion.acceleration * change.position / change.time**2
        gravity = gravity_torque(model, position)
        with np.errstate(over="ignore", invalid="ignore"):
            whole = inverse_dynamics(model, position, speed, acceleration)
        whole = np.where(np.isfinite(whole), whole, 0.0)
        parts = Parts(motion.compared(whole - gravity), motion.compared(gravity))
        rotor = motion.inertia * np.abs(change.position) / change.time**2
        by_joint = {
            joint: self._of_joint(joint, joint, parts, float(rotor[joint]))
            for joint in self._judged
        }
        return _Regression(len(self._robot.joints), parts, by_joint)

    def exchanges(self, nominal: _Regression) -> Iterator[_Rival]:
        """With the efforts of each two joints exchanged, whose torques have one unit."""
        joints = self._robot.joints
        units = self._robot.torque_units
        rotor = self._motion.inertia
        for a, b in combinations(self._judged, 2):
            if units[a] != units[b]:
                continue
            changed = {
                joint: self._of_joint(joint, other, nominal.parts, float(rotor[joint]))
                for joint, other in ((a, b), (b, a))
            }
            text = look_exchanged(f"torque.{joints[a]}", f"torque.{joints[b]}")
            yield _Rival(text, replace(nominal, by_joint=nominal.by_joint | changed))

    def _of_joint(self, joint: int, column: int, parts: Parts, rotor: float) -> _JointRegression:
        """That of a joint, whose effort stands in a column."""
        of_joint = [each[:, joint] for each in (*parts, *self._nuisances)]
        return _JointRegression(
            self._effort[:, column],
            np.column_stack(of_joint),
            rotor,
            self._robot.torque_units[joint],
        )


@dataclass(frozen=True)
class _Regression:
    """All joints of one motion; those without torque are left out."""

    joint_count: int
    parts: Parts
    by_joint: dict[int, _JointRegression]

    @property
    def log_evidence(self) -> float:
        """Natural logarithm of the probability of all efforts, whatever they are."""
        return sum(each.log_evidence for each in self.by_joint.values())

    def kinds(self, joints: Sequence[int]) -> dict[int, dict[_Kind, float]]:
        """By joint, the probabilities of what its effort is.

        Each may be of any kind by itself, or all are of one that is not as stated: gravity that
        is missing at one joint may be a spring's, and at all joints it is the driver's doing.
        """
        by_joint = {joint: self.by_joint[joint].kinds for joint in joints}
        units = {self.by_joint[joint].names_of_units for joint in joints}
        if len(joints) < 2 or len(units) != 1:
            return by_joint
        shared: dict[_Kind, float] = {("without gravity", ""): _PRIOR["without gravity"]}
        names = units.pop()
        shared |= {("unit", name): _PRIOR["unit"] / len(names) for name in names}
        by_themselves = sum(self.by_joint[joint].log_evidence for joint in joints)
        log_weight = [np.log1p(-_SHARED) + by_themselves]
        for kind, prior in shared.items():
            likelihoods = [self.by_joint[joint].log_likelihood(*kind) for joint in joints]
            log_weight.append(np.log(_SHARED * prior) + sum(likelihoods))
        alone, *together = np.exp(_normalised(np.array(log_weight))).tolist()
        for joint, kinds in by_joint.items():
            by_joint[joint] = {kind: alone * probability for kind, probability in kinds.items()}
            for kind, probability in zip(shared, together, strict=True):
                by_joint[joint][kind] += probability
        return by_joint

    def gains(self) -> tuple[Array, Array]:
        """Gains (J,) and the ranges (J, 2) of 95 %; 1 where none can be told."""
        gain = np.ones(self.joint_count)
        gain_range = np.ones((self.joint_count, 2))
        for joint, regression in self.by_joint.items():
            gain[joint], gain_range[joint] = regression.gain()
        return gain, gain_range


class _Rival(NamedTuple):
    """What columns may be instead, as a sentence without an end, and the regression then."""

    text: str
    regression: _Regression


class _JointRegression:
    """Interpretations of one joint's effort (Q,), by columns (Q, K) as in the module's equation.

    Behind those of dynamics, gravity, friction, damping, zero and rotor are the unmodelled ones.
    """

    def __init__(self, effort: Array, columns: Array, rotor: float, unit: str) -> None:
        self.interpretations = tuple(_interpretations(unit))
        size = float(np.sqrt((effort**2).mean()))
        nuisance = np.sqrt((columns[:, 2:] ** 2).mean(axis=0))
        self._sd = _NUISANCE_SHARE * size / np.maximum(nuisance, 1e-12)
        self._sd[_ROTOR] = _NUISANCE_SHARE * rotor
        self._noise_variance = (_NOISES * size) ** 2
        self._samples = len(effort) / _ROWS_A_SAMPLE
        # as many numbers as coefficients have all that rows say of them
        triangle = np.linalg.qr(np.column_stack([columns, effort]), mode="r")
        triangle /= np.sqrt(_ROWS_A_SAMPLE)
        self._columns = triangle[:, :-1]
        self._effort = triangle[:, -1]
        log_weight = np.array([each.log_prior for each in self.interpretations])
        self._log_likelihood = self._log_likelihoods()
        log_weight = log_weight + self._log_likelihood
        self.log_evidence = float(logsumexp(log_weight))
        self.probability = np.exp(_normalised(log_weight))

    @property
    def names_of_units(self) -> tuple[str, ...]:
        """Those in which the effort may be."""
        return tuple(
            dict.fromkeys(each.name for each in self.interpretations if each.kind == "unit")
        )

    def _prior(self, of: Interpretation) -> tuple[Array, Array]:
        """Mean (K,) and standard deviation (K,) of the coefficients."""
        mean = np.zeros(len(self._sd) + 2)
        mean[:2] = of.dynamic, of.gravity
        nuisance = self._sd.copy()
        nuisance[_ROTOR] *= abs(of.dynamic)  # a rotor is read in the unit of the effort
        if of.kind != "anything":
            nuisance[_ROTOR + 1 :] = 0.0
        return mean, np.concatenate([[of.dynamic_sd, of.gravity_sd], nuisance])

    def _log_likelihoods(self) -> Array:
        """(H,) of the effort y by each interpretation, the mean over the noises s.

        With X V^1/2 = U diag(e) W' and r = y - X m, y - X m ~ N(0, s^2 I + X V X') has
        log det = n log s^2 + sum log(1 + e^2 / s^2) and
        r' (s^2 I + X V X')^-1 r = |r - U U' r|^2 / s^2 + sum (U' r)^2 / (s^2 + e^2).
        """
        priors = [self._prior(each) for each in self.interpretations]
        mean = np.array([each for each, _ in priors])
        spread = np.array([each for _, each in priors])
        axes, singular, _ = np.linalg.svd(self._columns * spread[:, None, :], full_matrices=False)
        residual = self._effort - mean @ self._columns.T
        along = np.einsum("hqk,hq->hk", axes, residual)
        across = residual - np.einsum("hqk,hk->hq", axes, along)
        variance = self._noise_variance[None, :]
        eigenvalues = singular[:, None, :] ** 2
        determinant = self._samples * np.log(variance)
        determinant = determinant + np.log1p(eigenvalues / variance[..., None]).sum(axis=-1)
        square = (across**2).sum(axis=-1)[:, None] / variance
        square = square + (along[:, None, :] ** 2 / (variance[..., None] + eigenvalues)).sum(
            axis=-1
        )
        return np.asarray(logsumexp(-0.5 * (determinant + square), axis=1) - np.log(len(_NOISES)))

    def log_likelihood(self, kind: str, name: str) -> float:
        """Natural logarithm of the probability of the effort, if it is of a kind with a name."""
        of_kind = [
            number
            for number, each in enumerate(self.interpretations)
            if (each.kind, each.name) == (kind, name)
        ]
        log_prior = np.array([self.interpretations[number].log_prior for number in of_kind])
        return float(logsumexp(self._log_likelihood[of_kind] + log_prior) - logsumexp(log_prior))

    @property
    def kinds(self) -> dict[_Kind, float]:
        """Probabilities of what the effort is, by itself."""
        kinds: dict[_Kind, float] = {}
        for each, probability in zip(self.interpretations, self.probability.tolist(), strict=True):
            kind = each.kind, each.name
            kinds[kind] = kinds.get(kind, 0.0) + probability
        return kinds

    def gravity_share(self) -> tuple[float, float]:
        """b_g and its standard deviation, by least squares."""
        of_model = self._columns[:, : _ROTOR + 3]
        used = np.abs(of_model).max(axis=0) > 0.0
        columns = of_model[:, used]
        inverse = np.linalg.pinv(columns)
        coefficients = inverse @ self._effort
        variance = float(((self._effort - columns @ coefficients) ** 2).sum()) / self._samples
        of_gravity = int(used[0])  # the second of all columns
        return float(coefficients[of_gravity]), float(
            np.sqrt(variance * (inverse[of_gravity] ** 2).sum())
        )

    def gain(self) -> tuple[float, Array]:
        """The gain of an unknown unit, its mean by the posterior, and a range (2,) of 95 %."""
        of_gains = [n for n, each in enumerate(self.interpretations) if "gain" in each.kind]
        gain = np.array([self.interpretations[n].dynamic for n in of_gains])
        weight = self.probability[of_gains]
        if not weight.sum() > 0.0:
            return 1.0, np.array([1.0, 1.0])
        weight = weight / weight.sum()
        sign = np.sign(gain @ weight) or 1.0
        same_sign = np.sign(gain) == sign
        share = weight[same_sign] / weight[same_sign].sum()
        logarithm = np.log(np.abs(gain[same_sign]))
        middle = float(share @ logarithm)
        # the model's share about each gain of the grid is part of its uncertainty
        deviation = float(np.sqrt(share @ (logarithm - middle) ** 2 + _MODEL_SHARE**2 / 3.0))
        ends = np.exp(middle + 1.96 * deviation * np.array([-1.0, 1.0]))
        return float(sign * np.exp(middle)), np.sort(sign * ends)


def _interpretations(unit: str) -> Iterator[Interpretation]:
    """Those of an effort of a joint whose torque has a unit."""

    def near(kind: str, name: str, factor: float, share: float = 1.0) -> Interpretation:
        sd = _MODEL_SHARE * abs(factor)
        log_prior = float(np.log(share * _PRIOR[kind]))
        return Interpretation(kind, name, factor, factor, sd, sd, log_prior)

    yield near("torque", "", 1.0)
    log_effect = float(np.log(_PRIOR["effect"] / len(_EFFECTS) ** 2))
    for dynamic in _EFFECTS.tolist():
        for gravity in _EFFECTS.tolist():
            sds = _MODEL_SHARE * dynamic, _MODEL_SHARE * gravity
            yield Interpretation("effect", "", dynamic, gravity, *sds, log_effect)
    log_anything = float(np.log(_PRIOR["anything"]))
    yield Interpretation("anything", "", 1.0, 1.0, _EFFECT_SHARE, _EFFECT_SHARE, log_anything)
    units = _UNITS[unit]
    for name, factor in units.items():
        for sign, signed_name in ((1.0, name), (-1.0, f"{name} with the other sign")):
            yield near("unit", signed_name, sign * factor, 0.25 / len(units))
            wide_sd = _EFFECT_SHARE * factor
            log_share = float(np.log(0.25 * _PRIOR["unit"] / len(units)))
            wide = sign * factor, sign * factor, wide_sd, wide_sd, log_share
            yield Interpretation("unit", signed_name, *wide)
    yield near("sign", "", -1.0)
    log_without = float(np.log(_PRIOR["without gravity"]))
    yield Interpretation("without gravity", "", 1.0, 0.0, _MODEL_SHARE, _LEFT_GRAVITY, log_without)
    for gain in _GAINS.tolist():
        yield near("gain", "", gain, 1.0 / len(_GAINS))
        yield near("reversed gain", "", -gain, 1.0 / len(_GAINS))


def _suspect_efforts(robot: Robot, nominal: _Regression, stated: Sequence[bool]) -> Iterator[str]:
    """Units and missing gravity that are sure, as sentences with the remedy."""
    by_unit: dict[str, list[int]] = {}
    without: list[int] = []
    having: list[int] = []
    for joint, kinds in nominal.kinds(_judged(nominal, stated)).items():
        kind, name = _sure_kind(kinds)
        if kind == "unit":
            by_unit.setdefault(name, []).append(joint)
        elif kind == "without gravity" and nominal.parts.gravity[:, joint].any():
            without.append(joint)
        elif kinds["torque", ""] + kinds["effect", ""] >= SURE:
            having.append(joint)
    for name, joints in by_unit.items():
        yield _unit_sentence(robot, nominal, name, joints)
    if without:
        # a driver takes it out at all joints: those that surely have it are the exception
        every = without if not having else list(nominal.by_joint)
        yield _gravity_sentence(robot, nominal, without, every)


def _unit_sentence(robot: Robot, nominal: _Regression, name: str, joints: Sequence[int]) -> str:
    unit = robot.torque_units[joints[0]]
    bare_name, _, other_sign = name.partition(" ")
    factor = (-1.0 if other_sign else 1.0) / _UNITS[unit][bare_name]
    named = some_of([f"torque.{robot.joints[joint]}" for joint in joints])
    looks = "looks" if len(joints) == 1 else "look"
    option = _option(robot, joints, list(nominal.by_joint), f"torque:{factor:g}")
    return f"{named} {looks} like {name}, not {unit} (state {option})"


def _gravity_sentence(
    robot: Robot, nominal: _Regression, joints: Sequence[int], every: Sequence[int]
) -> str:
    gravity = nominal.parts.gravity
    heaviest = max(joints, key=lambda joint: float(np.abs(gravity[:, joint]).max()))
    most = float(np.abs(gravity[:, heaviest]).max())
    share, deviation = nominal.by_joint[heaviest].gravity_share()
    named = some_of([robot.joints[joint] for joint in joints])
    what = f"the effort of {named} lacks" if len(joints) == 1 else f"the efforts of {named} lack"
    option = _option(robot, joints, every, "torque_without_gravity")
    return (
        f"{what} the model's gravity of {most:.3g} {robot.torque_units[heaviest]}: their share of "
        f"it is {share:.2f} ± {deviation:.2f} (state {option})"
    )


def _option(robot: Robot, joints: Sequence[int], every: Sequence[int], meaning: str) -> str:
    """The option that states a meaning, of every joint or of some."""
    if set(joints) >= set(every):
        return f"--effort {meaning}"
    return " ".join(f"--effort {robot.joint_names[joint]}={meaning}" for joint in joints)


def _doubtful_gains(robot: Robot, nominal: _Regression, stated: Sequence[bool]) -> Iterator[str]:
    """Efforts of an unknown unit, and gravity that may lack, as whole sentences."""
    for joint, kinds in nominal.kinds(_judged(nominal, stated)).items():
        column = f"torque.{robot.joints[joint]}"
        option = f"--effort {robot.joint_names[joint]}"
        gain, (low, high) = nominal.by_joint[joint].gain()
        kind, _ = _sure_kind(kinds)
        if kind == "gain" and not 1.0 / _ORDINARY_GAIN < abs(gain) < _ORDINARY_GAIN:
            yield (
                f"{column} is {gain:.2g} times the model's torque ({low:.2g} to {high:.2g}): "
                f"check its unit; if it is a current, state {option}=current."
            )
        without = kinds["without gravity", ""]
        if without >= 0.5 and not kind:
            yield (
                f"{column} may lack the model's gravity ({without:.0%}); if it does, state "
                f"{option}=torque_without_gravity."
            )


def _judged(nominal: _Regression, stated: Sequence[bool]) -> list[int]:
    return [joint for joint in nominal.by_joint if not (len(stated) and stated[joint])]


def _sure_kind(kinds: dict[_Kind, float]) -> _Kind:
    """What an effort is, where it surely is no torque; else empty."""
    others = {kind: p for kind, p in kinds.items() if kind[0] not in _AS_STATED}
    if sum(others.values()) < SURE:
        return "", ""
    return max(others, key=lambda kind: others[kind])
