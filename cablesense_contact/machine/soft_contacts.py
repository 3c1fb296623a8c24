"""Contacts on machines whose readings do not determine their pose, as they have fewer channels.

A soft machine gives way under a contact, and how far it does depends on which contact it is. So
what a reading says of a contact is taken linear about the machine at rest under that contact, and
what it says of an untouched machine about the untouched one. Contacts are sought from several
links, as from a wrong one Newton's steps may lead to another that explains the reading worse. On
the search the slope of the machine's forces is that of the untouched one; what is stated has its
own.

Evidence is against "nothing touches". Observations x about a touched machine have the covariance
S, those about the untouched one, x_0, the covariance S_0; evidence e of the former becomes

    ln e + ln N(x; 0, S) - ln N(x_0; 0, S_0),

and each link has the largest that any pose of the search gives it.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple, Protocol

import numpy as np

from cablesense_base import Array
from cablesense_contact.machine.observation import Observation, Observer, OperatingPoint
from cablesense_sim.machine.description import MachineError
from cablesense_sim.machine.statics import LinkForce

_STARTS = 5
"""Links from which a contact is sought, evenly along all."""
_STEPS_OF_A_START = 2
"""Newton's steps of the force from each of them."""
_REFINEMENTS = 2
"""Times that the likeliest contact of all is refined, at most."""

_OF_CONTACTS = (
    "contact_evidence",
    "segment_evidence",
    "several_evidence",
    "faulty_segment_evidence",
)
"""Outputs of a statement that are evidence of contacts."""

_OF_UNTOUCHED = ("faulty_evidence", "exchanged_evidence", "free_chi2", "fault_n")
"""Outputs that say something of the untouched machine."""


class Stating(Protocol):
    """Makes statements of observations."""

    def __call__(
        self, observed: Sequence[Observation], log_share: Array | None = None
    ) -> Mapping[str, Array]:
        """Outputs by name; `log_share` (B, N) is added to the log evidence of the N links."""
        ...


class Reading(NamedTuple):
    """A reading, and what is known of the machine.

    Attributes:
        values: (M,) of the channels.
        command: (C,).
        mean, covariance: (P,) and (P, P) of the parameters.
        unrest: (n, n) covariance of forces by motion.
    """

    values: Array
    command: Array
    mean: Array
    covariance: Array
    unrest: Array


class Explained(NamedTuple):
    """What one reading says, about one pose.

    Attributes:
        observation: linear about it.
        stated: the outputs of the statement on it, batches of one.
    """

    observation: Observation
    stated: Mapping[str, Array]

    @property
    def log_evidence(self) -> Array:
        """(N,) of a contact on each link."""
        return np.asarray(self.stated["contact_evidence"][0])

    @property
    def likeliest(self) -> LinkForce:
        """The likeliest contact."""
        link = int(self.log_evidence.argmax())
        point_m = np.array([float(self.stated["place_m"][0]), 0.0, 0.0])
        return LinkForce(link, point_m, self.stated["force_n"][0])

    @property
    def log_density(self) -> float:
        """The logarithm of N(x; 0, S), -½ (χ² + ln det S), without what is the same for all."""
        log_information = float(np.linalg.slogdet(self.observation.information)[1])
        return 0.5 * (log_information - float(self.stated["free_chi2"][0]))


class SoftAnswer(NamedTuple):
    """What one reading says in the end.

    Attributes:
        observation: linear about the machine under the likeliest contact.
        untouched: the one about the untouched machine, of which calibrations are made.
        stated: the outputs of the statement, batches of one.
    """

    observation: Observation
    untouched: Observation
    stated: Mapping[str, Array]


