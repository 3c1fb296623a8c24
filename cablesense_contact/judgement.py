"""What to state of a reading: the hypotheses weighed against one another, and against noise.

Each hypothesis has an evidence under the same covariance (`law.LawOutput`) and a prior probability
that is stated here. A contact is vouched for if nothing else is nearly as likely, and if what it
leaves unexplained is what sensors and tolerances leave.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from enum import Enum
from functools import cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cablesense_base import Array
from cablesense_contact.chi_squared import limit_at
from cablesense_contact.estimate import NORMAL_95
from cablesense_contact.felt import FeltMachine
from cablesense_contact.law import LawOutput

# Who changes a prior or a limit here measures `benchmarks/built_arms.py` and `benchmarks/trust.py`
# with fresh seeds before and after: docs/development.md, "A prior or a limit of the estimate".
LOG_PRIOR_SEVERAL_ON_ONE_LINK = math.log(0.01)
"""Of several contacts or a couple on one and the same link, against a single contact."""
LOG_PRIOR_ON_SEVERAL_LINKS = math.log(0.01)
"""Of contacts on more links than one, against a single contact."""
LOG_PRIOR_FAULT = math.log(1e-3)
"""That some channel is wrong now, against none: a fault a day lasts minutes until it is seen."""
LOG_PRIOR_EXCHANGED = math.log(1e-4)
"""That two channels are exchanged: it happens when an arm is put together."""
CONTACT_DOUBTED_ABOVE = 0.05
"""A contact is not vouched for if the rivals together are more probable than this.

It is then as sure as its intervals, which hold in 95 %. It must be above the priors of several
contacts together: where a machine has so few joints that no reading could tell those from one
contact, their probability stays what it was before the reading.
"""
MISFIT_BELOW = 1e-6
"""Probability, by the χ² of what a hypothesis leaves of a reading, below which it explains none.

