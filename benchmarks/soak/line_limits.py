"""What bus and adapter can carry of a map's frames: arithmetic, not measurement."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

BITRATES_BIT_S = (500_000, 1_000_000)
SERIAL_BYTES_S = {
    "serial 115,200 bit/s": 11_520,
    "serial 1 Mbit/s": 100_000,
    "serial 3 Mbit/s": 300_000,
    "USB CDC, full speed (19 bulk packets of 64 bytes a ms)": 1_216_000,
}
"""A byte on a serial line is ten bits."""


def frame_bits(data_bytes: int) -> int:
    """Bits of a classical frame with an id of 11 bits, worst stuffing and the space after it."""
    return 47 + 8 * data_bytes + (34 + 8 * data_bytes - 1) // 4


def line_bytes(data_bytes: int) -> int:
    """Bytes of a frame over slcan: `tIIIL`, two digits a byte, and a return."""
    return 6 + 2 * data_bytes


def line_limits(data_bytes: Sequence[int], rate_hz: float) -> dict[str, Any]:
    """Loads and limits of a cycle whose frames have so many data bytes each."""
    bits = sum(map(frame_bits, data_bytes))
    line = sum(map(line_bytes, data_bytes))
    return {
        "frames of a cycle": len(data_bytes),
        "bytes of a cycle over slcan": line,
        "frames (1/s)": len(data_bytes) * rate_hz,
        "bytes over slcan (1/s)": line * rate_hz,
        "bus": {
            f"{bitrate // 1000} kbit/s": {
                "load": round(bits * rate_hz / bitrate, 3),
                "most cycles (1/s)": bitrate // bits,
            }
            for bitrate in BITRATES_BIT_S
        },
        "adapter line": {
            name: {
                "load": round(line * rate_hz / bytes_s, 3),
                "most cycles (1/s)": bytes_s // line,
            }
            for name, bytes_s in SERIAL_BYTES_S.items()
        },
    }