class SoftContacts:
    """Explains readings of one machine."""

    def __init__(self, observer: Observer, state: Stating) -> None:
        links = observer.machine.links
        count = len(links.names)
        starts = (np.arange(_STARTS) + 0.5) * count / _STARTS
        self._observer = observer
        self._state = state
        self._starts = np.unique(starts.astype(int)).tolist()
        self._middle_m = links.touched_m.mean(axis=1)
        self._largest_n = observer.machine.source.file.touch.largest_n

    def answer(self, reading: Reading) -> SoftAnswer:
        """What a reading says of the machine.

        Raises:
            MachineError: the untouched machine finds no rest at the command.
        """
        untouched_pose = self._observer.untouched_pose(reading.command, reading.mean)
        untouched = self._explained(self._observed(OperatingPoint(untouched_pose), reading))
        explanations = [untouched, *self._from_starts(untouched, reading)]
        best = max(explanations, key=_strength)
        for refined in self._refinements(best, untouched, reading):
            best = refined
            explanations.append(refined)
        log_evidence = np.max([one.log_evidence for one in explanations], axis=0)
        if log_evidence.max() <= 0.0:
            best = untouched
        log_share = log_evidence - best.log_evidence
        restated = Explained(
            best.observation, self._state([best.observation], log_share[np.newaxis])
        )
        stated = _against(untouched, restated).stated
        return SoftAnswer(best.observation, untouched.observation, stated)

    def _from_starts(self, untouched: Explained, reading: Reading) -> Iterator[Explained]:
        """Roughly about the rests under the best forces in the middle of some links."""
        slope = untouched.observation.load_slope
        for link in self._starts:
            seen = untouched.observation
            for _ in range(_STEPS_OF_A_START):
                operating_point = self._under(self._contact_on(link, seen), seen, reading)
                if operating_point is None:
                    break
                seen = self._observed(operating_point._replace(load_slope=slope), reading)
            if seen is not untouched.observation:
                yield _against(untouched, self._explained(seen))

    def _refinements(
        self, start: Explained, untouched: Explained, reading: Reading
    ) -> Iterator[Explained]:
        """About the rests under ever likelier contacts, from that of a rough explanation on."""
        best = start
        for number in range(_REFINEMENTS):
            if _strength(best) <= 0.0:
                return
            operating_point = self._under(best.likeliest, best.observation, reading)
            if operating_point is None:
                return
            refined = _against(
                untouched, self._explained(self._observed(operating_point, reading))
            )
            if number > 0 and _strength(refined) <= _strength(best):
                return
            best = refined
            yield best

    def _explained(self, seen: Observation) -> Explained:
        """An observation with the statement on it."""
        return Explained(seen, self._state([seen]))

    def _observed(self, operating_point: OperatingPoint, reading: Reading) -> Observation:
        """The observation in a reading, linear about a pose."""
        return self._observer.observe(
            reading.values,
            reading.command,
            reading.mean,
            reading.covariance,
            reading.unrest,
            operating_point,
        )

    def _under(
        self, contact: LinkForce, near: Observation, reading: Reading
    ) -> OperatingPoint | None:
        """The rest under a contact, near another pose; None if the machine does not bear it."""
        try:
            pose = self._observer.pose_under(contact, reading.command, reading.mean, near)
        except MachineError:
            return None
        return OperatingPoint(pose)

    def _contact_on(self, link: int, seen: Observation) -> LinkForce:
        """The force across the middle of a link that explains an observation best."""
        across = seen.levers[link, 1:3] + self._middle_m[link] * seen.levers[link, 4:6]
        by_force = seen.by_torque @ across.T
        informed = by_force.T @ seen.information
        precision = informed @ by_force + np.eye(2) / self._largest_n**2
        lateral_n = np.linalg.solve(precision, informed @ seen.innovation)
        size_n = float(np.linalg.norm(lateral_n))
        lateral_n = lateral_n * (self._largest_n / max(size_n, self._largest_n))
        point_m = np.array([self._middle_m[link], 0.0, 0.0])
        return LinkForce(link, point_m, np.append(0.0, lateral_n))


def _strength(explained: Explained) -> float:
    """The log evidence of the likeliest contact."""
    return float(explained.log_evidence.max())


def _against(untouched: Explained, touched: Explained) -> Explained:
    """A statement about a touched machine, with evidence against the untouched one."""
    gained = touched.log_density - untouched.log_density
    stated = dict(touched.stated)
    for name in _OF_CONTACTS:
        stated[name] = stated[name] + gained
    for name in _OF_UNTOUCHED:
        stated[name] = untouched.stated[name]
    return Explained(touched.observation, stated)
