"""A recorded run through the same code gives the same bytes, and says where it does not."""

from __future__ import annotations

import csv
import functools
import json

import pytest
from typer.testing import CliRunner

from cablesense_base import CableSenseError
from cablesense_msgs_py import topics
from cablesense_online.replay import RecordedRun, replay_in_process
from cablesense_recording.recording import RecordingError
from cablesense_ros.cli.app import app
from tests.helpers.recorded_runs import EPOCH_NS, STEP_NS, MadeRun

pytest.importorskip("rclpy", reason="needs ROS 2, or its wheels", exc_type=ImportError)


pytestmark = [pytest.mark.slow, pytest.mark.filterwarnings("ignore::DeprecationWarning")]


made_run = functools.cache(MadeRun)


@pytest.fixture(scope="module")
def made():
    return made_run()


@pytest.fixture(scope="module")
def whole(made, tmp_path_factory):
    return made.write(tmp_path_factory.mktemp("runs") / "whole.mcap")


def replayed(path):
    return replay_in_process(RecordedRun(path))


def test_every_byte_is_the_same(whole):
    got = replayed(whole)
    assert (got.samples, got.compared, got.identical) == (200, 200, 200)
    assert 50 < got.contacts < 150
    assert got.same
    assert not got.first_difference


def test_a_setting_that_changed_is_changed_again(tmp_path):
    made = made_run(adjusted=True)
    got = replayed(made.write(tmp_path / "adjusted.mcap"))
    assert (got.compared, got.identical) == (200, 200)
    assert made.records != made_run().records


@pytest.mark.parametrize("by_samples", [-3, 5])
def test_a_tare_that_was_recorded_early_or_late_is_taken_where_it_was(made, tmp_path, by_samples):
    """The recorder gets tensions and calibrations from two processes."""

    def moved(record):
        topic, log_ns, raw = record
        shifted = topic == topics.CALIBRATION_USED and log_ns > EPOCH_NS
        shift_ns = by_samples * STEP_NS if shifted else 0
        return topic, log_ns + shift_ns, raw

    records = sorted(map(moved, made.records), key=lambda record: record[1])
    got = replayed(made.write(tmp_path / "shifted.mcap", records))
    assert (got.compared, got.identical) == (200, 200)


def test_a_breath_is_repeated(tmp_path):
    made = made_run(breath=True)
    got = replayed(made.write(tmp_path / "breath.mcap"))
    assert (got.compared, got.identical) == (200, 200)


def test_a_recording_that_begins_later_has_the_calibration_that_is_latched(made, tmp_path):
    """Once the force has been the same for a moment, the answers are too."""
    first = 140
    begin = EPOCH_NS + first * STEP_NS
    latched = [r for r in made.records if r[0] == topics.CALIBRATION_USED and r[1] < begin][-1]
    command = [r for r in made.records if r[0] == topics.JOINT_COMMANDS][-1]
    records = [(topic, begin, raw) for topic, _, raw in (latched, command)]
    records += [record for record in made.records if record[1] >= begin]
    got = replayed(made.write(tmp_path / "late.mcap", records, "/left/arm"))
    assert got.samples == 200 - first
    assert got.compared == got.samples


def test_what_was_answered_before_the_first_calibration_of_a_recording_is_counted_apart(
    made, tmp_path
):
    calibrated_ns = [record[1] for record in made.records if record[0] == topics.CALIBRATION_USED]
    first_ns, last_ns = min(calibrated_ns), max(calibrated_ns)
    early = [
        record
        for record in made.records
        if record[0] == topics.WRENCH and first_ns <= record[1] < last_ns
    ]
    records = [
        record
        for record in made.records
        if record[0] != topics.CALIBRATION_USED or record[1] == last_ns
    ]
    got = replayed(made.write(tmp_path / "early.mcap", records))
    assert early
    assert (got.samples, got.not_replayed) == (200, len(early))
    assert got.compared == got.samples - got.not_replayed
    assert any(line.startswith(f"{len(early):>10}  not answered again") for line in got.lines)


def test_a_changed_bit_is_found_and_the_command_fails(made, tmp_path):
    records = list(made.records)
    changed_record = [i for i, record in enumerate(records) if record[0] == topics.WRENCH][100]
    topic, log_ns, raw = records[changed_record]
    records[changed_record] = (topic, log_ns, raw[:-9] + bytes([raw[-9] ^ 1]) + raw[-8:])
    path = made.write(tmp_path / "changed.mcap", records)
    got = replayed(path)
    assert (got.compared, got.identical) == (200, 199)
    assert got.first_difference.startswith("sample 101, stamp 17")
    assert "recorded" in got.first_difference
    done = CliRunner().invoke(app, ["replay", str(path)])
    assert done.exit_code == 1
    assert "first difference: sample 101" in done.stdout
    assert "199  bit-identical" in done.stdout


def test_a_recording_that_breaks_off_is_compared_up_to_there(whole, tmp_path):
    path = tmp_path / "cut.mcap"
    path.write_bytes(whole.read_bytes()[: int(0.6 * whole.stat().st_size)])
    done = CliRunner().invoke(app, ["replay", str(path), "--json"])
    assert done.exit_code in (0, 2), done.output
    if done.exit_code == 0:
        printed = json.loads(done.stdout)
        assert "breaks off" in printed["cut"]
        assert 0 < printed["compared"] == printed["identical"] <= 200


def test_estimates_are_written(whole, tmp_path):
    table = tmp_path / "estimates.csv"
    done = CliRunner().invoke(app, ["replay", str(whole), "--estimates", str(table)])
    assert done.exit_code == 0, done.output
    rows = list(csv.DictReader(table.read_text(encoding="utf-8").splitlines()))
    assert len(rows) == 200
    touched = [row for row in rows if row["segment"] == "3"]
    assert 50 < len(touched) < 150
    for row in touched[40:]:
        assert abs(float(row["magnitude_n"]) - 21.2) < 3.0
        assert float(row["magnitude_low_n"]) <= float(row["magnitude_n"])
        assert (
            0.0 <= float(row["place_low_m"]) <= float(row["place_m"]) <= float(row["place_high_m"])
        )
    assert [path.name for path in tmp_path.iterdir()] == ["estimates.csv"]


def test_a_model_of_another_arm_is_refused(whole):
    with pytest.raises(CableSenseError, match="not of cdsm-"):
        replay_in_process(RecordedRun(whole), arm="cdsm")


def test_recordings_that_cannot_be_replayed_are_one_line(made, tmp_path):
    def path(name, wanted=None, **more):
        records = [r for r in made.records if wanted is None or r[0] in wanted]
        return made.write(tmp_path / name, records, **more)

    with pytest.raises(RecordingError, match="has no cable_tensions, but /estimator/wrench"):
        RecordedRun(path("a.mcap", {topics.WRENCH}))
    with pytest.raises(RecordingError, match="has no ~/calibration"):
        RecordedRun(path("b.mcap", {topics.CABLE_TENSIONS, topics.WRENCH}))
    kinds = {topics.CALIBRATION_USED: "std_msgs/msg/String"}
    with pytest.raises(RecordingError, match="is of type 'std_msgs/msg/String'; it must be"):
        RecordedRun(path("c.mcap", kinds=kinds.items()))
    with pytest.raises(RecordingError, match="is a folder"):
        RecordedRun(tmp_path)
