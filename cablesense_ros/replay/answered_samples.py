"""Recorded samples beside the answers that they got."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator
from struct import Struct
from typing import NamedTuple

from cablesense_gap.recordings.mcap_messages import RawMessage
from cablesense_msgs_py import topics
from cablesense_msgs_py.contract_error import ContractError
from cablesense_msgs_py.stamped_bytes import stamp_ns
from cablesense_msgs_py.topic_types import of_contract

_WRENCH = Struct("<6d")

WINDOW_NS = 2_000_000_000
"""An answer that has not come this long after its sample never came; far longer than any takes."""


class AnsweredSample(NamedTuple):
    """A sample, and the wrench with its stamp.

    Attributes:
        stamp_ns: of both.
        log_ns: when the sample was recorded.
        sample: serialized `JointState`.
        answer: serialized `WrenchStamped`; none where the estimator took no notice of the sample:
            it was not running, did not get it, or refused its stamp.
    """

    stamp_ns: int
    log_ns: int
    sample: bytes
    answer: bytes | None


class AnsweredSamples:
    """Pairs samples and answers by their stamps, in the order of the samples.

    Attributes:
        unstamped: samples without a stamp, or that are no messages: no answer can be told theirs.
        lone_contacts: answers with a contact whose sample the recording lacks.
        lone_zeros: zero wrenches with no sample's stamp: the estimator's word in a silence, or at
            a sample whose stamp it refused.
    """

    def __init__(self) -> None:
        self.unstamped = 0
        self.lone_contacts = 0
        self.lone_zeros = 0
        self._samples: deque[tuple[int, int, bytes]] = deque()
        self._answers: dict[int, tuple[int, bytes]] = {}

    def of(self, messages: Iterable[RawMessage]) -> Iterator[AnsweredSample]:
        """The samples among messages of one arm, in the order they were recorded."""
        for message in messages:
            topic = of_contract(message.topic)
            if topic == topics.CABLE_TENSIONS:
                stamp = _stamp(message.data)
                if stamp:
                    self._samples.append((stamp, message.log_ns, message.data))
                else:
                    self.unstamped += 1
            elif topic == topics.WRENCH:
                self._answers[_stamp(message.data)] = (message.log_ns, message.data)
            else:
                continue
            yield from self._settled(message.log_ns - WINDOW_NS)
        yield from self._settled(2**63)

    def _settled(self, before_ns: int) -> Iterator[AnsweredSample]:
        while self._samples:
            stamp, log_ns, sample = self._samples[0]
            if stamp not in self._answers and log_ns >= before_ns:
                break
            self._samples.popleft()
            _, answer = self._answers.pop(stamp, (0, None))
            yield AnsweredSample(stamp, log_ns, sample, answer)
        while self._answers:
            stamp, (log_ns, answer) = next(iter(self._answers.items()))
            if log_ns >= before_ns - WINDOW_NS:
                break
            del self._answers[stamp]
            if shows_contact(answer):
                self.lone_contacts += 1
            else:
                self.lone_zeros += 1


def shows_contact(answer: bytes) -> bool:
    """Whether a serialized `WrenchStamped` is anything but zero."""
    return len(answer) < _WRENCH.size or any(_WRENCH.unpack(answer[-_WRENCH.size :]))


def _stamp(raw: bytes) -> int:
    try:
        return stamp_ns(raw)
    except ContractError:
        return 0
