"""The corrected closed form behind the inverse of sensors that lag, which has a state.

A lag loses nothing but time: from one reading to the next the tension is known exactly, if it
holds in between, from two numbers for each cable,

    T = (y - s y' - a x') / (1 - s - a),    x = T + f (x' - T),

with y the reading, x what the first lag has let through, primes at the tick before, and f, s and a
the shares that a tick leaves (`sensor_lag.lag_shares`). Noise grows by 1 / (1 - s - a), so ticks
are no shorter than a twelfth of the longest lag. Without a past, at the first tick after a start,
a pause or a tare, sensors count as settled: T = y.
"""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from cablesense_base import Array
from cablesense_sim.arm import Arm
from cablesense_sim.build import entries_of
from cablesense_sim.effects.effect import chosen
from cablesense_sim.effects.registry import known_effects
from cablesense_sim.effects.sensor import SensorLag, lag_shares
from cablesense_sim.replay import difference_variance_n2
from cablesense_training.errors import TrainingError
from cablesense_training.inference.temporal_estimator import TemporalState, TickClock
from cablesense_training.networks.closed_form import ClosedForm
from cablesense_training.networks.corrected import CorrectedClosedForm, statics
from cablesense_training.networks.layers import SingleContactOutput
from cablesense_training.networks.second_order import SecondOrderClosedForm
from cablesense_training.networks.temporal import Ticks

_TICKS_OF_A_LAG = 12.0


class UnlaggedClosedForm(CorrectedClosedForm):
    """Single contact from ticks; trained, and without a state, as the base class.

    Args:
        arm: an arm with lagging sensors, at most one lag for each.
        closed_form: its statics.

    Attributes:
        tick_s: from one tick to the next.
        own_state, memory: sizes of the part of the state that this uses, and of the whole.
    """

    first: Tensor
    second: Tensor
    across: Tensor

    def __init__(self, arm: Arm, closed_form: ClosedForm | SecondOrderClosedForm) -> None:
        super().__init__(arm, closed_form)
        self.tick_s = tick_s(arm)
        for name, shares in zip(("first", "second", "across"), _shares(arm), strict=True):
            self.register_buffer(name, torch.as_tensor(shares))
        self.own_state = 2 * arm.cable_count + 1
        self.memory = TemporalState(self.own_state, 0, arm.cable_count, arm.joint_count).size

    @classmethod
    def for_arm(cls, arm: Arm, tare_samples: int = 50) -> UnlaggedClosedForm:
        """The network of an arm; what noise grows to counts as spread of the readings.

        Raises:
            TrainingError: no sensor lags, or one has several lags.
        """
        if not lags(arm):
            raise TrainingError(
                f"network unlagged is for an arm file that lists sensor_lag, once for each cable "
                f"at most; {arm.identity} does not"
            )
        added_n2 = float((added_noise_n(arm, tare_samples) ** 2).mean())
        return cls(arm, statics(settled_sensors(arm), tare_samples, unexplained_n2=added_n2))

    def undo(self, reading_n: Tensor, before: Tensor) -> tuple[Tensor, Tensor]:
        """Tensions (B, M) of readings less a tare, and the next state, (B, 2M + 1) as `before`.

        The state's last number is one where there is a past, and zero before that.
        """
        cables = reading_n.shape[-1]
        read, through, known = before.split([cables, cables, 1], dim=-1)
        read, through = (reading_n + known * (each - reading_n) for each in (read, through))
        kept = self.second * read + self.across * through
        tension = (reading_n - kept) / (1.0 - self.second - self.across)
        now_known = 0.0 * known + 1.0  # the exporter takes ones_like for one row
        through = tension + self.first * (through - tension)
        return tension, torch.cat([reading_n, through, now_known], dim=-1)

    def undone_n(self, differences_n: Array, tare_n: Array, time_s: Array) -> Array:
        """(R, M) tensions of a recording's differences at its times (R,); NaN without a tare.

        From each tare (R, M) on, by ticks, as `TemporalEstimator` answers.
        """
        no_past = torch.zeros(1, self.own_state, dtype=torch.float64)
        state, found, clock = no_past, differences_n.copy(), TickClock(self.tick_s)
        for row, difference_n in enumerate(differences_n):
            ticks = clock.ticks(float(time_s[row]))
            if ticks is None or (tare_n[row] != tare_n[row - 1]).any():
                state = no_past
            following = state
            for _ in range(ticks or 1):
                tension_n, following = self.undo(torch.as_tensor(difference_n)[None], following)
            found[row] = tension_n[0].numpy()
            if ticks != 0:
                state = following
                clock.advance(float(time_s[row]), ticks)
        return found

    def tick(self, ticks: Ticks, state: Tensor) -> tuple[SingleContactOutput, Tensor]:
        """Answers for B rows with states (B, memory), and the next states."""
        before, others = state.split([self.own_state, self.memory - self.own_state], dim=-1)
        tension, now = self.undo(ticks.tension_difference_n, before)
        output, _ = self.answer_and_taut(tension, ticks.joint_command_rad)
        return output, torch.cat([now, others], dim=-1)


def lags(arm: Arm) -> bool:
    """Whether sensors of an arm lag, each by one lag at most."""
    each = np.sum([here for _, here in _lags(arm)], axis=0)
    return bool(np.any(each)) and int(np.max(each)) == 1


def settled_sensors(arm: Arm) -> Arm:
    """The arm without the lags of its sensors."""
    known = known_effects()
    kept = [e for e in arm.effects if not isinstance(known[e.effect], SensorLag)]
    return arm.model_copy(update={"effects": kept})


def tick_s(arm: Arm) -> float:
    """How long a tick of an arm with lagging sensors is."""
    longest_s = max(values["time_constant_s"] for values, _ in _lags(arm))
    return max(1.0 / arm.sensors.rate_hz, longest_s / _TICKS_OF_A_LAG)


def added_noise_n(arm: Arm, tare_samples: int) -> Array:
    """(M,) standard deviation of the noise that undoing the lags adds to tension differences."""
    _, second, across = _shares(arm)
    growth = 1.0 / (1.0 - second - across)
    variance_n2 = difference_variance_n2(arm.sensors, tare_samples)
    return np.asarray(np.sqrt((growth**2 - 1.0) * variance_n2))


def _lags(arm: Arm) -> list[tuple[dict[str, float], NDArray[np.bool_]]]:
    """Numbers and cables (M,) of each listed lag."""
    return [
        (entry.values, chosen(entry.place, arm.cable_count))
        for entry in entries_of(arm)
        if isinstance(entry.effect, SensorLag)
    ]


def _shares(arm: Arm) -> Array:
    """(3, M) of `lag_shares` over a tick; zero where nothing lags."""
    found = np.zeros((3, arm.cable_count))
    for values, here in _lags(arm):
        numbers = np.array([values["time_constant_s"]]), np.array([values["second_share"]])
        found[:, here] = np.concatenate(lag_shares(tick_s(arm), *numbers))[:, None]
    return found
