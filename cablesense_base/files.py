"""Files: read if regular and no larger than their kind can be, written whole or not at all."""

from __future__ import annotations

import errno
import os
import stat
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from cablesense_base.errors import CableSenseError


def read_bounded_bytes(
    path: str | Path, max_bytes: int, what: str, refusal: type[CableSenseError]
) -> bytes:
    """The content of a regular file.

    It is the opened file that is looked at, so that none can be put in its place between. One
    larger than `max_bytes` is refused unread; errors call it `what` ("an arm file").

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
        wrong = f"{_shown(path)}: cannot be read ({why})"
        raise refusal(f"{wrong}; give the path of {what}") from error
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


@contextmanager
def written_whole(path: str | Path, refusal: type[CableSenseError]) -> Iterator[Path]:
    """A new file beside `path` that takes its name when the block ends well, and else vanishes.

    Errors of the block pass through, except an `OSError`; a file that is there is replaced.

    Raises:
        CableSenseError: of the class `refusal`: the file cannot be written.
    """
    path = Path(path)
    beside = path.parent / f".{path.name}.{os.getpid()}.part"
    try:
        if path.is_dir():
            raise IsADirectoryError(errno.EISDIR, "is a folder")
        beside.touch()
        yield beside
        beside.replace(path)
    except OSError as error:
        why = error.strerror or " ".join(str(error).split())
        raise refusal(
            f"{_shown(path)}: cannot be written ({why}); "
            "give a file in a folder that exists and is yours"
        ) from error
    finally:
        with suppress(OSError):
            beside.unlink(missing_ok=True)


def write_atomically(
    path: str | Path, content: str | bytes, refusal: type[CableSenseError]
) -> None:
    """Write a file whole or not at all; as `written_whole`.

    Raises:
        CableSenseError: of the class `refusal`: the file cannot be written.
    """
    with written_whole(path, refusal) as beside:
        beside.write_bytes(content.encode() if isinstance(content, str) else content)


def is_file(path: str | Path) -> bool:
    """Whether a file of this name exists; False, too, for what cannot be a name."""
    try:
        return Path(path).is_file()
    except (OSError, ValueError):  # too long, or with a null in it
        return False


def _shown(path: str | Path) -> str:
    """A path in an error: one with a null in it, or without end, is data too."""
    text = str(path)
    return text if len(text) < 200 and text.isprintable() else repr(text[:100])
