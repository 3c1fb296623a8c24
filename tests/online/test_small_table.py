"""Tables written by hand: any text is a table or one line of what would be."""

from contextlib import suppress

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cablesense_base.errors import CableSenseError
from cablesense_online.commissioning.readings import (
    MAX_TABLE_BYTES,
    CommissioningError,
    read_table,
    window_of,
)


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    return tmp_path_factory.mktemp("table") / "t.csv"


@given(st.text(max_size=80) | st.text(alphabet='cable,start_end"\n1 ', max_size=80))
def test_any_text_is_read_or_refused(path, text):
    path.write_text(text, encoding="utf-8", newline="")
    with suppress(CableSenseError):
        for row in read_table(path, ("cable",), ("start_s", "end_s")):
            row.text("cable")
            window_of(row)


def test_cells_are_found_by_name_and_row(path):
    path.write_text("b,a\n\n1, x \n", encoding="utf-8")
    (row,) = read_table(path, ("a",), ("b",))
    assert row.text("a") == "x"
    assert row.number("b", 0.0, 2.0) == 1.0
    assert row.where == f"{path}: line 3"
    with pytest.raises(CommissioningError, match="line 3: b is '1'; it must be a number from 2"):
        row.number("b", 2.0, 3.0)


def test_a_huge_file_is_refused_unread(path):
    path.write_text("a" * (MAX_TABLE_BYTES + 1), encoding="utf-8")
    with pytest.raises(CableSenseError, match="larger than"):
        read_table(path, ("a",), ())
