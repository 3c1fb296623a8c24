"""Files from outside: regular, and no larger than what they are said to be can be."""

from __future__ import annotations

import os
import stat
from pathlib import Path

from cablesense_base.errors import CableSenseError


def read_bounded_bytes(
    path: str | Path, max_bytes: int, what: str, refusal: type[CableSenseError]
) -> bytes:
    """The content of a regular file.

    It is the opened file that is looked at, so that none can be put in its place between.

    Args:
        path: of the file.
        max_bytes: a larger one is refused unread.
        what: the file should be, for errors ("an arm file").
        refusal: the error to raise.

    Raises:
        CableSenseError: of the class `refusal`: missing, no file, or too large.
    """
    try:
        # a pipe without a writer would keep a plain open waiting for ever
        number = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
        with open(number, "rb") as file:  # noqa: PTH123  (a number has no path)
            status = os.fstat(number)
            if not stat.S_ISREG(status.st_mode):
                raise refusal(f"{path}: not a file; {what} is one")
            if status.st_size <= max_bytes:
                content = file.read(max_bytes + 1)
                if len(content) <= max_bytes:
                    return content
    except IsADirectoryError as error:
        raise refusal(f"{path}: not a file; {what} is one") from error
    except (OSError, ValueError) as error:
        why = error.strerror if isinstance(error, OSError) else str(error)
        raise refusal(
            f"{_shown(path)}: cannot be read ({why}); give the path of {what}"
        ) from error
    raise refusal(f"{path}: larger than {max_bytes} bytes, so not {what}")


def read_bounded_text(
    path: str | Path, max_bytes: int, what: str, refusal: type[CableSenseError]
) -> str:
    """The text of a regular file; as `read_bounded_bytes`.

    Raises:
        CableSenseError: of the class `refusal`: as `read_bounded_bytes`, or no UTF-8 text.
    """
    try:
        return read_bounded_bytes(path, max_bytes, what, refusal).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise refusal(
            f"{path}: cannot be read as text (byte {error.start} is no UTF-8); {what} is text"
        ) from error


def _shown(path: str | Path) -> str:
    """A path in an error: one with a null in it, or without end, is data too."""
    text = str(path)
    return text if len(text) < 200 and text.isprintable() else repr(text[:100])
