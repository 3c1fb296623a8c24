"""Files: read if regular and no larger than their kind can be, written whole or not at all.

Only a regular file that may be written to is ever replaced. A command asks `output_file` or
`output_folder` before it begins, and an existing file then needs the user's word.
"""

from __future__ import annotations

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
    """The content of a regular file; errors call it `what` ("an arm file").

    Raises:
        CableSenseError: of the class `refusal`: missing, no regular file, or over `max_bytes`.
    """
    try:
        # a pipe without a writer would keep a plain open waiting for ever
        descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK)
        with open(descriptor, "rb") as file:  # noqa: PTH123  (a descriptor has no path)
            if not stat.S_ISREG(os.fstat(descriptor).st_mode):
                raise OSError("not a file")
            content = file.read(max_bytes + 1)
    except IsADirectoryError as error:
        raise refusal(f"{path}: not a file; {what} is one") from error
    except (OSError, ValueError) as error:
        raise refusal(
            f"{printable_path(path)}: cannot be read ({_why(error)}); give the path of {what}"
        ) from error
    if len(content) > max_bytes:
        raise refusal(f"{path}: larger than {max_bytes} bytes, so not {what}")
    return content


def read_bounded_text(
    path: str | Path,
    max_bytes: int,
    what: str,
    refusal: type[CableSenseError],
    otherwise: str | None = None,
) -> str:
    """The text of a regular file in UTF-8, or else in the encoding `otherwise`; as bytes are read.

    Raises:
        CableSenseError: of the class `refusal`: as `read_bounded_bytes`, or the file is no UTF-8.
    """
    content = read_bounded_bytes(path, max_bytes, what, refusal)
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        if otherwise is not None and b"\0" not in content:
            return content.decode(otherwise, "replace")
        raise refusal(
            f"{path}: cannot be read as text (byte {error.start} is no UTF-8); {what} is text: "
            "save it as UTF-8"
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
        inputs: files that the command reads; none of them is replaced, whatever its other names.

    Raises:
        CableSenseError: of the class `refusal`: a folder, a device, a pipe or a link to one; a
            file that is read-only, an input, or there already; or a folder that is missing or
            not the user's.
    """
    try:
        place = Path(os.path.realpath(path))
        try:
            existing = place.stat()
        except FileNotFoundError:
            existing = None
            place.parent.stat()
        if existing is not None:
            _require_replaceable(place, existing.st_mode)
        if not os.access(place.parent, os.W_OK | os.X_OK):
            raise OSError("Permission denied")
        read = [Path(name).stat() for name in inputs if name and Path(name).exists()]
    except (OSError, ValueError) as error:
        raise _not_written(path, error, refusal) from error
    if existing is not None:
        if any(os.path.samestat(existing, status) for status in read):
            raise refusal(f"{path}: is an input of this command; give the name of another file")
        if not force:
            raise refusal(f"{path}: exists already; give another name, or replace it with --force")
    return place


def _require_replaceable(place: Path, mode: int) -> None:
    if stat.S_ISDIR(mode):
        raise OSError("is a folder")
    if not stat.S_ISREG(mode):
        raise OSError("is a device or a pipe, not a file")
    if not (mode & _WRITABLE and os.access(place, os.W_OK)):
        raise OSError("is read-only")


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
    """Refuse a folder in which files of these names or patterns must not be written.

    The folder need not exist yet. Its other files do not matter.

    Raises:
        CableSenseError: of the class `refusal`: it cannot be made or written to, or `output_file`
            refuses one of the files that are there.
    """
    inputs = tuple(inputs)
    try:
        if folder.resolve() == Path(folder.anchor or "/"):
            raise OSError("is the root of the file system")
        nearest = next(place for place in (folder, *folder.absolute().parents) if place.exists())
        if not nearest.is_dir():
            raise OSError("Not a directory")
        if not os.access(nearest, os.W_OK | os.X_OK):
            raise OSError("Permission denied")
    except (OSError, ValueError) as error:
        raise refusal(
            f"{printable_path(folder)}: cannot be written to ({_why(error)}); give another --out"
        ) from error
    for place in sorted(match for pattern in patterns for match in folder.glob(pattern)):
        output_file(place, refusal, force=force, inputs=inputs)


@contextmanager
def written_whole(path: str | Path, refusal: type[CableSenseError]) -> Iterator[Path]:
    """A new file next to `path` that takes its name when the block ends well, and else vanishes.

    Errors of the block pass through, except an `OSError`. A regular file at `path` is replaced,
    also where `path` is a link to it.

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
        # a path whose bytes are no UTF-8 may stand in a text
        text_bytes = content.encode("utf-8", "replace") if isinstance(content, str) else content
        beside.write_bytes(text_bytes)


def plain_name(name: str) -> str:
    """A file's name for texts, where bytes that are no UTF-8 are replaced."""
    return os.fsencode(name).decode("utf-8", "replace")


def _not_written(
    path: str | Path, error: Exception, refusal: type[CableSenseError]
) -> CableSenseError:
    return refusal(
        f"{printable_path(path)}: cannot be written ({_why(error)}); "
        "give a file in a folder that exists and is yours"
    )


def _why(error: Exception) -> str:
    return (isinstance(error, OSError) and error.strerror) or str(error)


def printable_path(path: str | Path) -> str:
    """A path in an error; one that holds a null or has no end is shortened."""
    text = str(path)
    return text if len(text) < 200 and text.isprintable() else repr(text[:100])
