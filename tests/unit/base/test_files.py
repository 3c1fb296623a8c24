"""Files are read if regular and bounded, written whole or not at all, or refused in one line."""

import os
from pathlib import Path

import pytest

from cablesense_base import CableSenseError
from cablesense_base.files import (
    OutputError,
    output_file,
    output_folder,
    read_bounded_bytes,
    read_bounded_text,
    write_atomically,
    written_whole,
)


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


@pytest.mark.parametrize("content", ["<p>µ</p>", b"\xff\x00"])
def test_a_file_is_replaced_and_never_written_over(tmp_path, content):
    path = tmp_path / "page.html"
    former = tmp_path / "former"
    write_atomically(path, "former", RefusedError)
    os.link(path, former)
    write_atomically(str(path), content, RefusedError)
    assert path.read_bytes() == (content if isinstance(content, bytes) else content.encode())
    assert former.read_text() == "former"
    assert len(list(tmp_path.iterdir())) == 2


def half_written(path, error):
    path.write_text("half")
    raise error


def test_nothing_remains_of_a_file_that_was_not_finished(tmp_path):
    path = tmp_path / "page.html"
    path.write_text("former")
    for error, raised in ((KeyError("x"), KeyError), (OSError(28, "No space"), RefusedError)):
        with pytest.raises(raised), written_whole(path, RefusedError) as beside:
            half_written(beside, error)
    assert [p.name for p in tmp_path.iterdir()] == ["page.html"]
    assert path.read_text() == "former"


def test_only_a_regular_file_that_may_be_written_is_replaced(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "link_to_pipe").symlink_to("pipe")
    (tmp_path / "null").symlink_to("/dev/null")
    (tmp_path / "fixed").touch(0o444)
    before = sorted(tmp_path.iterdir())
    for name, why in (
        ("pipe", "is a device or a pipe"),
        ("link_to_pipe", "is a device or a pipe"),
        ("null", "is a device or a pipe"),
        ("fixed", "is read-only"),
        ("fixed/a", "Not a directory"),
        ("none/a", "No such file"),
        ("", "is a folder"),
    ):
        with pytest.raises(RefusedError, match=rf"{name}: cannot be written \({why}"):
            write_atomically(tmp_path / name, "mine", RefusedError)
    assert sorted(tmp_path.iterdir()) == before
    assert (tmp_path / "pipe").is_fifo()


def test_a_link_to_a_file_stays_one(tmp_path):
    link = tmp_path / "link"
    file = tmp_path / "file"
    link.symlink_to(file)
    for content in ("new", "replaced"):
        write_atomically(link, content, RefusedError)
        assert link.is_symlink()
        assert file.read_text() == content


def test_an_existing_file_is_refused_without_force_and_an_input_always(tmp_path):
    path = tmp_path / "a"
    assert output_file(path, inputs=(path, None, "", "none")) == path
    path.touch()
    with pytest.raises(OutputError, match="a: exists already; give another name"):
        output_file(path)
    assert output_file(path, force=True) == path
    with pytest.raises(OutputError, match="a: is an input of this command"):
        output_file(path, force=True, inputs=(path,))


def test_in_a_folder_only_files_of_the_own_names_matter(tmp_path):
    (tmp_path / "mine.txt").touch()
    output_folder(tmp_path, ("report.html", "case_*.csv"))
    output_folder(tmp_path / "new" / "deeper", ("report.html",))
    assert [path.name for path in tmp_path.iterdir()] == ["mine.txt"]
    (tmp_path / "case_002.csv").touch()
    with pytest.raises(OutputError, match=r"case_002\.csv: exists already"):
        output_folder(tmp_path, ("report.html", "case_*.csv"))
    output_folder(tmp_path, ("report.html", "case_*.csv"), force=True)
    with pytest.raises(OutputError, match=r"^/: cannot be written to \(is the root"):
        output_folder(Path("/"), ("report.html",), force=True)
    for place in (tmp_path / "mine.txt", tmp_path / "mine.txt" / "below"):
        with pytest.raises(RefusedError, match=r"cannot be written to \(Not a directory\)"):
            output_folder(place, ("report.html",), RefusedError)
