"""Answers of a replay beside the recorded ones, byte by byte."""

from __future__ import annotations

import struct
from dataclasses import dataclass
from typing import Any

from cablesense_msgs_py.contract_error import ContractError
from cablesense_msgs_py.stamped_bytes import stamp_ns
from cablesense_ros.replay.answered_samples import shows_contact


@dataclass
class Comparison:
    """Counts, and the first difference in words.

    Attributes:
        samples: recorded, with a stamp.
        compared: those whose answer is recorded and whose state the journal tells.
        identical: those of which every byte of the wrench is the same.
        contacts: those compared whose recorded answer is a contact.
        unanswered: of which the estimator took no notice.
        before_journal: answered, but the recording does not say what the answers rest on.
        unstamped, lone_contacts, lone_zeros: as in `AnsweredSamples`.
        first_difference: empty where there is none.
    """

    samples: int = 0
    compared: int = 0
    identical: int = 0
    contacts: int = 0
    unanswered: int = 0
    before_journal: int = 0
    unstamped: int = 0
    lone_contacts: int = 0
    lone_zeros: int = 0
    first_difference: str = ""

    def compare(self, number: int, recorded: bytes, replayed: bytes | None) -> None:
        """The answer to a sample; `replayed` is none where the replay gave none.

        Args:
            number: of the sample, from 1.
            recorded: serialized `WrenchStamped`.
            replayed: the same.
        """
        self.compared += 1
        self.contacts += shows_contact(recorded)
        if recorded == replayed:
            self.identical += 1
        elif not self.first_difference:
            there = "nothing" if replayed is None else _words(replayed)
            self.first_difference = (
                f"sample {number}, stamp {stamp_ns(recorded)}: {_words(recorded)} recorded, "
                f"{there} replayed"
            )

    @property
    def same(self) -> bool:
        """Whether there was something to compare, and no difference."""
        return 0 < self.compared == self.identical

    def as_json(self) -> dict[str, Any]:
        """The counts, for a machine."""
        return dict(vars(self))


def _words(raw: bytes) -> str:
    """Frame and numbers of a serialized `WrenchStamped`, or its bytes."""
    try:
        (length,) = struct.unpack_from("<I", raw, 12)
        frame = raw[16 : 16 + length].rstrip(b"\0").decode()
        numbers = " ".join(map(repr, struct.unpack("<6d", raw[-48:])))
    except (struct.error, UnicodeDecodeError, ContractError):
        return raw.hex()
    return f"{frame} {numbers}"
