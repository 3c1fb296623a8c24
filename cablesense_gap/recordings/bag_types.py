"""Recorded messages from their bytes, without a ROS installation."""

from __future__ import annotations

from typing import Any

import numpy as np


class BagTypes:
    """The standard messages of ROS 2 Jazzy."""

    def __init__(self) -> None:
        from rosbags.typesys import Stores, get_typestore

        self._store = get_typestore(Stores.ROS2_JAZZY)

    def message(self, kind: str, data: bytes) -> Any:
        """A message of its type's full name and its bytes (CDR).

        What publishers leave behind its end is not looked at. Bytes that are none raise anything
        that a parser can.
        """
        definition = self._store.get_msgdef(kind)
        little = bytes(data[:2]) == b"\x00\x01"
        read = definition.deserialize_cdr_le if little else definition.deserialize_cdr_be
        return read(
            np.frombuffer(data, dtype=np.uint8)[4:].tobytes(), 0, definition.cls, self._store
        )[0]
