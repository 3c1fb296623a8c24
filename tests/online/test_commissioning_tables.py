"""Tables written by hand: known loads and pulls are read, anything else is refused in one line."""

from contextlib import suppress

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cablesense_base import CableSenseError
from cablesense_online.commissioning.tables import (
    MAX_TABLE_BYTES,
    CommissioningError,
    Pull,
    TimeWindow,
    read_known_loads,
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


CABLES = ("cable_1", "cable_2")


@pytest.fixture
def read(tmp_path):
    def of(text, **options):
        path = tmp_path / "loads.csv"
        path.write_text(text, encoding="utf-8")
        return read_known_loads(path, CABLES, **options)

    return of


def test_masses_become_forces_by_gravity(read):
    loads = read("cable,mass_kg,mass_u_kg,raw\ncable_1,2.0,0.001,417\n", gravity_m_s2=9.81)
    (load,) = loads["cable_1"]
    assert load.force_n == pytest.approx(19.62)
    assert load.force_u_n == pytest.approx(0.00981)
    assert load.reading == 417.0
    assert load.by_mass


def test_cables_keep_the_order_of_their_loads(read):
    loads = read(
        "\ufeffcable, force_n, start_s, end_s, raw, raw_u\n"
        "# up\ncable_2,0,1,5,,\ncable_1,3,,,12.5,0.5\n\ncable_2,30,10.5,14,,\n"
    )
    assert [load.force_n for load in loads["cable_2"]] == [0.0, 30.0]
    assert loads["cable_2"][1].reading == TimeWindow(10.5, 14.0)
    assert loads["cable_1"][0].raw_u == 0.5


@pytest.mark.parametrize(
    ("text", "remedy"),
    [
        ("", "is empty"),
        ("cable,force_n,raw\n", "no rows"),
        ("cable,weight,raw\ncable_1,1,2\n", "has weight"),
        ("force_n,raw\n1,2\n", "misses cable"),
        ("cable,raw,raw\ncable_1,1,2\n", "twice"),
        ("cable,force_n,raw\ncable_3,1,2\n", "no cable 'cable_3'; there are cable_1, cable_2"),
        ("cable,force_n,raw\ncable_1,1\n", "line 2 has 2 cells"),
        ("cable,force_n,raw\ncable_1,x,2\n", "force_n is 'x'"),
        ("cable,force_n,raw\ncable_1,nan,2\n", "force_n is 'nan'"),
        ("cable,force_n,raw\ncable_1,-1,2\n", "from 0 to 20000"),
        ("cable,force_n,mass_kg,raw\ncable_1,1,1,2\n", "both mass_kg and force_n"),
        ("cable,force_n,raw\ncable_1,,2\n", "neither mass_kg nor force_n"),
        ("cable,force_n,raw\ncable_1,1,\n", "neither raw nor start_s"),
        ("cable,force_n,start_s,end_s\ncable_1,1,5,4\n", "is not after"),
        ("cable,force_n,start_s\ncable_1,1,5\n", "end_s is empty"),
    ],
)
def test_what_does_not_fit_is_refused_with_its_place(read, text, remedy):
    with pytest.raises(CableSenseError, match=r"loads\.csv: ") as refusal:
        read(text)
    assert remedy in str(refusal.value)


def test_a_file_that_is_not_there_is_refused(tmp_path):
    with pytest.raises(CableSenseError, match="cannot be read"):
        read_known_loads(tmp_path / "none.csv", CABLES)