Each reading is judged: at 100 Hz noise alone falls below this once in some hours.
"""
_CONTACT_NUMBERS = 4
"""Numbers that a contact fits: three of the force, and the place."""
_KNOWN_SHARE_OF_FORCE = 0.3
"""A force is known if both ends of its interval are within this share of it, or near it."""


class ContactState(Enum):
    """What is stated of a reading."""

    FREE = "free"
    CONTACT = "contact"
    MOMENT = "moment"
    UNCONFIRMED = "unconfirmed"
    IMPLAUSIBLE = "implausible"


@dataclass(frozen=True)
class Judgement:
    """The decision on one reading.

    Attributes:
        state: what is stated.
        segment: of the likeliest contact, from 1 on; also where it is not stated.
        probabilities: (N + 1,) of no contact, and of a contact on each segment, among these.
        doubt: what else would explain the reading, with its size; empty without doubt.
        force_known: whether readings determine the lateral force; else only its moment.
        misfit: the normalised innovation squared (χ²) that what is stated leaves,
        misfit_limit: up to which it explains the reading.
    """

    state: ContactState
    segment: int
    probabilities: Array
    doubt: str = ""
    force_known: bool = False
    misfit: float = 0.0
    misfit_limit: float = math.inf


class Judgements(NamedTuple):
    """Judgements of B readings: the fields of `Judgement`, with a leading axis."""

    state: NDArray[np.object_]
    segment: NDArray[np.int64]
    probabilities: Array
    doubt: tuple[str, ...]
    force_known: NDArray[np.bool_]
    misfit: Array
    misfit_limit: Array


@dataclass(frozen=True)
class _Rival:
    """Another explanation.

    Attributes:
        log_weight: against "nothing touches".
        log_total: that of all of its kind together, of which this is the likeliest.
        sentence: what it says, with its size.
        fault: whether it is one of a sensor.
        same_moment: whether the moment about the joint is nevertheless that of the contact.
    """

    log_weight: float
    log_total: float
    sentence: str
    fault: bool = False
    same_moment: bool = False


class Judge:
    """Judges readings of one machine."""

    def __init__(self, machine: FeltMachine, contact_threshold: float = 0.5) -> None:
        self._names = machine.channels.names
        self._units = machine.channels.units
        self._links = machine.link_names
        self._friction = machine.surface_friction
        self._known_n = machine.known_n
        self._is_one_place = machine.is_one_place
        self._log_odds = math.log(contact_threshold / max(1.0 - contact_threshold, 1e-12))

    def __call__(self, seen: LawOutput, reading_n: Array) -> Judgement:
        """The judgement of one reading (M,); `seen` is a batch of one."""
        evidence = seen.contact_evidence[0]
        segment = int(evidence.argmax())
        top = float(evidence[segment])
        contact = top + math.log(float(np.exp(evidence - top).sum()))
        weights = np.exp(np.array([0.0, *evidence.tolist()]) - max(contact, 0.0))
        probabilities = weights / weights.sum()
        touched = contact >= self._log_odds

        known = self._force_is_known(seen, segment)
        rivals = sorted(
            self._rivals_of_stated(seen, touched=touched, known=known),
            key=lambda rival: -rival.log_weight,
        )
        best = rivals[0]
        stated = max(contact, 0.0)
        others = sum(math.exp(min(rival.log_total - stated, 50.0)) for rival in rivals)
        doubted = others / (1.0 + others) > CONTACT_DOUBTED_ABOVE
        misfit = float((seen.contact_chi2 if touched else seen.free_chi2)[0])
        numbers = seen.innovation_n.shape[1]
        limit = largest_chi2(numbers - _CONTACT_NUMBERS if touched else numbers)
        fits = misfit <= limit
        state, doubt = self._state(best, known, touched=touched, doubted=doubted, fits=fits)
        if doubt and best.log_weight < stated - 5.0:
            doubt = "no single contact and no single fault explains the reading"
        if state in (ContactState.CONTACT, ContactState.MOMENT) and self._slips(seen):
            state = ContactState.UNCONFIRMED
            doubt = "several contacts: a single one would push along the arm more than it can rub"
        return Judgement(state, segment + 1, probabilities, doubt, known, misfit, limit)

    def batch(self, seen: LawOutput, readings_n: Array) -> Judgements:
        """The judgements of readings (B, M), with all that those of single ones state."""
        judged = [self(seen.row(row), reading_n) for row, reading_n in enumerate(readings_n)]
        state = np.empty(len(judged), dtype=object)
        state[:] = [each.state for each in judged]
        return Judgements(
            state=state,
            segment=np.array([each.segment for each in judged], dtype=np.int64),
            probabilities=np.array([each.probabilities for each in judged]),
            doubt=tuple(each.doubt for each in judged),
            force_known=np.array([each.force_known for each in judged], dtype=bool),
            misfit=np.array([each.misfit for each in judged]),
            misfit_limit=np.array([each.misfit_limit for each in judged]),
        )

    def _state(
        self, best: _Rival, known: bool, *, touched: bool, doubted: bool, fits: bool
    ) -> tuple[ContactState, str]:
        if not touched:
            if fits and not (doubted and best.fault and best.log_weight > 0.0):
                return ContactState.FREE, ""
            return ContactState.IMPLAUSIBLE, best.sentence
        if not fits:
            state = ContactState.IMPLAUSIBLE if best.fault else ContactState.UNCONFIRMED
            return state, best.sentence
        if doubted:
            return ContactState.UNCONFIRMED, best.sentence
        return (ContactState.CONTACT if known else ContactState.MOMENT), ""

    def _force_is_known(self, seen: LawOutput, link: int) -> bool:
        """Whether readings determine the lateral force; else the moment about the joint is.

        Near the joint a force may be any, so that its mean is far outside its interval, or at one
        end of it where the other ends at the largest force that is expected. Where the place is
        given, the moment in place of the force would say no more.
        """
        low_n, high_n = seen.magnitude_ci95_n[0].tolist()
        _, y, z = seen.force_n[0].tolist()
        size_n = math.hypot(y, z)
        farther_n = max(high_n - size_n, size_n - low_n)
        is_narrow = farther_n <= max(self._known_n, _KNOWN_SHARE_OF_FORCE * size_n)
        evidence = seen.contact_evidence[0]
        on_all = float(np.exp(evidence - evidence[link]).sum())  # of which 1 is on the link
        is_there = on_all - 1.0 <= CONTACT_DOUBTED_ABOVE
        place_is_given = bool(self._is_one_place[link]) and is_there
        return (is_narrow or place_is_given) and low_n <= size_n <= high_n

    def _link(self, number: int) -> str:
        """A link's name in a sentence: `segment 2` of an arm."""
        return self._links[number].replace("segment_", "segment ")

    def _slips(self, seen: LawOutput) -> bool:
        """Whether the force is outside the cone of friction, with 95 % confidence."""
        along_n, y, z = seen.force_n[0].tolist()
        along_std_n = float(seen.contact_covariance[0, 1, 1]) ** 0.5
        least_n = abs(along_n) - NORMAL_95 * along_std_n
        return self._friction > 0.0 and least_n > self._friction * math.hypot(y, z)

    def _rivals_of_stated(
        self, seen: LawOutput, *, touched: bool, known: bool
    ) -> Iterator[_Rival]:
        """What else may be behind the reading than the likelier of "a contact" and "nothing".

        Where a contact is stated (`touched`), "nothing" is one of its rivals. Where of its force
        the moment alone is stated (not `known`), what has the same moment is none.
        """
        if touched:
            yield _Rival(0.0, 0.0, "nothing touches the arm")
        for rival in self._neither_one_contact_nor_nothing(seen):
            if known or not rival.same_moment:
                yield rival

    def _neither_one_contact_nor_nothing(self, seen: LawOutput) -> Iterator[_Rival]:
        """Faults, exchanged channels and several contacts: rivals of whatever is stated."""
        each = LOG_PRIOR_FAULT - math.log(len(self._names))
        faulty = seen.faulty_evidence[0]
        channel = int(faulty.argmax())
        likeliest = float(faulty[channel])
        off_n = float(seen.fault_n[0, channel])
        much = "much" if off_n > 0.0 else "little"
        yield _Rival(
            likeliest + each,
            likeliest + each + math.log(float(np.exp(faulty - likeliest).sum())),
            f"{self._names[channel]} reads {abs(off_n):.1f} {self._units[channel]} too {much}, "
            "and nothing touches the arm",
            fault=True,
        )
        beside = seen.faulty_segment_evidence[0]
        channel, of_segment = divmod(int(beside.argmax()), beside.shape[1])
        weight = float(beside[channel, of_segment]) + each
        yield _Rival(
            weight,
            weight,
            f"{self._names[channel]} is wrong, beside a contact on {self._link(of_segment)}",
            fault=True,
        )
        pair_count = len(self._names) * (len(self._names) - 1) // 2
        if pair_count:
            exchanged = seen.exchanged_evidence[0]
            likeliest_pair = np.unravel_index(int(exchanged.argmax()), exchanged.shape)
            pair = sorted(int(number) for number in likeliest_pair)
            log_prior = LOG_PRIOR_EXCHANGED - math.log(pair_count)
            weight = float(exchanged[pair[0], pair[1]]) + log_prior
            names = " and ".join(self._names[number] for number in pair)
            yield _Rival(weight, weight, f"{names} are exchanged", fault=True)
        if not self._is_one_place.all():
            wrench = np.where(self._is_one_place, -np.inf, seen.segment_evidence[0])
            segment = int(wrench.argmax())
            weight = float(wrench[segment]) + LOG_PRIOR_SEVERAL_ON_ONE_LINK
            yield _Rival(
                weight,
                weight,
                f"several contacts or a couple on {self._link(segment)}",
                same_moment=segment == int(seen.contact_evidence[0].argmax()),
            )
        if len(self._links) > 1:
            weight = float(seen.several_evidence[0]) + LOG_PRIOR_ON_SEVERAL_LINKS
            yield _Rival(weight, weight, "contacts on several segments")


@cache
def largest_chi2(numbers: int) -> float:
    """χ² of residuals up to which they count as noise; of no residual any will do."""
    return limit_at(MISFIT_BELOW, numbers) if numbers > 0 else math.inf
