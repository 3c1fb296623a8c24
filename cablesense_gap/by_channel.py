"""The verdict in each channel: what is removed of its gap, by which effects, and what stays."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from cablesense_base import Array
from cablesense_gap.diagnosis.probability import ProbabilityCalibration, probability_unlisted
from cablesense_gap.explained import NEGLIGIBLE, Changes
from cablesense_gap.verdict import ChannelGap, removed_fraction


def judged_channels(
    changes: Changes,
    used: NDArray[np.bool_],
    gaps: Mapping[str, ChannelGap],
    calibration: ProbabilityCalibration,
) -> dict[str, ChannelGap]:
    """The gaps of the channels, in their order, with what removes them and what stays.

    `changes` are those of the hypothesis that explains the readings in the `used` rows (R,).
    """
    problem = changes.problem
    explained = changes.hypothesis
    before = _rms_by_channel((problem.readings - problem.nominal)[used])
    after = _rms_by_channel((problem.readings - explained.held_out)[used])
    by_effect = {
        effect: _rms_by_channel(changes.without(effect)[used]) for effect in explained.effects
    }
    judged = {}
    for c, (name, gap) in enumerate(gaps.items()):
        least = max(NEGLIGIBLE * before[c], problem.floor)
        effects = [effect for effect, change in by_effect.items() if change[c] >= least]
        effects.sort(key=lambda effect: -by_effect[effect][c])
        judged[name] = gap.model_copy(
            update={
                "removed_fraction": removed_fraction(gap.before, gap.after, gap.floor),
                "effects": tuple(effects),
                "unlisted": probability_unlisted(float(after[c]), problem.floor, calibration),
            }
        )
    return judged


def acting_channels(channels: Mapping[str, ChannelGap]) -> tuple[str, ...]:
    """Channels in which something unlisted acts besides, more probably than not."""
    return tuple(name for name, gap in channels.items() if (gap.unlisted or 0.0) > 0.5)


def _rms_by_channel(values: Array) -> Array:
    return np.asarray(np.sqrt((values**2).mean(0)))
