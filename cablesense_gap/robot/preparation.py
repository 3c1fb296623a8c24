"""A recording as it is compared: motion smoothed, torques cleared of glitches, noise known.

Smoothing has two stages. Positions and torques are smoothed lightly, as far as the noise of
accelerations asks for, since a model's products of smoothed motion are not the smoothed products.
Then measured and predicted torques go through the same low-pass at the bandwidth of the
comparison. A joint at rest does not count, as dry friction may hold any torque there: its torques
are removed from both before.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import mujoco
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import median_filter
from scipy.signal import welch

from cablesense_base import Array
from cablesense_gap.robot.efforts import effort_interpretations
from cablesense_gap.robot.model import Robot, actuated, inverse_dynamics
from cablesense_gap.robot.motion import (
    LEAST_FLOOR,
    Motion,
    Noise,
    Scale,
    Trial,
    derivatives,
    inner_rows,
    noise_of_smoothed,
    smoothed,
    through,
)
from cablesense_gap.robot.recording import RobotRecording
from cablesense_recording.recording import RecordingError

MOST_ROWS = 5000
"""Rows at which a model is evaluated; a longer recording has them at longer intervals."""

_LEAST_HZ = 1.0
_MOST_HZ = 20.0
"""Arms and their controllers are slower than this; faster ones state a bandwidth."""
_SAMPLES_A_PERIOD = 8.0
"""Least number in a period at the bandwidth: derivatives are then good to 1 %."""
_ROWS_A_PERIOD = 3.0
_LIGHTER_TIMES = 4.0
"""Times the bandwidth of the comparison, at most, motion is smoothed with."""
_POWER_SHARE = 0.95
_MOTION_SHARE = 0.9
_HARMONICS_TIMES = 2.0
"""Shares of the power of torques and of speeds; friction has harmonics of the motion."""
_SLOW_SHARE = 0.02
"""Share of a joint's usual speed below which it stands still, as friction sees it."""
_NOISE_DEVIATIONS = 3.0
_LEAST_MOVING = 0.05
_REST_S = 0.4
_FEWEST_ROWS = 30
_WIDER_TIMES = 1.2
"""Times the bandwidth that is tried next, where too few rows are left of a short recording."""
_FEWEST_SAMPLES = 16
_GLITCH_SAMPLES = 5
_GLITCH_DEVIATIONS = 6.0
_PERIODS_A_SPECTRUM = 40
_SPECTRUM_S = 10.0


def prepared(
    recording: RobotRecording,
    robot: Robot,
    bandwidth_hz: float | None = None,
    forward: bool | None = None,
    *,
    zeroed: bool = False,
    external: bool = False,
    gain: Array | None = None,
) -> Motion:
    """The recording's motion and torques; by default compared as far as torques have power.

    Without torques those count that the model's actuators make of the commands, and, unless asked
    otherwise, the comparison goes forward in time. With `zeroed` encoders, set to zero where each
    trial starts, each trial has the zeros that fit it. Positions that were measured outside the
    drives, `external`, are compared with the commands of position servos; torques are then those
    that the nominal robot needs. Of a short recording more rows are left at a wider bandwidth, so
    by default it is as wide as it must be.

    Currents whose torque constant is unknown are brought to torques by the `gain` (J,), as of
    another recording of the robot; without one by that which fits the nominal robot best.

    Raises:
        RecordingError: it has neither torques nor commands, or its trials are too short.
    """
    unknown = recording.unknown_gain & np.isfinite(recording.torque).any(axis=0)
    options = (robot, bandwidth_hz, forward, zeroed, external)
    if not unknown.any() or external:
        return _as_wide_as_needed(recording, *options)
    if gain is None:
        as_recorded = _as_wide_as_needed(recording, robot, bandwidth_hz, False, zeroed, external)
        gain = 1.0 / np.abs(effort_interpretations(robot, as_recorded).gain)
    gain = np.where(unknown, gain, 1.0)
    in_torque = replace(recording, torque=recording.torque * gain)
    motion = _as_wide_as_needed(in_torque, *options)
    return replace(motion, gain=gain, unknown_gain=unknown)


