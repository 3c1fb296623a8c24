"""A dataset comes back from its file as it was written, and only a whole, fitting file is read."""

import json

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from cablesense_sim.arm import open_arm, parse_arm
from cablesense_training.data import parquet
from cablesense_training.data.dataset import Dataset
from cablesense_training.data.generation import draw_dataset
from cablesense_training.data.parquet import produce_dataset, read_dataset, write_dataset
from cablesense_training.data.protocols import AnywhereContact, MultiContact, SingleContact
from cablesense_training.errors import DatasetError


@pytest.fixture(scope="module")
def arm():
    return open_arm("cdsm")


@pytest.fixture(scope="module")
def dataset(arm):
    return draw_dataset(arm, SingleContact(samples=200, pose="random"), seed=5)


@pytest.fixture
def path(dataset, tmp_path):
    path = tmp_path / "data.parquet"
    write_dataset(path, dataset, "cablesense dataset")
    return path


def altered(path, change):
    """The file again, with its table changed."""
    pq.write_table(change(pq.read_table(path)), path)
    return path


def with_metadata(table, **values):
    metadata = dict(table.schema.metadata)
    for key, value in values.items():
        metadata[b"cablesense." + key.encode()] = value.encode()
    return table.replace_schema_metadata(metadata)


def with_value(table, name, row, value):
    place = table.schema.get_field_index(name)
    values = table.column(name).to_pylist()
    values[row] = value
    field = table.schema.field(place)
    return table.set_column(place, field, pa.array(values, type=field.type))


@pytest.mark.parametrize("protocol", [SingleContact, MultiContact, AnywhereContact])
@pytest.mark.parametrize("name", ["cdsm", "cdsm_lab", "cdsm_table2"])
def test_comes_back_as_written(tmp_path, protocol, name):
    arm = open_arm(name)
    options = {"samples": 50, "pose": "random", "force_high_n": 40.0}
    written = draw_dataset(arm, protocol(**options), seed=9)
    write_dataset(tmp_path / "data.parquet", written)
    read = read_dataset(tmp_path / "data.parquet", arm)
    assert (read.arm, read.protocol, read.seed) == (arm, written.protocol, 9)
    for array in Dataset.array_names():
        assert (getattr(read, array) == getattr(written, array)).all()
        assert getattr(read, array).dtype == getattr(written, array).dtype
    assert (read.forces_n == written.forces_n).all()


def test_columns_have_units_and_the_file_its_provenance(path, arm):
    schema = pq.read_schema(path)
    units = {field.name: field.metadata[b"unit"].decode() for field in schema}
    assert units["tension_difference_cable_12_n"] == units["unloaded_cable_1_n"] == "N"
    assert units["command_joint_1_pitch_rad"] == "rad"
    assert (units["segment"], units["angle_deg"], units["magnitude_n"]) == ("1", "deg", "N")
    stored = {
        key.decode().removeprefix("cablesense."): value.decode()
        for key, value in schema.metadata.items()
    }
    assert stored["arm_identity"] == arm.identity
    assert parse_arm(stored["arm"]) == arm
    assert json.loads(stored["cables"]) == list(arm.cable_names)
    assert json.loads(stored["protocol"])["tare_samples"] == 50
    assert (stored["seed"], stored["command"]) == ("5", "cablesense dataset")
    assert "version" in stored


def test_refuses_another_arm(path):
    lab = open_arm("cdsm_lab")
    with pytest.raises(DatasetError, match=rf"comes from arm cdsm-.*{lab.identity} was asked for"):
        read_dataset(path, lab)


def test_refuses_what_is_no_dataset(tmp_path):
    with pytest.raises(DatasetError, match="no such file; `cablesense dataset --out"):
        read_dataset(tmp_path / "none.parquet")
    with pytest.raises(DatasetError, match="not a Parquet file"):
        read_dataset(tmp_path)
    for content in (b"", b"PAR1", b"segment,angle\n1,2\n", b"PAR1" * 40):
        (tmp_path / "text").write_bytes(content)
        with pytest.raises(DatasetError, match="not a Parquet file, or cut short"):
            read_dataset(tmp_path / "text")
    pq.write_table(pa.table({"a": [1.0]}), tmp_path / "foreign")
    with pytest.raises(DatasetError, match="not a CableSense dataset"):
        read_dataset(tmp_path / "foreign")


