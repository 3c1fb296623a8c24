"""The stamp of a serialized message (CDR) that begins with a header: read, and replaced."""

from __future__ import annotations

import struct

from cablesense_msgs_py.contract_error import ContractError

_AT = 4
_END = 12
_STAMPS = {b"\0\0": struct.Struct(">iI"), b"\0\1": struct.Struct("<iI")}


def stamp_ns(raw: bytes) -> int:
    """Its stamp, ns; 0 when the publisher set none.

    Raises:
        ContractError: the bytes are no message with a header.
    """
    layout = _STAMPS.get(raw[:2])
    if layout is None or len(raw) < _END:
        raise ContractError(
            f"{len(raw)} bytes beginning {raw[:4].hex()} are no message with a stamp in plain CDR"
        )
    seconds, nanoseconds = layout.unpack_from(raw, _AT)
    return int(seconds) * 1_000_000_000 + int(nanoseconds)


def restamped(raw: bytes, stamp: int) -> bytes:
    """The same message with another stamp, ns.

    Raises:
        ContractError: the bytes are no message with a header.
    """
    stamp_ns(raw)
    return raw[:_AT] + _STAMPS[raw[:2]].pack(*divmod(stamp, 1_000_000_000)) + raw[_END:]
