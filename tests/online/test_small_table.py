"""Tables written by hand: any text is a table or refused in one line."""

from contextlib import suppress

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cablesense_base.errors import CableSenseError
from cablesense_online.commissioning.tables import (
    MAX_TABLE_BYTES,
    CommissioningError,
    Pull,
    TimeWindow,
    read_pulls,
)


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    return tmp_path_factory.mktemp("table") / "t.csv"


@given(st.text(max_size=80) | st.text(alphabet='cable,start_end"\n1 ', max_size=80))
def test_any_text_is_read_or_refused(path, text):
    path.write_text(text, encoding="utf-8", newline="")
    with suppress(CableSenseError):
        assert all(pull.cable == "1" for pull in read_pulls(path, ["1"]))


def test_cells_go_by_column_name_and_errors_name_the_line(path):
    path.write_text("end_s,cable,start_s\n\n# by hand\n2, c ,1\n", encoding="utf-8")
    assert read_pulls(path, ["c"]) == [Pull("c", TimeWindow(1.0, 2.0))]
    path.write_text("end_s,cable,start_s\n\n2,c,-1\n", encoding="utf-8")
    remedy = "line 3: start_s is '-1'; it must be a number from 0"
    with pytest.raises(CommissioningError, match=remedy):
        read_pulls(path, ["c"])


def test_a_huge_file_is_refused_unread(path):
    path.write_text("a" * (MAX_TABLE_BYTES + 1), encoding="utf-8")
    with pytest.raises(CableSenseError, match="larger than"):
        read_pulls(path, ["c"])
