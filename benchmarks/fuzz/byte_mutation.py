"""Bytes changed: bits turned, cut short, repeated, mixed with others, numbers put in."""

from __future__ import annotations

import random
import struct
from collections.abc import Sequence

NUMBERS = (
    *(struct.pack("<Q", n) for n in (0, 1, 2**31 - 1, 2**31, 2**32 - 1, 2**63 - 1, 2**64 - 1)),
    *(struct.pack("<I", n) for n in (0, 1, 2**16, 2**30, 2**31 - 1, 2**32 - 1)),
    *(struct.pack("<d", n) for n in (float("nan"), float("inf"), -float("inf"), 1e308, -1e308)),
    *(struct.pack("<f", n) for n in (float("nan"), float("inf"), 3e38)),
    b"\x00",
    b"\xff",
    b"\x80\x80\x80\x80\x80\x80\x80\x80\x80\x01",
)


def mutated_bytes(
    rng: random.Random, data: bytes, others: Sequence[bytes] = (), most: int = 4
) -> bytes:
    """Between one and `most` changes of `data`; pieces may come from `others`."""
    changed = bytearray(data)
    for _ in range(rng.randint(1, most)):
        _CHANGES[rng.randrange(len(_CHANGES))](rng, changed, others or (data,))
    return bytes(changed)


def _span(rng: random.Random, data: bytes | bytearray) -> slice:
    at = rng.randrange(len(data) + 1)
    return slice(at, min(len(data), at + int(2 ** rng.uniform(0, 9))))


def _turn_bits(rng: random.Random, data: bytearray, others: Sequence[bytes]) -> None:
    for _ in range(rng.choice((1, 1, 2, 8))):
        if data:
            data[rng.randrange(len(data))] ^= 1 << rng.randrange(8)


def _cut(rng: random.Random, data: bytearray, others: Sequence[bytes]) -> None:
    del data[rng.randrange(len(data) + 1) :]


def _take_out(rng: random.Random, data: bytearray, others: Sequence[bytes]) -> None:
    del data[_span(rng, data)]


def _repeat(rng: random.Random, data: bytearray, others: Sequence[bytes]) -> None:
    span = _span(rng, data)
    data[span.stop : span.stop] = bytes(data[span]) * rng.randint(1, 3)


def _splice(rng: random.Random, data: bytearray, others: Sequence[bytes]) -> None:
    other = rng.choice(others)
    data[_span(rng, data)] = other[_span(rng, other)]


def _put_number(rng: random.Random, data: bytearray, others: Sequence[bytes]) -> None:
    number = rng.choice(NUMBERS)
    if rng.random() < 0.3:
        number = number[::-1]
    at = rng.randrange(len(data) + 1)
    data[at : at + len(number)] = number


def _put_noise(rng: random.Random, data: bytearray, others: Sequence[bytes]) -> None:
    data[_span(rng, data)] = rng.randbytes(rng.randint(1, 32))


_CHANGES = (_turn_bits, _turn_bits, _cut, _take_out, _repeat, _splice, _put_number, _put_noise)
