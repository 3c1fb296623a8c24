"""The estimator's settings: the node's parameters of these names, with angles in rad.

They stand in the provenance of every recording (`cablesense_online.provenance`), from which a
replay takes them. So what changes an answer must be among them, or a replay differs from its
recording. A default here is that of recordings made before the setting existed: what the estimator
did then. A node's default is another: it stands in `cablesense_ros/parameters.yaml`, and the file
that launch files give to the node, `config/nodes/estimator.yaml`, overrides it.
"""

from __future__ import annotations

from typing import Annotated, Final, Literal

from pydantic import BaseModel, ConfigDict, Field

_NotNegative = Annotated[float, Field(ge=0.0, allow_inf_nan=False)]


class EstimationSettings(BaseModel):
    """How samples are checked, tared, followed in motion, and answered.

    Attributes:
        contact_threshold: probability of a contact from which one is stated, against none.
        stale_after_s: largest age of a sample.
        slack_below_n: a cable is reported as slack below this.
        tare_samples, tare_steady_n: readings of a tare, and the largest standard deviation of a
            channel's, in its unit.
        tare_deviation_n: of networks: largest distance of a tare from the arm file; 0 for any.
        auto_tare: whether the first tare is taken by itself.
        await_breath: whether that waits for a breath.
        joint_speed_rad_s: at which the joints move to a command.
        settle_s: how long the arm swings, s, from the arrival of the set-points at a command on,
            not from the command; no force is known before. Commands that are followed
            (`follow_rad_s`) and those within `still_rad` do not wait for it.
        still_rad: a command within this of the pose moves nothing: its noise, not a move.
        follow_rad_s: a motion up to this speed is followed.
        unknown_force: what is published where no force is known.
        hidden_above_n: a free arm is `hidden` where forces above this might not show.
    """

    model_config = ConfigDict(frozen=True)

    contact_threshold: _NotNegative
    stale_after_s: _NotNegative
    slack_below_n: _NotNegative
    tare_samples: Annotated[int, Field(ge=1, le=10_000)]
    tare_steady_n: _NotNegative
    auto_tare: bool
    await_breath: bool = False
    joint_speed_rad_s: Annotated[float, Field(gt=0.0, allow_inf_nan=False)]
    settle_s: _NotNegative
    still_rad: _NotNegative = 0.0
    follow_rad_s: _NotNegative = 0.0
    tare_deviation_n: _NotNegative = 0.0
    unknown_force: Literal["zero", "nan", "none"] = "zero"
    hidden_above_n: _NotNegative = 1.0

    @property
    def settle_ns(self) -> int:
        """`settle_s` in whole nanoseconds, as stamps are."""
        return round(self.settle_s * 1e9)


LIVE_SETTINGS: Final = ("contact_threshold", "stale_after_s", "slack_below_n")
"""These may change while an estimator runs."""
