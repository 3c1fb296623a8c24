"""Contacts on machines whose readings do not determine their pose, as they have fewer channels.

A soft machine gives way under a contact, and how far it does depends on which contact it is. So
what a reading says of a contact is taken linear about the machine at rest under that contact, and
what it says of an untouched machine about the untouched one. Each contact is refined from several
starts, as a wrong one may lead to another that explains the reading worse.

Evidence is against "nothing touches". With observations x of covariance S, its density about
another pose than the untouched machine's is replaced:

    ln e = ln e' + ln N(x'; 0, S') - ln N(x; 0, S),

with e' and x' about the contact, and x about the untouched machine.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from cablesense_base import Array
from cablesense_contact.machine.observation import Observation, Observer
from cablesense_sim.machine.description import MachineError
from cablesense_sim.machine.statics import LinkForce

_STARTS = 4
"""Links from which a contact is sought, evenly along all."""
_REFINEMENTS = 2
"""Times that the best contact is refined, at most."""

_OF_CONTACTS = (
    "contact_evidence",
    "segment_evidence",
    "several_evidence",
    "faulty_segment_evidence",
)
"""Outputs that are evidence of contacts."""

_OF_UNTOUCHED = ("faulty_evidence", "exchanged_evidence", "free_chi2", "fault_n")
"""Outputs that say something of the untouched machine."""


class Explained(NamedTuple):
    """What one reading says.

    Attributes:
        observation: linear about the machine under the likeliest contact.
        stated: the outputs of the statement, batches of one.
    """

    observation: Observation
    stated: Mapping[str, Array]
    link: int = 0
    raw: Mapping[str, Array] = {}

    @property
    def evidence(self) -> float:
        """Of the likeliest contact."""
        return float(self.stated["contact_evidence"].max())

    @property
    def likeliest(self) -> LinkForce:
        """The likeliest contact."""
        link = int(self.stated["contact_evidence"][0].argmax())
        point_m = np.array([float(self.stated["place_m"][0]), 0.0, 0.0])
        return LinkForce(link, point_m, self.stated["force_n"][0])


class SoftContacts:
    """Explains readings of one machine."""

    def __init__(
        self, observer: Observer, state: Callable[[Sequence[Observation]], dict[str, Any]]
    ) -> None:
        """`state` makes statements of observations."""
        self._observer = observer
        self._state = state
        links = observer.machine.links
        self._middle_m = links.touched_m.mean(axis=1)
        count = len(links.names)
        starts = (np.arange(_STARTS) + 0.5) * count / _STARTS
        self._starts = np.unique(starts.astype(int)).tolist()
        self._largest_n = observer.machine.source.file.touch.largest_n

    def explained(
        self, reading: Array, command: Array, mean: Array, covariance: Array, unrest: Array
    ) -> Explained:
        """What a reading (M,) says at a command; see `Observer.observe`."""
        observer = self._observer

        def about(pose: Array | None) -> Explained:
            seen = observer.observe(reading, command, mean, covariance, unrest, pose)
            return Explained(seen, self._state([seen]))

        untouched = about(observer.untouched_pose(command, mean))

        def under(contact: LinkForce, near: Array) -> Explained | None:
            try:
                pose = observer.pose_under(contact, command, mean, near)
            except MachineError:
                return None
            return _against(untouched, about(pose), contact.link)

        found = []
        for link in self._starts:
            seen = untouched.observation
            new = None
            for _ in range(PRE):
                one = under(self._contact_on(link, seen), seen.pose)
                if one is None: break
                new = one
                seen = new.observation
            if new is not None: found.append(new)
        if LEAST:
            found.append(_against(untouched, about(None), -99))
            l = found[-1]; found[-1] = l._replace(link=l.likeliest.link)
        if not found: return untouched
        best = max(found, key=lambda one: one.evidence)
        for _ in range(_REFINEMENTS):
            if best.evidence <= 0.0:
                break
            refined = under(best.likeliest, best.observation.pose)
            if refined is None or refined.evidence <= best.evidence:
                break
            best = refined
            found.append(best)
        links = np.arange(len(self._middle_m))
        all_e = np.array([one.stated["contact_evidence"][0] for one in found])
        if STITCH == "max":
            stitched = all_e.max(axis=0)
        elif STITCH == "near":
            dist = np.abs(np.array([one.link for one in found])[:, None] - links).astype(float)
            dist += 1e-3 * np.arange(len(found))[::-1, None]
            stitched = all_e[dist.argmin(axis=0), links]
        else:
            return best
        raw = best.raw["contact_evidence"][0]
        stated = self._state([best.observation], (stitched - raw)[None])
        return _against(untouched, Explained(best.observation, stated, best.link, stated), best.link, shared=True)

    def _contact_on(self, link: int, seen: Observation) -> LinkForce:
        levers = seen.levers[link]
        by_force = seen.by_torque @ (levers[:3] + self._middle_m[link] * levers[3:]).T
        informed = by_force.T @ seen.information
        precision = informed @ by_force + np.eye(3) / self._largest_n**2
        force_n = np.linalg.solve(precision, informed @ seen.innovation)
        force_n *= min(1.0, self._largest_n / float(np.linalg.norm(force_n)))
        point_m = np.array([float(self._middle_m[link]), 0.0, 0.0])
        return LinkForce(link, point_m, force_n)

import os
LEAST=bool(int(os.environ.get("LEAST","1")))
_STARTS=int(os.environ.get("STARTS","4"))
PRE=int(os.environ.get("PRE","2"))
STITCH=os.environ.get("STITCH","near")
_REFINEMENTS=int(os.environ.get("REF","2"))

def _against(untouched: Explained, touched: Explained, link: int, shared: bool=False) -> Explained:
    """A statement about a touched machine, with evidence against the untouched one."""
    gained = _log_density(touched) - _log_density(untouched)
    stated = dict(touched.stated)
    for name in _OF_CONTACTS:
        if shared and name == "contact_evidence":
            continue
        stated[name] = stated[name] + gained
    for name in _OF_UNTOUCHED:
        stated[name] = untouched.stated[name]
    return Explained(touched.observation, stated, link, touched.stated)


def _log_density(explained: Explained) -> float:
    """-½ (χ² + ln det S) of nothing that touches, without what is the same for all."""
    log_information = float(np.linalg.slogdet(explained.observation.information)[1])
    return 0.5 * (log_information - float(explained.stated["free_chi2"][0]))
