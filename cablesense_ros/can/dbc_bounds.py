"""Sizes in a DBC file, looked at before cantools does.

cantools takes memory for every bit of a message before it compares a signal with its message, so
that one line of text could ask for all there is.
"""

from __future__ import annotations

import re

from cablesense_ros.can.channel_map import ChannelMapError

MOST_BYTES = 1785
"""Of the longest message that travels over CAN: that of J1939's transport protocol."""

MOST_SIGNAL_BITS = 64

_TOKEN = re.compile(
    r'"(?:\\"|[^"])*"|(?P<comment>//.*)|(?P<number>\d+)|(?P<sign>[:|@])|\w+|[^\s\w]'
)
_LIMITS = {
    (":", None): (MOST_BYTES, "a message of bytes"),
    (":", "|"): (8 * MOST_BYTES, "a signal from bit"),
    ("|", "@"): (MOST_SIGNAL_BITS, "a signal of bits"),
}
"""The most that a number between two signs may be, and what it is; None stands for no sign."""


def require_bounded_sizes(text: str, source: str) -> None:
    """Refuse DBC text with messages or signals that no bus carries; `source` names it in errors.

    Raises:
        ChannelMapError: names the line, the number, and what it may be.
    """
    sign: str | None = None
    number: re.Match[str] | None = None
    for token in _TOKEN.finditer(text):
        if token["comment"]:
            continue
        if number is not None and (sign, token["sign"]) in _LIMITS:
            most, what = _LIMITS[sign or "", token["sign"]]
            if len(number[0]) > 9 or int(number[0]) > most:
                line = text.count("\n", 0, number.start()) + 1
                raise ChannelMapError(
                    f"{source}: line {line}: {what} {number[0][:20]}; it must be at most {most}"
                )
        if token["number"] and number is None:
            number = token
        else:
            sign, number = token["sign"], None