def _as_wide_as_needed(
    recording: RobotRecording,
    robot: Robot,
    bandwidth_hz: float | None,
    forward: bool | None,
    zeroed: bool,
    external: bool,
) -> Motion:
    """Motion and torques of a recording, at the narrowest bandwidth that leaves enough rows."""
    least_hz = _LEAST_HZ
    while True:
        try:
            return _prepared(
                recording, robot, bandwidth_hz, forward, zeroed, external, least_hz=least_hz
            )
        except _FewRowsError as few:
            if bandwidth_hz is not None or few.at_widest:
                raise
            least_hz = _WIDER_TIMES * few.compared_hz


class _FewRowsError(RecordingError):
    """Too few rows are left at a bandwidth, which may be the widest that their rate allows."""

    def __init__(self, text: str, compared_hz: float, *, at_widest: bool) -> None:
        super().__init__(text)
        self.compared_hz = compared_hz
        self.at_widest = at_widest


def _prepared(
    recording: RobotRecording,
    robot: Robot,
    bandwidth_hz: float | None,
    forward: bool | None,
    zeroed: bool,
    external: bool,
    *,
    least_hz: float,
) -> Motion:
    """Motion and torques of a recording; where no bandwidth is stated, one of `least_hz` or more.

    Raises:
        _FewRowsError: too few rows are left.
    """
    trials, interval_s = _evenly_sampled(recording)
    rate_hz = 1.0 / interval_s
    most_hz = min(_MOST_HZ, rate_hz / _SAMPLES_A_PERIOD)
    by_command = external or not np.isfinite(recording.torque).any()
    if by_command:
        _check_commands(recording, robot)
        made = [_modelled(robot, t, rate_hz, most_hz, needed=external) for t in trials]
        trials = [replace(t, torque=torque) for t, torque in zip(trials, made, strict=True)]
    if bandwidth_hz is None:
        compared_hz = float(np.clip(_comparison_hz(trials, rate_hz), least_hz, most_hz))
    elif 0.1 <= bandwidth_hz <= most_hz:
        compared_hz = bandwidth_hz
    else:
        raise RecordingError(
            f"{recording.name}: a bandwidth of {bandwidth_hz:g} Hz must be from 0.1 to "
            f"{most_hz:.3g} Hz at this rate"
        )
    noise = _noise(trials, rate_hz)
    inertia = _inertia(robot, recording.position)
    smoothed_hz = _smoothing_hz(
        noise, inertia, trials, compared_hz, min(_LIGHTER_TIMES * compared_hz, most_hz)
    )
    sample_count = sum(len(t.time_s) for t in trials)
    step = max(1, round(rate_hz / (_ROWS_A_PERIOD * smoothed_hz)), -(-sample_count // MOST_ROWS))
    parts, smooth = _smoothed(trials, rate_hz, smoothed_hz, noise, robot)
    joined = {name: np.concatenate([part[name][::step] for part in parts]) for name in parts[0]}
    moving = joined.pop("moving")
    torque = joined["torque"]
    tied = robot.geared.any(axis=1)
    counts = (moving | (moving.mean(0) < _LEAST_MOVING)) & np.isfinite(torque) & ~tied
    rows_hz = rate_hz / step
    passes, kept = _low_passes([len(p["time_s"][::step]) for p in parts], rows_hz, compared_hz)
    joined["trial"] = trial = np.unique(joined["trial"], return_inverse=True)[1]
    compared_trials, compared_trial = np.unique(trial[kept], return_inverse=True)
    if len(kept) < _FEWEST_ROWS or len(compared_trials) < 2:
        raise _FewRowsError(
            f"{recording.name}: {len(kept)} rows of {len(compared_trials)} trials are left of it "
            f"after smoothing to {compared_hz:.3g} Hz, where {_FEWEST_ROWS} rows of 2 are needed; "
            "record more trials of several seconds",
            compared_hz,
            at_widest=compared_hz >= most_hz,
        )
    scale = _scale(joined, moving, inertia)
    torque_noise = np.maximum(noise.torque, _noise_at_rest(trials, parts, rate_hz, compared_hz))
    floor = np.hypot(
        noise_of_smoothed(torque_noise, compared_hz),
        inertia * _noise_of_acceleration(noise.position, compared_hz, smoothed_hz),
    )
    return Motion(
        **joined,
        counts=counts,
        floor=np.maximum(floor, LEAST_FLOOR * scale.torque),
        scale=scale,
        trials=tuple(smooth),
        by_command=by_command,
        rate_hz=rate_hz,
        step=step,
        smoothed_hz=smoothed_hz,
        compared_hz=compared_hz,
        passes=passes,
        compared_trial=compared_trial,
        compared_labels=tuple(smooth[number].label for number in compared_trials),
        compared_time_s=joined["time_s"][kept],
        forward=not external and (by_command if forward is None else forward),
        zeroed=zeroed,
        external=external,
        noise=noise,
        inertia=inertia,
        gain=np.ones(len(robot.joints)),
        unknown_gain=np.zeros(len(robot.joints), dtype=bool),
    )


def _evenly_sampled(recording: RobotRecording) -> tuple[list[Trial], float]:
    """Every trial at one rate, that of most rows, and its interval, s."""
    same = np.diff(recording.trial) == 0
    if not same.any():
        raise _too_short(recording)
    interval_s = float(np.median(np.diff(recording.time_s)[same]))
    trials = []
    for number in np.unique(recording.trial).tolist():
        rows = np.flatnonzero(recording.trial == number)
        recorded_s = recording.time_s[rows]
        count = int((recorded_s[-1] - recorded_s[0]) / interval_s + 0.5) + 1
        if count < _FEWEST_SAMPLES:
            continue
        time_s = recorded_s[0] + interval_s * np.arange(count)
        position, torque, command = (
            _interpolated(time_s, recorded_s, values[rows])
            for values in (recording.position, recording.torque, recording.command)
        )
        label = recording.trial_label(number)
        trials.append(Trial(number, label, time_s, position, _without_glitches(torque), command))
    if not trials:
        raise _too_short(recording)
    return trials, interval_s


def _too_short(recording: RobotRecording) -> RecordingError:
    return RecordingError(
        f"{recording.name}: no trial has {_FEWEST_SAMPLES} rows; record longer ones"
    )


def _interpolated(at_s: Array, time_s: Array, values: Array) -> Array:
    columns = [np.interp(at_s, time_s, column) for column in values.T]
    return np.array(columns).reshape(values.shape[1], len(at_s)).T


def _without_glitches(torque: Array) -> Array:
    """Without single samples that stand out from their neighbours, as a switching drive makes."""
    middle = median_filter(np.nan_to_num(torque), size=(_GLITCH_SAMPLES, 1), mode="nearest")
    off = np.abs(torque - middle)
    usual = np.median(off, axis=0) / 0.6745 + 1e-12
    return np.where(off > _GLITCH_DEVIATIONS * usual, middle, torque)


def _check_commands(recording: RobotRecording, robot: Robot) -> None:
    if not (recording.command.size and np.isfinite(recording.command).all()):
        raise RecordingError(
            f"{recording.name}: has neither torque.<joint> nor the commands of all actuators; "
            "a comparison needs either"
        )
    if robot.model.na:
        raise RecordingError(
            f"{recording.name}: has no torque.<joint>, and actuators of {robot.path.name} have an "
            "internal state, which is not recorded; record torques"
        )


def _modelled(
    robot: Robot, trial: Trial, rate_hz: float, most_hz: float, *, needed: bool
) -> Array:
    """(T, J) torques that actuators make of a trial's commands, or that its motion needs."""
    position = smoothed(trial.position, rate_hz, most_hz)
    speed, acceleration = derivatives(position, rate_hz)
    if needed:
        return inverse_dynamics(robot.model, position, speed, acceleration)
    return actuated(robot, position, speed, trial.command)


def _comparison_hz(trials: Sequence[Trial], rate_hz: float) -> float:
    """The frequency, Hz, up to which torques are compared: a multiple of that of the motion.

    If the torques have their power below that, their frequency counts. Both are found without the
    noise. Beyond it, drives and controllers react to noise and resonances, which no motion shows.
    """
    moved = np.median(_frequency_below([t.position for t in trials], rate_hz, _MOTION_SHARE, 1))
    torques = _frequency_below([t.torque for t in trials], rate_hz, _POWER_SHARE, 0)
    return _HARMONICS_TIMES * float(min(moved, torques.max()))


def _frequency_below(
    signals: Sequence[Array], rate_hz: float, share: float, derivative: int
) -> Array:
    """(J,) frequencies, Hz, below which a derivative of signals has a share of its power."""
    known = [np.nan_to_num(signal) for signal in signals]
    frequency, density = _mean_spectrum(known, rate_hz)
    noise = np.mean([_noise_density(s, rate_hz, rate_hz / 4.0) for s in known], axis=0)
    beyond = np.maximum(density - 2.0 * noise, 0.0) * frequency[:, None] ** (2 * derivative)
    power = np.cumsum(beyond, axis=0)
    return frequency[(power < share * power[-1]).sum(0)]


def _mean_spectrum(signals: Sequence[Array], rate_hz: float) -> tuple[Array, Array]:
    """Frequencies (F,) and power densities (F, J) of signals (T, J), over all of them."""
    longest = max(int(_SPECTRUM_S * rate_hz), _FEWEST_SAMPLES)
    count = min(int(np.median([len(s) for s in signals])), longest)
    long_signals = [s for s in signals if len(s) >= count]
    spectra = [welch(s, rate_hz, nperseg=count, axis=0, detrend="constant") for s in long_signals]
    return spectra[0][0], np.asarray(np.mean([density for _, density in spectra], axis=0))


def _noise_density(
    signal: Array, rate_hz: float, above_hz: float, below_hz: float = np.inf
) -> Array:
    """(J,) power by hertz of what signals (T, J) have above a frequency, its median.

    Motion and its torques end below that frequency. The rest is noise; white noise has the same
    density below.
    """
    count = min(len(signal), max(64, int(_PERIODS_A_SPECTRUM * rate_hz / above_hz)))
    frequency, density = welch(signal, rate_hz, nperseg=count, axis=0, detrend="linear")
    beyond = (frequency >= min(above_hz, 0.7 * frequency[-1])) & (frequency <= below_hz)
    return np.asarray(np.median(density[beyond], axis=0) / np.log(2.0))


def _noise_of_acceleration(density: Array, *bandwidths_hz: float) -> Array:
    """Standard deviation that positions' white noise leaves in accelerations, smoothed."""
    frequency, gain = through(*bandwidths_hz)
    power = ((2.0 * np.pi * frequency) ** 4 * gain).sum() * frequency[1]
    return np.asarray(np.sqrt(density * power))


def _noise(trials: Sequence[Trial], rate_hz: float) -> Noise:
    """Median over the longer trials of what positions and torques have in the upper half."""
    longest = max(len(t.position) for t in trials)
    long = [t for t in trials if len(t.position) >= 0.5 * longest]
    densities = []
    for signals in ([t.position for t in long], [t.torque for t in long]):
        trial_densities = [
            _noise_density(np.nan_to_num(s), rate_hz, rate_hz / 4.0) for s in signals
        ]
        densities.append(np.median(trial_densities, axis=0))
    return Noise(*densities)


def _inertia(robot: Robot, position: Array) -> Array:
    """(J,) that each joint feels alone, at some of the poses."""
    model = robot.model
    data = mujoco.MjData(robot.model)
    whole = np.zeros((model.nv, model.nv))
    diagonals = []
    for row in np.linspace(0, len(position) - 1, 20).astype(int):
        data.qpos[:] = position[row]
        mujoco.mj_forward(model, data)
        mujoco.mj_fullM(model, data, whole)
        diagonals.append(whole.diagonal().copy())
    return np.asarray(np.mean(diagonals, axis=0))


def _smoothing_hz(
    noise: Noise, inertia: Array, trials: Sequence[Trial], compared_hz: float, most_hz: float
) -> float:
    """The widest bandwidth of the motion, Hz, at which the noise of accelerations is small enough.

    As compared it stays below the noise of the torques, or 1 % of the torques.
    """
    torque = np.concatenate([t.torque for t in trials])
    torque_noise = noise_of_smoothed(noise.torque, compared_hz)
    least = np.maximum(torque_noise, 0.01 * np.nan_to_num(torque.std(0)).max())
    good = compared_hz
    for tried_hz in np.geomspace(compared_hz, most_hz, 20):
        acceleration_noise = _noise_of_acceleration(noise.position, compared_hz, float(tried_hz))
        if (inertia * acceleration_noise <= least).all():
            good = float(tried_hz)
    return good


def _smoothed(
    trials: Sequence[Trial], rate_hz: float, smoothed_hz: float, noise: Noise, robot: Robot
) -> tuple[list[dict[str, Array]], list[Trial]]:
    """By trial, what `Motion` has of its inner rows and which joints move there; smooth trials.

    Below a least speed the direction of motion is not known, and a joint does not move.
    """

    def filtered(signal: Array) -> Array:
        return smoothed(signal, rate_hz, smoothed_hz)

    smooth = [replace(t, position=filtered(t.position)) for t in trials]
    moved = [derivatives(t.position, rate_hz) for t in smooth]
    usual = np.sqrt(np.concatenate([speed**2 for speed, _ in moved]).mean(0))
    speed_noise = np.sqrt(noise.position) * 2.0 * np.pi * smoothed_hz**1.5 / np.sqrt(3.0)
    slow = np.maximum(np.maximum(_NOISE_DEVIATIONS * speed_noise, _SLOW_SHARE * usual), 1e-9)
    parts = []
    for trial, (speed, acceleration) in zip(smooth, moved, strict=True):
        torque = filtered(trial.torque)
        part = {
            "trial": np.full(len(speed), trial.number),
            "time_s": trial.time_s,
            "position": trial.position,
            "speed": speed,
            "acceleration": acceleration,
            "direction": filtered(np.clip(speed / slow, -1.0, 1.0)),
            "load": np.where(robot.geared.any(axis=1), np.nan_to_num(torque), 0.0),
            "command": filtered(trial.command),
            "torque": torque,
            "moving": np.abs(speed) >= slow,
        }
        inner = inner_rows(len(speed), rate_hz, smoothed_hz)
        parts.append({name: values[inner] for name, values in part.items()})
    return parts, smooth


def _low_passes(
    counts: Sequence[int], rows_hz: float, compared_hz: float
) -> tuple[tuple[Array, ...], NDArray[np.int64]]:
    """The low-pass of each trial as a matrix, without its ends, and which rows it leads to."""
    step = max(1, round(rows_hz / (_ROWS_A_PERIOD * compared_hz)))
    edge = round(0.5 * rows_hz / compared_hz)
    passes = []
    kept = []
    begin = 0
    for count in counts:
        kept_rows = np.arange(min(edge, count // 2), count - edge, step)
        whole = np.eye(count)
        if compared_hz < rows_hz / 2.5:
            whole = smoothed(whole, rows_hz, compared_hz)
        passes.append(whole[kept_rows])
        kept.append(begin + kept_rows)
        begin += count
    return tuple(passes), np.concatenate(kept)


def _scale(joined: dict[str, Array], moving: NDArray[np.bool_], inertia: Array) -> Scale:
    """Joints without a torque count as those with the largest."""
    sizes = np.sqrt((joined["torque"] ** 2).mean(0))
    largest = np.nanmax(sizes, initial=0.0)
    if not largest > 0.0:
        raise RecordingError("all torques are zero; record those of the drives")
    sizes = np.where(np.isfinite(sizes), np.maximum(sizes, 1e-3 * largest), largest)
    moved = np.maximum(moving.mean(0), 1e-6)
    return Scale(
        torque=sizes,
        speed=np.sqrt((joined["speed"] ** 2 * moving).mean(0) / moved),
        acceleration=np.sqrt((joined["acceleration"] ** 2 * moving).mean(0) / moved),
        position=0.5 * np.ptp(joined["position"], axis=0),
        inertia=inertia,
    )


def _noise_at_rest(
    trials: Sequence[Trial], parts: Sequence[dict[str, Array]], rate_hz: float, compared_hz: float
) -> Array:
    """(J,) density of the torques' noise about the bandwidth, while all joints stand still.

    Filtered noise is larger there than at high frequencies. The torque of a joint that sticks
    changes more slowly, and differs from rest to rest.
    """
    least = int(_REST_S * rate_hz)
    densities = []
    low_hz = max(compared_hz, 1.0 / _REST_S)
    for trial, part in zip(trials, parts, strict=True):
        still = part["moving"].max(1) == 0
        edge = (len(trial.time_s) - len(still)) // 2
        ends = np.flatnonzero(np.diff(still.astype(int), prepend=0, append=0)) + edge
        densities += [
            _noise_density(torque, rate_hz, low_hz, 2.0 * low_hz)
            for begin, end in zip(ends[::2], ends[1::2], strict=True)
            if len(torque := np.nan_to_num(trial.torque[begin:end])) >= least
        ]
    return np.median(densities, axis=0) if densities else np.zeros(trials[0].position.shape[1])
