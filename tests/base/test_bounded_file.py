"""Files from outside: regular and bounded, or refused in one line."""

import os

import pytest

from cablesense_base.errors import CableSenseError
from cablesense_base.files import read_bounded_bytes, read_bounded_text


class RefusedError(CableSenseError):
    pass


def test_a_file_within_its_bound_is_read(tmp_path):
    path = tmp_path / "a.txt"
    path.write_bytes(b"\xef\xbb\xbfabc")
    assert read_bounded_text(path, 6, "text", RefusedError) == "abc"
    assert read_bounded_bytes(path, 6, "text", RefusedError) == b"\xef\xbb\xbfabc"
    with pytest.raises(RefusedError, match="larger than 5 bytes, so not a page"):
        read_bounded_text(path, 5, "a page", RefusedError)


def test_what_is_no_file_is_refused(tmp_path):
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    binary = tmp_path / "binary"
    binary.write_bytes(b"a\xff")
    for path in (pipe, tmp_path, tmp_path / "absent", "/dev/zero", "a\0b", "x" * 5000, binary):
        with pytest.raises(RefusedError) as caught:
            read_bounded_text(path, 100, "a page", RefusedError)
        assert len(str(caught.value)) < 300
        assert str(caught.value).isprintable()
