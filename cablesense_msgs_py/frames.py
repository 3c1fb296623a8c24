"""Frame names: `base_link` and `segment_1` … `segment_N`, each with an optional prefix."""

from __future__ import annotations

import re
from dataclasses import dataclass

from cablesense_msgs_py.contract_error import ContractError

_SHOWN_CHARACTERS = 40


@dataclass(frozen=True)
class Frames:
    """The frames of an arm of `segment_count` segments; `prefix` goes before each name."""

    segment_count: int
    prefix: str = ""

    @property
    def base(self) -> str:
        """The base frame (REP-105)."""
        return f"{self.prefix}base_link"

    def segment(self, number: int) -> str:
        """The frame of segment `number`, counted from 1."""
        return f"{self.prefix}segment_{number}"

    def segment_number(self, frame_id: str) -> int:
        """The number in a segment's frame name.

        Raises:
            ContractError: the frame is not one of this arm's segments.
        """
        match = re.fullmatch(re.escape(self.prefix) + r"segment_([1-9][0-9]{0,3})", frame_id)
        number = int(match.group(1)) if match else 0
        if not 1 <= number <= self.segment_count:
            shown = frame_id[:_SHOWN_CHARACTERS]
            raise ContractError(
                f"header.frame_id is {shown!r}; it must be one of {self.segment(1)} … "
                f"{self.segment(self.segment_count)}"
            )
        return number
