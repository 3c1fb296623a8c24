"""Files: read if regular and no larger than their kind can be, written whole or not at all.

Nothing but a regular file that may be written to is ever replaced. A command asks `output_file` or
`output_folder` before it begins, and there an existing file needs the user's word.
"""

from __future__ import annotations

import errno
import os
import stat
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from cablesense_base import CableSenseError


class OutputError(CableSenseError):
    """A place that cannot or must not be written to."""


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
        wrong = f"{_shown(path)}: cannot be read ({_why(error)})"
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


def output_file(
    path: str | Path,
    refusal: type[CableSenseError] = OutputError,
    *,
    force: bool = False,
    inputs: Iterable[str | Path | None] = (),
) -> Path:
    """The file that may be written at `path`, links followed: a new one, or one to be replaced.

    Args:
        path: as the user gives it.
        refusal: the class of errors.
        force: whether an existing file may be replaced.
        inputs: what is read meanwhile; such a file is never replaced, whatever its other names.

    Raises:
        CableSenseError: of the class `refusal`: a folder, a device, a pipe or a link to one; a
            file that is read-only, an input, or there already; or a folder that is missing or
            not the user's.
    """
    try:
        place = Path(os.path.realpath(path))
        there = _status(place)
        if there is None:
            place.parent.stat()
        elif stat.S_ISDIR(there.st_mode):
            raise IsADirectoryError(errno.EISDIR, "is a folder")
        elif not stat.S_ISREG(there.st_mode):
            raise OSError(errno.EINVAL, "is a device or a pipe, not a file")
        elif not (there.st_mode & _WRITABLE and os.access(place, os.W_OK)):
            raise OSError(errno.EACCES, "is read-only")
        if not os.access(place.parent, os.W_OK | os.X_OK):
            raise OSError(errno.EACCES, os.strerror(errno.EACCES))
        read = [Path(name).stat() for name in inputs if name and Path(name).exists()]
    except (OSError, ValueError) as error:
        raise _not_written(path, error, refusal) from error
    if there is not None:
        if any(os.path.samestat(there, status) for status in read):
            raise refusal(f"{path}: is an input of this command; give the name of another file")
        if not force:
            raise refusal(f"{path}: exists already; give another name, or replace it with --force")
    return place


_WRITABLE = stat.S_IWUSR | stat.S_IWGRP | stat.S_IWOTH
"""A file without any of these is read-only for root too, whom nothing else would stop."""


def output_folder(
    folder: Path,
    patterns: Iterable[str],
    refusal: type[CableSenseError] = OutputError,
    *,
    force: bool = False,
    inputs: Iterable[str | Path | None] = (),
) -> None:
    """Refuse a folder where files of these names or patterns must not be written.

    It need not exist yet. Other files in it are nobody's concern.

    Raises:
        CableSenseError: of the class `refusal`: it cannot be made or written to, or `output_file`
            refuses one of the files that are there.
    """
    inputs = tuple(inputs)
    try:
        nearest = next(place for place in (folder, *folder.absolute().parents) if place.exists())
        if not nearest.is_dir():
            raise OSError(errno.ENOTDIR, os.strerror(errno.ENOTDIR))
        if not os.access(nearest, os.W_OK | os.X_OK):
            raise OSError(errno.EACCES, os.strerror(errno.EACCES))
    except (OSError, ValueError) as error:
        raise refusal(
            f"{_shown(folder)}: cannot be written to ({_why(error)}); give another --out"
        ) from error
    for place in sorted(found for pattern in patterns for found in folder.glob(pattern)):
        output_file(place, refusal, force=force, inputs=inputs)


@contextmanager
def written_whole(path: str | Path, refusal: type[CableSenseError]) -> Iterator[Path]:
    """A new file beside `path` that takes its name when the block ends well, and else vanishes.

    Errors of the block pass through, except an `OSError`; a regular file that is there is
    replaced, also where `path` is a link to it.

    Raises:
        CableSenseError: of the class `refusal`: the file cannot be written; as `output_file`.
    """
    place = output_file(path, refusal, force=True)
    beside = place.parent / f".{place.name}.{os.getpid()}.part"
    try:
        beside.touch()
        yield beside
        beside.replace(place)
    except OSError as error:
        raise _not_written(path, error, refusal) from error
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


def _status(path: Path) -> os.stat_result | None:
    try:
        return path.stat()
    except FileNotFoundError:
        return None


def _not_written(
    path: str | Path, error: Exception, refusal: type[CableSenseError]
) -> CableSenseError:
    return refusal(
        f"{_shown(path)}: cannot be written ({_why(error)}); "
        "give a file in a folder that exists and is yours"
    )


def _why(error: Exception) -> str:
    return (isinstance(error, OSError) and error.strerror) or " ".join(str(error).split())


def _shown(path: str | Path) -> str:
    """A path in an error: one with a null in it, or without end, is data too."""
    text = str(path)
    return text if len(text) < 200 and text.isprintable() else repr(text[:100])