@settings(
    max_examples=15, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(kept=st.floats(0.0, 0.999))
def test_refuses_a_file_cut_short_anywhere(path, tmp_path, kept):
    whole = path.read_bytes()
    cut = tmp_path / "cut.parquet"
    cut.write_bytes(whole[: int(kept * len(whole))])
    with pytest.raises(DatasetError, match="not a Parquet file, or cut short"):
        read_dataset(cut)


def first_contact(table):
    return int(np.flatnonzero(table.column("segment"))[0])


def with_field(table, name, change):
    place = table.schema.get_field_index(name)
    return table.cast(table.schema.set(place, change(table.schema.field(name))))


CHANGES = {
    "'angle_deg' .* where .* need 'segment' of int64": lambda t: t.drop_columns(["segment"]),
    "'extra' .* need none": lambda t: t.append_column("extra", [t.column("segment")]),
    "'segment' .* need none": lambda t: t.append_column("segment", [t.column("segment")]),
    "of float in .* need 'angle_deg' of double": lambda t: with_field(
        t, "angle_deg", lambda field: field.with_type(pa.float32())
    ),
    "of double in 'rad' .* of double in 'deg'": lambda t: with_field(
        t, "angle_deg", lambda field: field.with_metadata({"unit": "rad"})
    ),
    "in 'no unit' .* in 'rad'": lambda t: with_field(
        t, "command_joint_1_pitch_rad", lambda field: field.remove_metadata()
    ),
    "'angle_deg' of double": lambda t: with_field(
        t, "angle_deg", lambda field: field.with_nullable(True)
    ),
    "'tension_difference_cable_3_n' in row 7 is nan: must be a finite number": lambda t: (
        with_value(t, "tension_difference_cable_3_n", 7, float("nan"))
    ),
    "'magnitude_n' in row 2 is inf": lambda t: with_value(t, "magnitude_n", 2, float("inf")),
    "row 4 has no contact of": lambda t: with_value(t, "segment", 4, 5),
    "row .* has no contact of": lambda t: with_value(t, "segment", first_contact(t), 0),
    "a contact of 900.0 N .* has 0 to 200 N": lambda t: with_value(
        t, "magnitude_n", first_contact(t), 900.0
    ),
    "at 360.0 degrees.* 0 to below 360 degrees": lambda t: with_value(
        t, "angle_deg", first_contact(t), 360.0
    ),
    "holds no samples": lambda t: t.slice(0, 0),
    "format '9'; this version reads format '1'": lambda t: with_metadata(t, format="9"),
    "arm_identity = cdsm-000000000000, but the arm .* is cdsm-": lambda t: with_metadata(
        t, arm_identity="cdsm-000000000000"
    ),
    "cablesense.arm: holds list": lambda t: with_metadata(t, arm="[]"),
    "protocol or cablesense.seed: .*one of single": lambda t: with_metadata(
        t, protocol='{"kind": "some"}'
    ),
    "protocol or cablesense.seed": lambda t: with_metadata(t, protocol="[1, 2]"),
    "protocol or cablesense.seed: invalid literal": lambda t: with_metadata(t, seed="x"),
}


@pytest.mark.parametrize("message", CHANGES)
def test_refuses_altered_files(path, message):
    with pytest.raises(DatasetError, match=message) as caught:
        read_dataset(altered(path, CHANGES[message]))
    assert "\n" not in str(caught.value)
    assert str(path) in str(caught.value)


def test_refuses_a_contact_beyond_the_reach(arm, tmp_path):
    path = tmp_path / "data.parquet"
    protocol = AnywhereContact(samples=50)
    write_dataset(path, draw_dataset(arm, protocol, seed=5))
    row = int(np.flatnonzero(pq.read_table(path).column("contact_segment_2"))[0])
    altered(path, lambda table: with_value(table, "place_segment_2_m", row, 0.2))
    with pytest.raises(DatasetError, match=r"at 0.2 m from the joint of segment 2; .* 0.13 m"):
        read_dataset(path)


def test_a_failure_leaves_nothing_and_keeps_what_was_there(tmp_path, dataset, monkeypatch):
    path = tmp_path / "data.parquet"
    path.write_text("before")

    def chunks(*arguments, **options):
        yield dataset
        raise KeyboardInterrupt

    monkeypatch.setattr(parquet, "generate", chunks)
    with pytest.raises(KeyboardInterrupt):
        produce_dataset(path, dataset.arm, dataset.protocol, dataset.seed, command="")
    assert [file.name for file in tmp_path.iterdir()] == ["data.parquet"]
    assert path.read_text() == "before"
    write_dataset(path, dataset)
    assert len(read_dataset(path)) == 200


def test_a_few_bytes_that_stand_for_any_number_of_rows_are_refused(tmp_path):
    path = tmp_path / "bomb.parquet"
    zeros = pa.array(np.zeros(30_000_000))
    pq.write_table(pa.table({"a": zeros}), path, compression="zstd")
    assert path.stat().st_size < 200_000
    with pytest.raises(DatasetError, match=r"30000000 rows of 1 columns in .* packed so tightly"):
        read_dataset(path)
