"""A law against the statics of the arm that it was made for, before it becomes a model file.

Readings are those of static equilibrium (`cablesense_sim.equilibrium`), with the sensors' noise,
of exactly the arm of the file: untouched, and touched once, in poses and with forces that it
bears. The law is told the truth about this arm, and its errors are compared with what it states of
them:

    misfit    root of χ² for each channel, median, of what the true contact leaves of a reading
    moment    95 % quantile of the errors of the moment, over that of their stated distribution
    place     the same of the place, where the force is known
    force     the same of the lateral force, where it is known

Each is one at best. The law is linear about the pose that a reading shows; where that does not
hold, or the search for the pose does not converge, they are far above one. Effects with a memory
are left out, as an equilibrium has none; sensors are read as they settle.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace

import numpy as np

from cablesense_base import Array
from cablesense_contact.estimate import NORMAL_95
from cablesense_contact.felt_arm import FeltArm
from cablesense_contact.judgement import ContactState, Judge
from cablesense_contact.law import Law, LawOutput
from cablesense_sim.arm import Arm
from cablesense_sim.uncertain_arm import arm_parameters
from cablesense_training.data.protocols import AnywhereContact
from cablesense_training.errors import TrainingError
from cablesense_training.evaluation.law import law_protocol, true_contacts
from cablesense_training.evaluation.metrics import mean_or_nan
from cablesense_training.evaluation.touches import Touches, drawn_touches, settled_readings_n

MOST_OVER_BOUND = 1.5
"""A figure above this refuses the law."""
LEAST_ANSWERED = 0.7
"""Share of the contacts that are vouched for; fewer refuse the law."""
MOST_FALSE = 0.02
"""Share of untouched readings that are stated as a contact; more refuse the law."""

_SAMPLES = 500
_UNTOUCHED = 0.4
"""Share of them."""
_SEED = 61
_FEWEST_OF_A_QUANTILE = 20
"""Errors below which no quantile is taken."""
_JUDGED_QUANTILE = 0.95


@dataclass(frozen=True)
class LawCheck:
    """How a law answers readings of its own arm at rest.

    Attributes:
        samples: readings that were answered.
        misfit, moment, place, force: over their bounds, see above; the last three are NaN where
            fewer than twenty errors are stated.
        answered: share of the contacts that are vouched for.
        false_contacts: share of the untouched readings that are stated as a contact.
        slack: share of the readings in which a cable is slack.
        pose_range_deg, force_range_n: the poses and forces that were tried.
        least_answered: share of `answered` below which the law is at fault.
    """

    samples: int
    misfit: float
    moment: float
    place: float
    force: float
    answered: float
    false_contacts: float
    slack: float
    pose_range_deg: float
    force_range_n: float
    least_answered: float = LEAST_ANSWERED

    @property
    def worst(self) -> float:
        """The largest of the figures that are over their bounds, without those that are NaN."""
        figures = [self.misfit, self.moment, self.place, self.force]
        return float(np.nanmax(figures))

    @property
    def fault(self) -> str:
        """What is wrong with the law; empty if nothing is.

        A figure that is NaN is not judged, as too few contacts state it: a law that knows moments
        alone has none of the place and of the force. One that has none at all is at fault.
        """
        over = {
            name: value
            for name, value in asdict(self).items()
            if name in ("misfit", "moment", "place", "force") and value > MOST_OVER_BOUND
        }
        if over:
            name = max(over, key=over.__getitem__)
            what = (
                "what it leaves of readings" if name == "misfit" else f"its errors of the {name}"
            )
            return (
                f"{what} are {over[name]:.3g} times the bound, and {MOST_OVER_BOUND:g} is allowed"
            )
        if self.false_contacts > MOST_FALSE:
            return (
                f"{self.false_contacts:.1%} of its answers on the untouched arm are contacts, and "
                f"{MOST_FALSE:.0%} are allowed"
            )
        if self.answered < self.least_answered:
            return (
                f"it vouches for {self.answered:.0%} of the contacts, and at least "
                f"{self.least_answered:.0%} are required"
            )
        if np.isnan([self.moment, self.place, self.force]).all():
            return (
                f"it states fewer than {_FEWEST_OF_A_QUANTILE} contacts where they are, so that "
                "none of its errors can be judged"
            )
        return ""


def check_law(law: Law, arm: Arm, samples: int = _SAMPLES, seed: int = _SEED) -> LawCheck:
    """Answers of a law to readings of its arm at rest, against the truth.

    Raises:
        WeakArmError: the arm cannot stand, or bears no contact.
        TrainingError: the arm finds no rest in any of the poses.
    """
    protocol = law_protocol(arm, samples, no_contact_fraction=_UNTOUCHED)
    touches = drawn_touches(arm, protocol, seed)
    touches = touches.select(touches.contacts.sum(axis=1) < 2)
    readings_n = settled_readings_n(arm, touches, np.random.default_rng([seed, 1]))
    rests = np.asarray(np.isfinite(readings_n).all(axis=1))
    if not rests.any():
        raise TrainingError(
            f"arm {arm.identity} finds no rest within {protocol.pose_range_deg:g} degrees; raise "
            "the cables' stiffness or cables.pretension_n, or lower segments.mass_kg"
        )
    return _figures(law, arm, protocol, touches.select(rests), readings_n[rests])


def require_sound(
    law: Law, arm: Arm, least_answered: float = LEAST_ANSWERED, remedy: str = ""
) -> LawCheck:
    """Check a law, and refuse one that answers worse than it states, or too seldom.

    `remedy` is what would help, where that is not another arm.

    Raises:
        TrainingError: what it does, where, and what would help.
        WeakArmError: as `check_law`.
    """
    check = replace(check_law(law, arm), least_answered=least_answered)
    if check.fault:
        raise TrainingError(
            f"the estimator of arm {arm.identity} does not hold on the arm's own statics: within "
            f"{check.pose_range_deg:g} degrees and up to {check.force_range_n:g} N {check.fault}; "
            f"{remedy or _remedy(check)}"
        )
    return check


def _remedy(check: LawCheck) -> str:
    another_arm = "raise the cables' stiffness or cables.routing_radius_m"
    if check.slack > MOST_FALSE:
        another_arm = "raise cables.pretension_n, or lower segments.mass_kg"
    return f"a cable is slack in {check.slack:.0%} of these readings: {another_arm}"


def _figures(
    law: Law, arm: Arm, protocol: AnywhereContact, touches: Touches, readings_n: Array
) -> LawCheck:
    size = len(arm_parameters(arm))
    exact = np.zeros(size)
    known = np.zeros((size, size))
    still = np.zeros((arm.joint_count, arm.joint_count))
    seen = law(readings_n, touches.command_rad, exact, known, still)
    judge = Judge(FeltArm(arm))
    judged = [judge(seen.row(i), reading) for i, reading in enumerate(readings_n)]
    states = np.array([each.state for each in judged], dtype=object)
    segments = np.array([each.segment for each in judged])
    force_stated = np.asarray(states == ContactState.CONTACT)
    vouched = force_stated | np.asarray(states == ContactState.MOMENT)
    touched = touches.contacts.any(axis=1)

    truth = true_contacts(touches)
    right = touched & vouched & (segments == truth.segment)
    moment_n_m = truth.line_m[:, None] * np.stack(
        [-truth.force_n[:, 2], truth.force_n[:, 1]], axis=1
    )
    moment_error = (seen.moment_n_m - moment_n_m) / seen.moment_std_n_m
    place_std_m = np.sqrt(seen.contact_covariance[:, 0, 0])
    place_error = (seen.place_m - truth.place_m) / place_std_m
    low_n, high_n = seen.magnitude_ci95_n.T
    force_std_n = (high_n - low_n) / (2.0 * NORMAL_95)
    stated_n = np.hypot(seen.force_n[:, 1], seen.force_n[:, 2])
    acting_n = np.hypot(truth.force_n[:, 1], truth.force_n[:, 2])
    force_error = (stated_n - acting_n) / force_std_n
    return LawCheck(
        samples=len(readings_n),
        misfit=float(np.sqrt(np.median(_unexplained(seen, touches)) / arm.cable_count)),
        moment=_over_bound(moment_error[right]),
        place=_over_bound(place_error[right & force_stated]),
        force=_over_bound(force_error[right & force_stated]),
        answered=mean_or_nan(vouched[touched]),
        false_contacts=mean_or_nan(vouched[~touched]),
        slack=_slack_share(arm, readings_n),
        pose_range_deg=protocol.pose_range_deg,
        force_range_n=protocol.force_high_n,
    )


def _unexplained(seen: LawOutput, touches: Touches) -> Array:
    """(B,) χ² that the true contacts leave: of y - y(q) - D τ under S."""
    lever_m = seen.at_joint_m + touches.line_m[..., None, None] * seen.by_place
    acting_n = touches.force_n * touches.contacts[..., None]
    torque_n_m = np.einsum("bnk,bnkj->bj", acting_n, lever_m)
    left_n = seen.innovation_n - np.einsum("bmj,bj->bm", seen.by_torque, torque_n_m)
    return np.asarray(np.einsum("bm,bmk,bk->b", left_n, seen.information_n2, left_n))


def _over_bound(normalised: Array) -> float:
    """The 95 % quantile of errors over deviations, against that of a normal distribution."""
    sizes = np.abs(normalised).ravel()
    if len(sizes) < _FEWEST_OF_A_QUANTILE:
        return float("nan")
    return float(np.quantile(sizes, _JUDGED_QUANTILE)) / NORMAL_95


def _slack_share(arm: Arm, readings_n: Array) -> float:
    """Share of readings with a cable that may be slack: below what zero and noise make of it."""
    zero_n = float(arm.tolerances.sensor_zero_n)
    nearly_n = NORMAL_95 * float(np.hypot(zero_n, arm.sensors.noise_std_n)) + arm.sensors.step_n
    slack = np.asarray((readings_n < nearly_n).any(axis=1))
    return float(slack.mean())
